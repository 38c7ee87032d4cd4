"""certpgo certify: certify estimates from any solver."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import tell_interrupted, tells_unwritten
from certpgo.cli._next import Asked, steps_after
from certpgo.cli._options import (
    CostOption,
    GraphName,
    HtmlOut,
    Json,
    MaxDifference,
    ProofOut,
    Timestamps,
    chosen_cost,
    refuse_unprovable,
    refuse_with_distances,
    tier_option,
    time_limit_option,
)
from certpgo.cli._paging import origin_of, require_pages, write_page
from certpgo.cli._proving import REFUSED, provable_source, prove
from certpgo.cli._reading import Reading, covered, restricted_to, takes_reading
from certpgo.cli._show import StatusLine, document, notice, noticing, working
from certpgo.cli._truth import KnownPoses, TruthFile, TruthOffset
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.assess.assessment import Assessment
    from certpgo.assess.batch import JudgedGraph
    from certpgo.costs import Certifiable
    from certpgo.graph import Estimate, Instance
    from certpgo.io.matching import Matching
    from certpgo.solvers.certified.disagreement import Disagreement


@takes_reading
@tells_unwritten("best", "csv", "proof", "html")
def command(
    graph: GraphName,
    estimates: Annotated[
        list[str],
        typer.Argument(metavar="ESTIMATE", help="File or dataset with poses; several need --csv."),
    ],
    cost: CostOption = None,
    tier: Annotated[str | None, tier_option("standard, or proof with --proof")] = None,
    rtol: Annotated[
        float, typer.Option("--rtol", help="Tolerance on the gap, relative to the cost F.")
    ] = 1e-5,
    atol: Annotated[
        float, typer.Option("--atol", help="Additional tolerance, relative to the total weight W.")
    ] = 1e-12,
    refine: Annotated[
        bool,
        typer.Option("--refine/--no-refine", help="Run local descent before computing the bound."),
    ] = True,
    time_limit: Annotated[
        float | None,
        time_limit_option("For each ESTIMATE: stop, and print what is proven by then.", "none"),
    ] = None,
    best: Annotated[
        Path | None, typer.Option("--best", metavar="OUT", help="Write the best estimate found.")
    ] = None,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    truth: TruthFile = None,
    truth_offset: TruthOffset = 0.0,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="OUT", help="Write a row per ESTIMATE."),
    ] = None,
    proof: ProofOut = None,
    html: HtmlOut = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Certify estimates of a graph: prove how far each can be from the optimum.

    Ctrl-C prints what is proven by then; a second Ctrl-C aborts.
    """
    from certpgo.certify.proof_file import refuse_unreadable
    from certpgo.io.format import format_to_write
    from certpgo.io.matching import Matching
    from certpgo.io.timestamps import timed

    _refuse_mixtures(estimates, csv, truth=truth, best=best, proof=proof, html=html)
    if best is not None:
        format_to_write(best, None)  # report a wrong suffix before any work
    refuse_unprovable(cost, proof)
    for out in (best, csv, proof, html):
        refuse_unwritable(out)
    require_pages(html)
    source = reading.resolve(graph)
    refuse_overwriting(
        [best, csv, proof, html], [source, *estimates, timestamps, truth], reading.data
    )
    if proof is not None:
        _verdict.refuse_screening(tier)
    tier = tier or ("standard" if proof is None else "proof")
    provable = None if proof is None else provable_source(source)
    instance = timed(reading.open(source, distances=True), timestamps)
    refuse_with_distances(instance, proof=proof)
    own = chosen_cost(cost, instance)
    if provable is not None:
        refuse_unreadable(provable, instance, own)
    status = StatusLine()
    how = Matching.of(timestamps, max_difference)

    settings: dict[str, Any] = {"tier": tier, "rtol": rtol, "atol": atol, "refine": refine}
    settings |= {"time_limit": time_limit, "monitor": status, "ctrl_c": True}

    def judged(of: Instance) -> list[JudgedGraph]:
        return _judged(of, reading, own, settings)

    if csv is not None:
        return _batch(estimates, instance, judged, how, csv, json, reading, status)
    path = reading.resolve(estimates[0]).path()
    whole, estimate = covered(path, instance, reading, how)
    parts = judged(whole)
    if len(parts) > 1:
        _refuse_parts(best=best, proof=proof, html=html)
    if proof is not None and whole is not instance:
        raise InputError("--proof needs an estimate of all nodes: it is about the whole file")
    given = [restricted_to(part.instance, estimate, whole) for part in parts]
    parts = _timed(parts, given)
    that = how.of_truth(truth_offset)
    truths = [KnownPoses.of(truth, part.instance, reading, that) for part in parts]
    asked = None if json else Asked(graph, own, reading, estimates[0], best is not None)
    assessments, disagreements = _single(path, instance, given, parts, truths, asked, status)
    interrupted = any(part.judge.interrupted for part in parts)
    if interrupted:
        tell_interrupted("what is proven by then stands", [proof, html])
    for assessed in assessments:
        _verdict.warn(assessed.fit)
    if best is not None:
        _write_best(best, parts[0], assessments[0])
    elif any(_is_better_known(a, json) for a in assessments):
        notice("--best OUT writes the lower-cost estimate")
    if interrupted:
        return _verdict.INTERRUPTED
    if any(map(_may_gain, assessments, parts)):
        notice("rounding may limit the bound: try --tier proof")
    code = _verdict.exit_code(a.certificate for a in assessments)
    proven = True
    if proof and provable:
        certificate = assessments[0].certificate
        proven = prove(proof, provable, parts[0].instance, given[0], certificate, json=json)
    if html is not None:
        remarks = [f"{found}." for found in disagreements if found is not None]
        origin = origin_of(
            graph,
            reading,
            estimate=estimates[0],
            proof=proof if proven else None,
            stopped=parts[0].judge.ended_by,
            remarks=remarks,
            disagreeing=bool(remarks),
        )
        write_page(html, parts[0].instance, parts[0].problem, given[0], assessments[0], origin)
    return code if proven else code or REFUSED


