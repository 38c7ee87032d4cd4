"""certpgo solve: the best estimate of a graph, with a certificate; or any method's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._paging import origin_of, require_pages, write_page
from certpgo.cli._proving import REFUSED, provable_source, prove
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, facts, notice, noticing, working
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable
from certpgo.errors import InputError
from certpgo.optimize.monitor import Iteration, Monitor, TableMonitor

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Estimate, Instance
    from certpgo.optimize.solution import Solution, Solver
    from certpgo.solvers.certified.disagreement import Disagreement
    from certpgo.solvers.certified.staircase import Level


@takes_reading
def command(
    graph: Annotated[str, typer.Argument(metavar="GRAPH", help="A file or dataset.")],
    method: Annotated[
        str | None,
        typer.Option("--method", help="A method of certpgo list methods instead."),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting of it.")
    ] = None,
    initial: Annotated[
        Path | None, typer.Option("--initial", help="Estimate to start from.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File for the estimate, see convert.")
    ] = None,
    format: Annotated[
        str | None, typer.Option("--format", help="Format of it, by default by its suffix.")
    ] = None,
    proof: Annotated[
        Path | None,
        typer.Option("--proof", metavar="OUT", help="Write a proof that certpgo check checks."),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="OUT", help="Write a page about the answer, with a view."),
    ] = None,
    certify: Annotated[
        bool, typer.Option("--certify/--no-certify", help="Judge the answer of --method as well.")
    ] = True,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            metavar="SECONDS",
            min=0.0,
            help="Stop with the best so far; otherwise the climb ends 30 s after a first bound.",
        ),
    ] = None,
    max_rank: Annotated[
        int | None,
        typer.Option("--max-rank", min=2, help="Where the staircase ends. [default: d + 7]"),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Leave out measurements that disagree with the rest."),
    ] = False,
    tier: Annotated[
        str | None,
        typer.Option(
            "--tier",
            help="What may be trusted: proof, standard, or screen (a hint). "
            "[default: standard; proof with --proof, or where rounding is all that is missing]",
        ),
    ] = None,
    trace: Annotated[bool, typer.Option("--trace", help="Print every iteration.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    *,
    reading: Reading,
) -> int:
    """Find the best estimate of a graph and prove how good it is.

    Without --method: start, optimise, certify, and climb the Riemannian staircase where that
    fails. Ctrl-C returns the best estimate so far; a second one abandons it. With --robust,
    measurements that disagree with the rest are left out, and the verdict is about the others.
    """
    from certpgo.io import read_estimate, write
    from certpgo.io.format import format_to_write
    from certpgo.registry import build, parse_settings, refuse_unsuited

    _refuse_mixtures(method, settings, certify, robust, time_limit, max_rank)
    if proof is not None:
        _verdict.refuse_screening(tier)
        tier = tier or "proof"
    if out is not None:
        format_to_write(out, format)  # a wrong suffix is said before the work, not after
    for written in (out, proof, html):
        refuse_unwritable(written)
    require_pages(html)
    refuse_overwriting([out, proof, html], [graph, initial], reading.data)
    source = None if proof is None else provable_source(graph, reading)
    instance = reading.open(graph)
    parts = reading.parts(instance)
    if proof is not None and (len(parts) > 1 or not certify):
        raise InputError("--proof is about a connected graph, and an answer that is certified")
    if html is not None and (len(parts) > 1 or not certify):
        raise InputError("--html is about a connected graph, and an answer that is certified")
    targets = _targets(out, parts)
    refuse_overwriting(targets, [graph, initial], reading.data)
    with noticing():
        start = None if initial is None else read_estimate(initial, instance)
    solver = None
    if method is not None:
        solver = build(method, parse_settings(method, settings or ()))
        for part in parts:
            refuse_unsuited(method, solver, part.graph)
    answers: list[_Answer] = []
    proven = True
    for part, target in zip(parts, targets, strict=True):
        begin = _restricted(start, instance, part)
        with working(f"solving {part.name}") as status:
            monitor = TableMonitor() if trace else _Telling(status)
            if solver is None or method is None:
                answer = _certified(part, begin, time_limit, max_rank, tier, robust, monitor)
            else:
                judging = (tier or "standard") if certify else None
                answer = _by_method(part, method, solver, begin, judging, monitor, status)
        if target is not None:
            with noticing():
                write(target, answer.solution.estimate, instance=part, format=format)
        answers.append(answer)
        if not json:
            answer.show(part, target)
        certificate, estimate = answer.certificate, answer.solution.estimate
        if proof and len(answer.solution.rejected):
            notice(
                "no proof is written: it would be about all measurements, not only the kept ones; "
                "write a graph of these (see Reject outliers) and prove that"
            )
            proven = False
        elif proof and source and certificate is not None and not answer.interrupted:
            proven = prove(proof, source, part, estimate, certificate, json=json)
        if html is not None and certificate is not None:
            checked = proof if proven and not answer.interrupted else None
            _page(html, graph, part, answer, target, checked, reading)
        if answer.interrupted:
            break
    if json:
        reports = [
            answer.report(part, target)
            for answer, part, target in zip(answers, parts, targets, strict=False)
        ]
        document(reports[0] if len(reports) == 1 else reports)
    if answers[-1].interrupted:
        return _verdict.INTERRUPTED
    code = _verdict.exit_code(a.certificate for a in answers if a.certificate is not None)
    return code if proven else code or REFUSED


@dataclass(frozen=True)
class _Answer:
    """What a part of the graph got."""

    name: str
    solution: Solution
    certificate: Certificate | None
    start: str | None = None
    levels: Sequence[Level] = ()
    disagreement: Disagreement | None = None

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the search."""
        return self.solution.status.value == "interrupted"

    def report(self, part: Instance, written: Path | None) -> dict[str, Any]:
        """For --json."""
        solution, certificate = self.solution, self.certificate
        return {
            "graph": part.name,
            "options": dict(part.options),
            "method": self.name,
            "start": self.start,
            "levels": [
                {"rank": level.rank, "cost": level.cost, "eigenvalue": level.eigenvalue}
                for level in self.levels
            ],
            "status": solution.status.value,
            "cost": solution.cost,
            "iterations": solution.iterations,
            "counts": dict(solution.counts),
            "seconds": dict(solution.seconds),
            "note": solution.note,
            "kept": solution.kept,
            "rejected": _verdict.edges_as_json(part, solution.rejected),
            "disagreement": _verdict.disagreement_as_json(part, self.disagreement),
            "certificate_of": "all measurements" if solution.kept is None else "those kept",
            "lower_bound": solution.lower_bound,
            "written": None if written is None else str(written),
            "certificate": None if certificate is None else _verdict.as_json(certificate),
        }

    def _own_bound(self) -> str:
        """How far the method itself says that its answer is from the best possible."""
        bound = self.solution.lower_bound
        if bound is None:
            return "how far this is from the best possible is not known"
        said = f"no answer costs less than {bound:.12g}"
        return f"the method's own bound, not proven against rounding, is that {said}"

    def show(self, part: Instance, written: Path | None) -> None:
        """For people."""
        from certpgo.assess.wording import few_edges

        solution = self.solution
        seconds = ", ".join(f"{phase} {value:.3f}" for phase, value in solution.seconds.items())
        lines = [("graph", part.name), ("method", self.name), ("ended", solution.status.value)]
        if solution.iterations:
            lines.append(("iterations", str(solution.iterations)))
        lines += [("cost F", f"{solution.cost:.12g}"), ("seconds", seconds)]
        if solution.note:
            lines.append(("note", solution.note))
        if solution.kept is not None:
            lines.append(("kept", f"{solution.kept} of {part.graph.num_edges} measurements"))
        if len(solution.rejected):
            lines.append(("rejected", few_edges(part, solution.rejected)))
        if written is not None:
            lines.append(("written", str(written)))
        facts(lines)
        if self.certificate is None:
            notice(f"{self._own_bound()}; --certify judges it")
            return
        typer.echo()
        if solution.kept is not None:
            typer.echo(
                "What follows is about the measurements that were kept, with the weights they "
                "ended with:"
            )
        _verdict.show(self.certificate, part.options, disagreement=self.disagreement)
        uncertified = self.certificate.verdict.value != "CERTIFIED"
        if self.start is None and solution.kept is None and uncertified:
            notice("without --method the best answer is searched for")


