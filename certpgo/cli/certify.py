"""certpgo certify: certify estimates from any solver."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

import typer

from certpgo.cli import _verdict
from certpgo.cli._cause import cause, cause_as_json, cause_of, remark_of
from certpgo.cli._help import JUDGING
from certpgo.cli._interrupting import INTERRUPTED, tell_interrupted, tells_unwritten
from certpgo.cli._next import Asked, is_better_known, steps_after
from certpgo.cli._options import (
    CostOption,
    GraphName,
    HtmlOut,
    Json,
    KernelOption,
    MaxDifference,
    ProofOut,
    Quantile,
    Reference,
    Timestamps,
    chosen_cost,
    estimate_argument,
    require_for,
    tier_for,
    tier_option,
    time_limit_option,
    tolerance_option,
)
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._paging import origin_of, write_page
from certpgo.cli._proving import prove
from certpgo.cli._reading import Reading, covered, restricted_to, takes_reading
from certpgo.cli._rejected import posing
from certpgo.cli._rules import Rule, chordal_only, no_kernel, refuse
from certpgo.cli._show import StatusLine, document, working
from certpgo.cli._swapped import graph_comes_first
from certpgo.cli._truth import OF_TRUTH, KnownPoses, TruthFile, TruthOffset
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.certify.region import ProvenDistance
    from certpgo.diagnosis import Finding
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.matching import Matching
    from certpgo.objective.choose_cost import Certifiable, Judged
    from certpgo.solve.assessment import Assessment
    from certpgo.solve.batch import JudgedPart
    from certpgo.solve.metrics import TrajectoryErrors
    from certpgo.solve.outliers import Disagreement

EXAMPLES = (
    "certpgo certify graph.g2o estimate.tum",
    "certpgo certify graph.g2o estimate.tum --best better.g2o",
    "certpgo certify graph.g2o estimate.tum --truth truth.tum",
    "certpgo certify graph.g2o first.tum second.tum --csv verdicts.csv",
)
RULES = (
    Rule("--truth needs a single estimate, without --csv", "truth", "csv"),
    Rule(
        "--best, --proof and --html need a single estimate, without --csv",
        "best|proof|html",
        "csv",
    ),
    Rule("--reference is for a single estimate: not with --csv", "reference", "csv"),
    Rule("--quantile needs --rejected", "quantile", without="rejected"),
    Rule("--html is for the cost of all measurements: not with --rejected", "html", "rejected"),
    chordal_only("rejected", "proof"),
    no_kernel("rejected", "proof", "html"),
    OF_TRUTH,
)
#: Of several components, and of a part of a file.
OF_PARTS = (
    Rule("--best writes one estimate; use --components largest", "best", "several"),
    Rule("--proof needs a connected graph; write each component to a file", "proof", "several"),
    Rule("--proof needs an estimate of all nodes: it is about the whole file", "proof", "part"),
    Rule("--html shows one estimate; use --components largest", "html", "several"),
)


@takes_reading
@tells_unwritten("best", "csv", "proof", "html")
def command(
    graph: GraphName,
    estimates: Annotated[
        list[str], estimate_argument("File or dataset with poses; several need --csv.")
    ],
    cost: CostOption = None,
    kernel: KernelOption = None,
    best: Annotated[
        Path | None,
        typer.Option("-o", "--out", "--best", metavar="OUT", help="Write the best estimate found."),
    ] = None,
    html: HtmlOut = None,
    proof: ProofOut = None,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="OUT", help="Write a row per ESTIMATE."),
    ] = None,
    time_limit: Annotated[
        float | None,
        time_limit_option("For each ESTIMATE: stop, and print what is proven by then.", "none"),
    ] = None,
    rejected: Annotated[
        Path | None,
        typer.Option(
            "--rejected",
            metavar="CSV",
            rich_help_panel=JUDGING,
            help="Measurements that were rejected, as certpgo outliers writes them with their "
            "prices: the verdict is about the truncated cost.",
        ),
    ] = None,
    quantile: Quantile = None,
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine",
            rich_help_panel=JUDGING,
            help="Run local descent before computing the bound.",
        ),
    ] = True,
    tier: Annotated[str | None, tier_option("standard, or proof with --proof")] = None,
    rtol: Annotated[
        float,
        tolerance_option("rtol", "Tolerance on the gap, relative to the cost."),
    ] = 1e-5,
    atol: Annotated[
        float,
        tolerance_option(
            "atol", "Additional tolerance, relative to the total weight W, up to 0.001 of the cost."
        ),
    ] = 1e-12,
    reference: Reference = None,
    truth: TruthFile = None,
    truth_offset: TruthOffset = 0.0,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Certify estimates of a graph: prove how far each can be from the optimum.

    Ctrl-C or SIGTERM prints what is proven by then; a second Ctrl-C aborts.
    """
    from certpgo.graph.components import require_pose
    from certpgo.io.digits import writing_of
    from certpgo.io.matching import Matching
    from certpgo.io.timestamps import file_of_times, timed, timed_by
    from certpgo.solve.batch import JudgedPart
    from certpgo.solve.judging import Judge

    if len(estimates) > 1 and csv is None:
        raise InputError("several estimates need --csv OUT")
    tier = tier_for(proof, tier, cost) or "standard"
    outputs = Outputs(estimate=best, csv=csv, proof=proof, html=html, json=json)
    outputs.refuse()
    source, of_truth = reading.resolve(graph), reading.resolve(truth)
    sources = _resolved(estimates, reading, batch=csv is not None)
    here = [found for found in sources.values() if not isinstance(found, InputError)]
    others = (*reading.others, of_truth, file_of_times(timestamps), rejected)
    outputs.refuse(source, *here, *others)
    with graph_comes_first("certify", source, here):
        instance = timed(reading.open(source, operation=None), timestamps)
    require_for(instance, proof=proof, kernel=kernel)
    chosen = chosen_cost(cost, instance, **{"rejected --proof": rejected and proof})
    how = Matching.of(timestamps, max_difference)
    again: dict[str, Any] = {"rejected": rejected, "quantile": quantile, "timestamps": timestamps}
    again["max-difference"] = max_difference
    asked = Asked(graph, chosen, reading, estimates[0], best is not None, again, kernel)
    outputs = outputs.about(source, instance, asked.cost)
    status = StatusLine()
    settings: dict[str, Any] = {"tier": tier, "rtol": rtol, "atol": atol, "refine": refine}
    settings |= {"time_limit": time_limit, "monitor": status, "ctrl_c": True}

    posed = posing(instance, asked.cost, rejected, quantile, kernel)

    def judged(of: Instance) -> list[JudgedPart]:
        return [JudgedPart(*one, Judge(one[1], **settings)) for one in posed(reading.parts(of))]

    if csv is not None:
        return _batch(estimates, sources, instance, judged, how, csv, json, reading, status)
    [of_estimate] = here  # several need --csv
    whole, estimate = covered(of_estimate, instance, reading, how)
    parts = judged(whole)
    found = {"several": len(parts) > 1, "part": whole is not instance}
    refuse(OF_PARTS, best=best, proof=proof, html=html, **found)
    require_pose(reference, [part.instance for part in parts], "--reference")
    given = [restricted_to(part.instance, estimate, whole) for part in parts]
    parts = [
        replace(part, instance=timed_by(point, part.instance))
        for part, point in zip(parts, given, strict=True)
    ]
    that, writing = how.of_truth(truth_offset), writing_of(of_estimate.path())
    truths = [KnownPoses.of(of_truth, part.instance, reading, that) for part in parts]

    def assessed(part: JudgedPart, point: Estimate, truth: KnownPoses | None) -> _Assessed:
        with working(f"certifying {part.instance.name}") as status.line:
            found = part.assessed(point, writing)
            disagreement = None if part.judge.ended_by else _disagreement(part.problem, found)
        title = "" if part.instance.name == instance.name else part.instance.name
        kept = found.certificate, part, point, found, disagreement, truth
        return _Assessed(*kept, asked, title, reference)

    return emit(map(assessed, parts, given, truths), [outputs] * len(parts))