def _timed(parts: Sequence[JudgedGraph], given: Sequence[Estimate]) -> list[JudgedGraph]:
    """The parts, whose nodes have the times of their poses where the graph has none."""
    from certpgo.io.timestamps import timed_by

    return [
        replace(part, instance=timed_by(point, part.instance))
        for part, point in zip(parts, given, strict=True)
    ]


def _judged(
    of: Instance, reading: Reading, cost: str, settings: dict[str, Any]
) -> list[JudgedGraph]:
    """The connected graphs of an instance, each with a certifier of its estimates."""
    from certpgo.assess.batch import JudgedGraph
    from certpgo.certify.judge import Judge
    from certpgo.costs import certifiable

    problems = [(part, certifiable(part, cost)) for part in reading.parts(of)]
    return [JudgedGraph(part, problem, Judge(problem, **settings)) for part, problem in problems]


def _refuse_mixtures(
    estimates: Sequence[str], csv: Path | None, *, truth: Path | None, **outputs: Path | None
) -> None:
    """Refuse options for one estimate where there may be several."""
    if csv is not None and truth is not None:
        raise InputError("--truth needs a single estimate, without --csv")
    if len(estimates) > 1 and csv is None:
        raise InputError("several estimates need --csv OUT")
    if csv is not None and any(outputs.values()):
        raise InputError("--best, --proof and --html need a single estimate, without --csv")


def _refuse_parts(*, best: Path | None, proof: Path | None, html: Path | None) -> None:
    """Refuse outputs that are for a connected graph."""
    if best is not None:
        raise InputError("--best writes one estimate; use --components largest")
    if proof is not None:
        raise InputError("--proof needs a connected graph; write each component to a file")
    if html is not None:
        raise InputError("--html shows one estimate; use --components largest")


def _is_better_known(found: Assessment, json: bool) -> bool:
    """Whether a better estimate was found that no printed step says how to write."""
    certificate = found.certificate
    optimal = certificate.is_optimal(found.best_cost)
    said = optimal or certificate.basin_is_global or certificate.verdict.value == "REFUTED"
    return found.excess > certificate.tolerance and (json or not said)


def _may_gain(assessment: Assessment, part: JudgedGraph) -> bool:
    """Whether the refined point is so close to the bound that the proof tier may close the gap."""
    from certpgo.certify.case import PROOF_GAIN
    from certpgo.certify.own_cost import has_proofs

    certificate = assessment.certificate
    gap = certificate.refined_cost - certificate.lower_bound
    near = certificate.tolerance < gap <= PROOF_GAIN * certificate.tolerance
    provable = has_proofs(part.problem) and certificate.tier.value == "standard"
    return provable and certificate.better is None and near


