"""certpgo solve: estimate a graph with a certificate, by the pipeline or another method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import ends_at_once
from certpgo.cli._options import (
    CostOption,
    GraphName,
    HtmlOut,
    Json,
    ProofOut,
    chosen_cost,
    refuse_chordal_only,
    refuse_unprovable,
    tier_option,
)
from certpgo.cli._paging import origin_of, require_pages, write_page
from certpgo.cli._proving import REFUSED, provable_source, prove
from certpgo.cli._reading import Reading, restricted_to, takes_reading
from certpgo.cli._show import document, facts, notice, noticing, working
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable, targets_of
from certpgo.errors import InputError
from certpgo.optimize.monitor import Iteration, Monitor, TableMonitor

if TYPE_CHECKING:
    from certpgo import SolveSettings
    from certpgo.certify import Certificate
    from certpgo.graph import Estimate, Instance
    from certpgo.optimize.solution import Solution, Solver
    from certpgo.solvers.certified import CertifiedSolution
    from certpgo.solvers.certified.disagreement import Disagreement


_UNPROVABLE = (
    "a proof is about all measurements of a file, not about those that a robust method keeps; "
    "write a graph of these (see Reject outliers) and prove its estimate"
)


@takes_reading
def command(
    graph: GraphName,
    method: Annotated[
        str | None,
        typer.Option("--method", help="Use another method (certpgo list methods)."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Setting of --method."),
    ] = None,
    cost: CostOption = None,
    initial: Annotated[Path | None, typer.Option("--initial", help="Initial estimate.")] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write the estimate to this file.")
    ] = None,
    format: Annotated[
        str | None, typer.Option("--format", help="Format of --out; by default from its suffix.")
    ] = None,
    proof: ProofOut = None,
    html: HtmlOut = None,
    certify: Annotated[
        bool, typer.Option("--certify/--no-certify", help="Certify the estimate of --method.")
    ] = True,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            metavar="SECONDS",
            min=0.0,
            show_default="30 s after a first bound",
            help="Stop and return the best estimate so far.",
        ),
    ] = None,
    max_rank: Annotated[
        int | None,
        typer.Option(
            "--max-rank", min=2, show_default="d + 7", help="Highest rank of the staircase."
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Reject measurements that disagree with the rest."),
    ] = False,
    tier: Annotated[
        str | None,
        tier_option("standard; proof with --proof, or if only rounding prevents CERTIFIED"),
    ] = None,
    trace: Annotated[bool, typer.Option("--trace", help="Print every iteration.")] = False,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Find the best estimate of a graph and prove how good it is.

    The certified pipeline initializes, optimizes and certifies; if that fails, it climbs the
    Riemannian staircase. Ctrl-C returns the best estimate so far; a second Ctrl-C aborts. With
    --method, the first Ctrl-C aborts. With --robust the verdict is only about the measurements that
    are kept.
    """
    from certpgo import SolveSettings
    from certpgo.io import read_estimate, write
    from certpgo.io.format import format_to_write
    from certpgo.registry import build, parse_settings, refuse_unsuited

    _refuse_mixtures(method, settings, certify, robust, time_limit, max_rank)
    refuse_chordal_only(cost, method=method, robust=robust)
    refuse_unprovable(cost, proof)
    if robust and proof is not None:
        raise InputError(_UNPROVABLE)
    if proof is not None:
        _verdict.refuse_screening(tier)
        tier = tier or "proof"
    if out is not None:
        format_to_write(out, format)  # report a wrong suffix before any work
    for written in (out, proof, html):
        refuse_unwritable(written)
    require_pages(html)
    source = reading.resolve(graph)
    refuse_overwriting([out, proof, html], [source, initial])
    provable = None if proof is None else provable_source(source)
    instance = reading.open(source)
    parts = reading.parts(instance)
    for name, output in (("--proof", proof), ("--html", html)):
        if output is not None and (len(parts) > 1 or not certify):
            raise InputError(f"{name} needs a connected graph and a certified estimate")
    targets = targets_of(out, parts)
    refuse_overwriting(targets, [source, initial])
    with noticing():
        start = None if initial is None else read_estimate(initial, instance)
    solver = None
    if method is not None:
        solver = build(method, parse_settings(method, settings or ()))
        for part in parts:
            refuse_unsuited(method, solver, part.graph)
        if initial is not None and not getattr(solver, "takes_initial", True):
            raise InputError(f"{method} takes no initial estimate: not with --initial")
    own = chosen_cost(cost, instance, method=method, robust=robust)
    results: list[_Result] = []
    proven = True
    for part, target in zip(parts, targets, strict=True):
        begin = restricted_to(part, start, instance)
        with working(f"solving {part.name}") as status:
            monitor = TableMonitor() if trace else _StatusLine(status)
            if solver is None or method is None:
                limits = SolveSettings(time_limit=time_limit, max_rank=max_rank, tier=tier)
                result = _certified(part, begin, limits, robust, monitor, own)
            else:
                requested = (tier or "standard") if certify else None
                result = _by_method(part, method, solver, begin, requested, monitor, status)
        if target is not None:
            with noticing():
                write(target, result.solution.estimate, instance=part, format=format)
        results.append(result)
        if trace and not result.solution.trace:
            notice(f"{result.method} reports no iterations: nothing to --trace")
        if not json:
            result.show(target)
        if proof and provable and not result.interrupted:
            proven = result.prove(proof, provable, json=json)
        if html is not None:
            checked = proof if proven and not result.interrupted else None
            result.write_page(html, graph, target, checked, reading)
        if result.interrupted:
            break
    if json:
        reports = [result.report(target) for result, target in zip(results, targets, strict=False)]
        document(reports[0] if len(reports) == 1 else reports)
    if results[-1].interrupted:
        return _verdict.INTERRUPTED
    code = _verdict.exit_code(r.certificate for r in results if r.certificate is not None)
    return code if proven else code or REFUSED