@dataclass(frozen=True)
class _Assessed(Result):
    """The verdict on an estimate of a connected graph, which text names by its title, if any."""

    part: JudgedPart
    given: Estimate
    found: Assessment
    disagreement: Disagreement | None
    truth: KnownPoses | None
    asked: Asked
    title: str
    reference: int | None

    needs_the_end: ClassVar = ("proof", "html")

    @property
    def standing(self) -> str:
        return "what is proven by then stands" if self.part.judge.interrupted else ""

    @property
    def accuracy(self) -> TrajectoryErrors | None:
        """Trajectory errors, if the truth is known."""
        return None if self.truth is None else self.truth.errors(self.given)

    @cached_property
    def cause(self) -> Finding | None:
        """What explains an estimate that is not certified, or far from the truth."""
        part, known = self.part, (self.found.certificate, self.truth)
        return cause_of(part.instance, part.problem, self.given, *known)

    @property
    def distance(self) -> ProvenDistance | None:
        """How far all optima can be; None where nothing is known of them."""
        return _verdict.distance_of(self.found.certificate, self.reference, self.part.instance)

    def write(self, outputs: Outputs) -> None:
        outputs.write(self.found.best, instance=self.part.instance)

    def show(self, outputs: Outputs) -> None:
        from certpgo.solve.accuracy_wording import accuracy

        found, instance = self.found, self.part.instance
        steps = steps_after(
            found.certificate,
            instance,
            self.asked,
            disagreement=self.disagreement,
        )
        if self.title:
            typer.echo(self.title)
        _verdict.headline(found.certificate)
        _verdict.show(
            found.certificate,
            instance,
            found,
            self.disagreement,
            more=[
                *cause(self.cause),
                *_verdict.distance(self.distance, instance),
                *([] if self.accuracy is None else accuracy(self.accuracy)),
            ],
            cost=self.asked.known_cost,
            steps=steps,
            fit=found.fit,
        )

    def report(self, outputs: Outputs) -> dict[str, Any]:
        judged = _verdict.as_json(
            self.part.instance,
            self.found.certificate,
            self.found.cost,
            disagreement=self.disagreement,
            assessment=self.found,
            accuracy=self.accuracy,
            fit=self.found.fit,
            best_fit=self.found.best_fit,
            under=self.asked.known_cost,
        )
        far = _verdict.distance_as_json(self.distance, self.part.instance)
        return {**judged, **far, **cause_as_json(self.cause)}

    def notices(self, outputs: Outputs) -> Iterator[str]:
        yield from _verdict.warnings(self.found.best_fit)
        if outputs.estimate is not None:
            yield f"best estimate written to {outputs.estimate}"
        elif is_better_known(self.found, outputs.json):
            yield "--best OUT writes the lower-cost estimate"

    def prove(self, out: Path, source: Path, *, json: bool) -> bool:
        prices = getattr(self.part.problem, "prices", None)
        of = self.part.instance, self.given, self.found.certificate
        return prove(out, source, *of, prices=prices, json=json)

    def write_page(self, out: Path, outputs: Outputs) -> None:
        from certpgo.solve.accuracy_wording import disagreeing

        part, disagreement = self.part, self.disagreement
        remarks = [*remark_of(self.cause)]
        if disagreement is not None:
            remarks.append(f"{disagreeing(disagreement, self.found.certificate)}.")
        origin = origin_of(
            self.asked.graph,
            self.asked.reading,
            judging=self.asked.judged_again(part.instance),
            estimate=self.asked.estimate,
            proof=outputs.proof,
            remarks=remarks,
            disagreeing=disagreement is not None,
        )
        problem = cast("Certifiable", part.problem)  # --rejected is refused
        of = part.instance, problem, self.given, self.found
        write_page(out, *of, origin, distance=self.distance)