def _single(
    path: Path,
    whole: Instance,
    given: Sequence[Estimate],
    parts: Sequence[JudgedGraph],
    truths: Sequence[KnownPoses | None],
    asked: Asked | None,
    status: StatusLine,
) -> tuple[list[Assessment], list[Disagreement | None]]:
    """Certify the estimate of each part; printed as text, or as JSON without ``asked``.

    Text names a part that is not the whole graph.
    """
    from certpgo.io.digits import writing_of

    writing = writing_of(path)
    assessments: list[Assessment] = []
    disagreements: list[Disagreement | None] = []
    accuracies = [
        None if truth is None else truth.errors(estimate)
        for truth, estimate in zip(truths, given, strict=True)
    ]
    for part, estimate, accuracy in zip(parts, given, accuracies, strict=True):
        with working(f"certifying {part.instance.name}") as status.line:
            found = part.assessed(estimate, writing)
            assessments.append(found)
            ended = part.judge.ended_by
            disagreements.append(None if ended else _disagreement(part.problem, found))
        if asked is not None:
            if part.instance.name != whole.name:
                typer.echo(part.instance.name)
            steps = steps_after(
                found.certificate,
                part.instance,
                asked,
                stopped=ended,
                disagreement=disagreements[-1],
            )
            _verdict.show(
                found.certificate,
                part.instance,
                found,
                disagreements[-1],
                accuracy,
                steps,
                found.fit,
            )
        if part.judge.interrupted:
            break
    if asked is None:
        reports = [
            _verdict.as_json(
                part.instance,
                assessment.certificate,
                assessment.cost,
                disagreement=disagreeing,
                assessment=assessment,
                accuracy=accuracy,
                fit=assessment.fit,
            )
            for part, assessment, disagreeing, accuracy in zip(
                parts, assessments, disagreements, accuracies, strict=False
            )
        ]
        document(reports[0] if len(parts) == 1 else reports)
    return assessments, disagreements


def _disagreement(problem: Certifiable, found: Assessment) -> Disagreement | None:
    """Measurements that disagree with the rest, by their residual angles and chordal cost."""
    from certpgo.costs import InformationProblem, RangeProblem
    from certpgo.solvers.certified.disagreement import disagreement

    if isinstance(problem, RangeProblem):
        return None
    if isinstance(problem, InformationProblem):
        problem = problem.chordal
    return disagreement(problem, found.best, refit=not found.best_is_optimal)


def _batch(
    names: Sequence[str],
    instance: Instance,
    judged: Callable[[Instance], list[JudgedGraph]],
    how: Matching,
    out: Path,
    json: bool,
    reading: Reading,
    status: StatusLine,
) -> int:
    """Certify every estimate, with progress on stderr; returns the exit code."""
    from dataclasses import asdict

    from certpgo.assess.batch import JudgedGraph, judge_all, write_rows
    from certpgo.graph.wording import cost_shown

    whole, used, rows = judged(instance), list[JudgedGraph](), []
    with working("certifying") as status.line:

        def read(name: str) -> Iterator[tuple[JudgedGraph, Estimate]]:
            status.line.update(f"certifying {name}")
            of, estimate = covered(reading.resolve(name).path(), instance, reading, how)
            parts = whole if of is instance else judged(of)
            used.extend(parts)
            return ((part, restricted_to(part.instance, estimate, of)) for part in parts)

        for row in judge_all(names, read):
            rows.append(row)
            done = len({row.estimate for row in rows})
            result = row.reason
            if row.cost is not None:
                result = f"{row.estimate}: F {cost_shown(row.cost)}"
            typer.echo(f"{done}/{len(set(names))} {row.verdict} {result}", err=True)
    write_rows(out, rows)
    if json:
        document([asdict(row) for row in rows])
    if any(part.judge.interrupted for part in used):
        done = len({row.estimate for row in rows})
        tell_interrupted(f"{out} has {done} of {len(set(names))} estimates")
        return _verdict.INTERRUPTED
    return _verdict.weakest(row.verdict for row in rows)


def _write_best(out: Path, part: JudgedGraph, assessment: Assessment) -> None:
    from certpgo.io import write

    with noticing():
        write(out, assessment.best, instance=part.instance)
    notice(f"best estimate written to {out}")