class _Telling:
    """The monitor that keeps the spinner's line up to date."""

    def __init__(self, status: Any) -> None:
        self.status = status

    def __call__(self, iteration: Iteration) -> bool:
        reached = f"F {iteration.cost:.8g}, gradient {iteration.gradient:.0e}"
        self.status.update(f"iteration {iteration.number}: {reached}")
        return False


def _certified(
    part: Instance,
    start: Estimate | None,
    time_limit: float | None,
    max_rank: int | None,
    tier: str | None,
    robust: bool,
    monitor: Monitor,
) -> _Answer:
    from certpgo import solve, solve_robustly

    solver = solve_robustly if robust else partial(solve, on_disagreement=_hinting)
    found = solver(
        part.graph,
        initial=start,
        time_limit=time_limit,
        max_rank=max_rank,
        tier=tier,
        monitor=monitor,
    )
    return _Answer(
        "robust" if robust else "certified",
        found.solution,
        found.certificate,
        found.start,
        found.levels,
        found.disagreement,
    )


def _hinting(told: Disagreement) -> None:
    from certpgo.assess.wording import hint

    notice(hint(told))


def _by_method(
    part: Instance,
    name: str,
    solver: Solver,
    start: Estimate | None,
    tier: str | None,
    monitor: Monitor,
    status: Any,
) -> _Answer:
    from certpgo.certify import certify
    from certpgo.objective.problem import problem_of

    problem = problem_of(part.graph)
    solution = solver.solve(problem, initial=start, monitor=monitor)
    if tier is None:
        return _Answer(name, solution, None)
    status.update(f"certifying the answer for {part.name}")
    certificate = certify(solution.judged(problem), solution.estimate, tier=tier)
    return _Answer(name, solution, certificate)