def _resolved(
    names: Sequence[str], reading: Reading, *, batch: bool
) -> dict[str, Source | InputError]:
    """What each estimate is; in a batch, the error of one that is missing, for its row."""
    found: dict[str, Source | InputError] = {}
    for name in names:
        try:
            found[name] = reading.resolve(name)
        except InputError as error:
            if not batch:
                raise
            found[name] = error
    return found


def _disagreement(problem: Judged, found: Assessment) -> Disagreement | None:
    """Measurements that disagree with the rest, by their terms of the cost."""
    from certpgo.solve.outliers import disagreement

    if problem.takes_scales or len(problem.rejected):
        return None
    return disagreement(cast("Any", problem), found.best, refit=not found.best_is_optimal)


def _batch(
    names: Sequence[str],
    sources: dict[str, Source | InputError],
    instance: Instance,
    judged: Callable[[Instance], list[JudgedPart]],
    how: Matching,
    out: Path,
    json: bool,
    reading: Reading,
    status: StatusLine,
) -> int:
    """Certify every estimate, with progress on stderr; returns the exit code."""
    from dataclasses import asdict

    from certpgo.certify.wording import named_cost
    from certpgo.graph.phrases import cost_shown
    from certpgo.solve.batch import JudgedPart, judge_all, write_rows

    whole, used, rows = judged(instance), list[JudgedPart](), []
    with working("certifying") as status.line:

        def read(name: str) -> Iterator[tuple[JudgedPart, Estimate]]:
            status.line.update(f"certifying {name}")
            source = sources[name]
            if isinstance(source, InputError):
                raise source
            of, estimate = covered(source, instance, reading, how)
            parts = whole if of is instance else judged(of)
            used.extend(parts)
            return ((part, restricted_to(part.instance, estimate, of)) for part in parts)

        for row in judge_all(names, read):
            rows.append(row)
            done = len({row.estimate for row in rows})
            result = row.reason
            if row.cost is not None:
                result = f"{row.estimate}: {named_cost(row.objective)} = {cost_shown(row.cost)}"
            typer.echo(f"{done}/{len(sources)} {row.verdict} {result}", err=True)
    write_rows(out, rows)
    if json:
        document([asdict(row) for row in rows])
    if any(part.judge.interrupted for part in used):
        tell_interrupted(f"{out} has {len({r.estimate for r in rows})} of {len(sources)} estimates")
        return INTERRUPTED
    return _verdict.weakest(row.verdict for row in rows)
