"""certpgo solve: estimate the poses or rotations of a graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, facts, notice, working
from certpgo.cli._writing import refuse_overwriting

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.estimate import Estimate
    from certpgo.graph import Instance
    from certpgo.solution import Solution


@takes_reading
def command(
    graph: Annotated[str, typer.Argument(metavar="GRAPH", help="A file or dataset.")],
    method: Annotated[
        str | None,
        typer.Option("--method", help="See certpgo list methods. [default: eigen_ma, eigen_ra]"),
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
    certify: Annotated[
        bool, typer.Option("--certify/--no-certify", help="Judge the answer as well.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    *,
    reading: Reading,
) -> int:
    """Solve a graph, and judge the answer with --certify."""
    from certpgo.harness.methods import build, parse_settings
    from certpgo.harness.runner import refuse_other_problems
    from certpgo.io import read_estimate, write
    from certpgo.io.format import format_to_write
    from certpgo.problem import PoseProblem, problem_of

    if out is not None:
        format_to_write(out, format)  # a wrong suffix is said before the work, not after
    refuse_overwriting([out], [graph, initial], reading.data)
    instance = reading.open(graph)
    parts = reading.parts(instance)
    targets = _targets(out, parts)
    refuse_overwriting(targets, [graph, initial], reading.data)
    start = None if initial is None else read_estimate(initial, instance)
    reports: list[dict[str, Any]] = []
    certificates: list[Certificate] = []
    for part, target in zip(parts, targets, strict=True):
        problem = problem_of(part.graph)
        name = method or ("eigen_ma" if isinstance(problem, PoseProblem) else "eigen_ra")
        solver = build(name, parse_settings(name, settings or ()))
        refuse_other_problems(name, solver, part.graph)
        with working(f"{name} on {part.name}") as status:
            solution = solver.solve(problem, initial=_restricted(start, instance, part))
            certificate = None
            if certify:
                from certpgo.certify import certify as judge

                status.update(f"certifying the answer for {part.name}")
                certificate = judge(problem, solution.estimate)
                certificates.append(certificate)
        if target is not None:
            write(target, solution.estimate, instance=part, format=format)
        reports.append(_report(part, name, solution, certificate, target))
        if not json:
            _show(part, name, solution, certificate, target)
    if json:
        document(reports[0] if len(reports) == 1 else reports)
    return _verdict.exit_code(certificates)


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


def _report(
    part: Instance,
    name: str,
    solution: Solution,
    certificate: Certificate | None,
    written: Path | None,
) -> dict[str, Any]:
    return {
        "graph": part.name,
        "options": dict(part.options),
        "method": name,
        "status": solution.status.value,
        "cost": solution.cost,
        "iterations": solution.iterations,
        "seconds": dict(solution.seconds),
        "note": solution.note,
        "written": None if written is None else str(written),
        "certificate": None if certificate is None else _verdict.as_json(certificate),
    }


def _show(
    part: Instance,
    name: str,
    solution: Solution,
    certificate: Certificate | None,
    written: Path | None,
) -> None:
    seconds = ", ".join(f"{phase} {value:.3f}" for phase, value in solution.seconds.items())
    lines = [("graph", part.name), ("method", name), ("ended", solution.status.value)]
    if solution.iterations:
        lines.append(("iterations", str(solution.iterations)))
    lines += [("cost F", f"{solution.cost:.12g}"), ("seconds", seconds)]
    if solution.note:
        lines.append(("note", solution.note))
    if written is not None:
        lines.append(("written", str(written)))
    facts(lines)
    if certificate is None:
        notice("how far this is from the best possible is not known; --certify judges it")
        return
    typer.echo()
    _verdict.show(certificate, part.options)
    if certificate.verdict.value != "CERTIFIED":
        other = "" if name == "newton" else "--method newton, or "
        notice(f"try {other}certpgo certify --polish, which writes the best answer found")