def _page(
    out: Path,
    graph: str,
    part: Instance,
    answer: _Answer,
    written: Path | None,
    proof: Path | None,
    reading: Reading,
) -> None:
    from certpgo.assess.assessment import assess
    from certpgo.assess.wording import hint
    from certpgo.objective.problem import problem_of

    solution, certificate = answer.solution, answer.certificate
    if certificate is None:
        return
    remarks = [f"It ended: {solution.status.value}; {solution.note}."] if solution.note else []
    if solution.kept is not None:
        remarks.append(
            f"The verdict is about the {solution.kept} of {part.graph.num_edges} measurements that "
            "the method kept, with the weights they ended with; the view shows these."
        )
    if answer.disagreement is not None:
        remarks.append(f"{hint(answer.disagreement)}.")
    problem = solution.judged(problem_of(part.graph))
    assessment = assess(problem, solution.estimate, certificate, ids=part.ids)
    origin = origin_of(
        graph,
        reading,
        estimate=written,
        proof=proof,
        method=answer.name,
        remarks=remarks,
        partial=len(solution.rejected) > 0,
    )
    write_page(out, part, problem, solution.estimate, assessment, origin, solution.trace)


def _refuse_mixtures(
    method: str | None,
    settings: Sequence[str] | None,
    certify: bool,
    robust: bool,
    time_limit: float | None,
    max_rank: int | None,
) -> None:
    """Options that belong to one way of solving are not silently ignored by the other."""
    if method is None and settings:
        raise InputError("--set needs --method")
    if method is None and not certify:
        raise InputError("--no-certify needs --method")
    if method is not None and (time_limit is not None or max_rank is not None):
        raise InputError("--time-limit and --max-rank do not go with --method")
    if method is not None and robust:
        raise InputError("--robust chooses its method: not with --method")


def _restricted(estimate: Estimate | None, instance: Instance, part: Instance) -> Estimate | None:
    import numpy as np

    if estimate is None or part is instance:
        return estimate
    return estimate.subset(np.searchsorted(instance.ids, part.ids))


def _targets(out: Path | None, parts: Sequence[Instance]) -> list[Path | None]:
    """The file of each part; several share no frame, and are named by their smallest ids."""
    if out is None or len(parts) == 1:
        return [out] * len(parts)
    return [out.with_stem(f"{out.stem}-{int(part.ids.min())}") for part in parts]