@dataclass(frozen=True)
class _Result:
    """The result for a connected graph."""

    part: Instance
    method: str
    solution: Solution
    certificate: Certificate | None
    found: CertifiedSolution | None = None  # by the certified pipeline
    cost: str = "chordal"

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the search."""
        return self.solution.status.value == "interrupted"

    @property
    def disagreement(self) -> Disagreement | None:
        """Measurements that disagree with the rest."""
        return None if self.found is None else self.found.disagreement

    @property
    def certified_cost(self) -> float:
        """F of the certified measurements, those that a robust method kept."""
        from certpgo.objective.problem import problem_of

        if self.solution.weights is None:
            return self.solution.cost
        return self.solution.judged(problem_of(self.part.graph)).cost(self.solution.estimate)

    def report(self, written: Path | None) -> dict[str, Any]:
        """The result for --json."""
        solution, found = self.solution, self.found
        levels = () if found is None else found.levels
        certificate, disagreement = self.certificate, self.disagreement
        return {
            **_verdict.as_json(
                self.part, certificate, self.certified_cost, disagreement=disagreement
            ),
            "solution": {
                "method": self.method,
                "start": None if found is None else found.start,
                "levels": [{**asdict(level), "status": level.status.value} for level in levels],
                "status": solution.status.value,
                "cost": solution.cost,
                "iterations": solution.iterations,
                "counts": dict(solution.counts),
                "seconds": dict(solution.seconds),
                "note": solution.note,
                "kept": solution.kept,
                "rejected": _verdict.edges_as_json(self.part, solution.rejected),
                "own_bound": solution.lower_bound,
                "settings": None if found is None else asdict(found.settings),
                "written": None if written is None else str(written),
            },
        }

    def _own_bound(self) -> str:
        """The method's own bound, in words."""
        bound = self.solution.lower_bound
        if bound is None:
            return "the gap to the optimum is not known"
        return f"the method's own lower bound, which ignores rounding, is {bound:.12g}"

    def show(self, written: Path | None) -> None:
        """Print the result."""
        from certpgo.assess.wording import few_edges

        solution, part = self.solution, self.part
        seconds = ", ".join(f"{phase} {value:.3f}" for phase, value in solution.seconds.items())
        lines = [("graph", part.name), ("method", self.method), ("ended", solution.status.value)]
        if solution.iterations:
            lines.append(("iterations", str(solution.iterations)))
        of_all = " (of all measurements)" if solution.kept is not None else ""
        lines += [("cost F", f"{solution.cost:.12g}{of_all}"), ("seconds", seconds)]
        if solution.note:
            lines.append(("note", solution.note))
        if solution.kept is not None:
            lines.append(("kept", f"{solution.kept} of {part.graph.num_edges} measurements"))
        if len(solution.rejected):
            lines.append(("rejected", few_edges(part, solution.rejected)))
        if written is not None:
            lines.append(("written", str(written)))
        if self.found is not None and (chordal := self.found.chordal) is not None:
            verdict = f"{chordal.verdict.value}, F = {chordal.cost:.12g} at another estimate"
            lines.append(("chordal cost", verdict))
        facts(lines)
        if self.certificate is None:
            notice(f"{self._own_bound()}; --certify certifies the estimate")
            return
        typer.echo()
        if solution.kept is not None:
            typer.echo("The certificate is about the kept measurements, with their final weights:")
        _verdict.show(self.certificate, part.options, disagreement=self.disagreement)
        uncertified = self.certificate.verdict.value != "CERTIFIED"
        if self.found is None and solution.kept is None and uncertified:
            notice("without --method, certpgo searches for the best estimate")

    def prove(self, out: Path, source: Path, *, json: bool) -> bool:
        """Write the proof; returns False if there is none."""
        if len(self.solution.rejected):
            notice(f"no proof is written: {_UNPROVABLE}")
            return False
        if self.certificate is None:
            return True
        estimate = self.solution.estimate
        return prove(out, source, self.part, estimate, self.certificate, json=json)

    def write_page(
        self, out: Path, graph: str, written: Path | None, proof: Path | None, reading: Reading
    ) -> None:
        """Write the page of the certificate."""
        from certpgo.assess.assessment import assess
        from certpgo.assess.wording import hint
        from certpgo.costs import problem_under

        solution, part = self.solution, self.part
        if self.certificate is None:
            return
        remarks = [f"Status: {solution.status.value}; {solution.note}."] if solution.note else []
        if solution.kept is not None:
            remarks.append(
                f"The verdict is about the {solution.kept} of {part.graph.num_edges} measurements "
                "that the method kept, with their final weights; the view shows these."
            )
        if self.disagreement is not None:
            remarks.append(f"{hint(self.disagreement)}.")
        problem = solution.judged(problem_under(part, self.cost))
        assessment = assess(problem, solution.estimate, self.certificate, ids=part.ids)
        origin = origin_of(
            graph,
            reading,
            estimate=written,
            proof=proof,
            method=self.method,
            remarks=remarks,
            partial=len(solution.rejected) > 0,
            settings=None if self.found is None else self.found.settings,
        )
        write_page(out, part, problem, solution.estimate, assessment, origin, solution.trace)


class _StatusLine:
    """The monitor that updates the spinner's line."""

    def __init__(self, status: Any) -> None:
        self.status = status

    def __call__(self, iteration: Iteration) -> bool:
        reached = f"F {iteration.cost:.8g}, gradient {iteration.gradient:.0e}"
        self.status.update(f"iteration {iteration.number}: {reached}")
        return False


def _certified(
    part: Instance,
    initial: Estimate | None,
    settings: SolveSettings,
    robust: bool,
    monitor: Monitor,
    cost: str,
) -> _Result:
    from certpgo import solve, solve_robustly

    search: Callable[..., CertifiedSolution] = solve_robustly
    if not robust:
        search = partial(solve, cost=cost, on_disagreement=_hinting)
    found = search(part.graph if robust else part, settings, initial=initial, monitor=monitor)
    method = "robust" if robust else "certified"
    return _Result(part, method, found.solution, found.certificate, found, cost)


def _hinting(found: Disagreement) -> None:
    from certpgo.assess.wording import hint

    notice(hint(found))


def _by_method(
    part: Instance,
    name: str,
    solver: Solver,
    initial: Estimate | None,
    tier: str | None,
    monitor: Monitor,
    status: Any,
) -> _Result:
    from certpgo.certify import certify
    from certpgo.objective.problem import problem_of

    problem = problem_of(part.graph)
    with ends_at_once() if getattr(solver, "compiled", False) else nullcontext():
        solution = solver.solve(problem, initial=initial, monitor=monitor)
    if tier is None:
        return _Result(part, name, solution, None)
    status.update(f"certifying the estimate of {part.name}")
    certificate = certify(solution.judged(problem), solution.estimate, tier=tier)
    return _Result(part, name, solution, certificate)


def _refuse_mixtures(
    method: str | None,
    settings: Sequence[str] | None,
    certify: bool,
    robust: bool,
    time_limit: float | None,
    max_rank: int | None,
) -> None:
    """Refuse combinations in which an option would be ignored."""
    if method is None and settings:
        raise InputError("--set needs --method")
    if method is None and not certify:
        raise InputError("--no-certify needs --method")
    if method is not None and (time_limit is not None or max_rank is not None):
        raise InputError("--time-limit and --max-rank cannot be combined with --method")
    if method is not None and robust:
        raise InputError("--robust chooses its own method: not with --method")
