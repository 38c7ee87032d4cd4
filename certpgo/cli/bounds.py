"""certpgo bounds: every bound on a graph, cheapest first, and its implication."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._interrupting import ends_at_once
from certpgo.cli._options import GraphName, Json, MaxDifference, Timestamps, estimate_argument
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Reading, covered, restricted_to, takes_reading
from certpgo.cli._show import document, facts, notice, table, working
from certpgo.cli._swapped import graph_comes_first

if TYPE_CHECKING:
    from certpgo.graph import Estimate, Instance
    from certpgo.solve.rungs import Ladder, Rung


EXAMPLES = (
    "certpgo bounds graph.g2o",
    "certpgo bounds graph.g2o estimate.tum",
)


@takes_reading
def command(
    graph: GraphName,
    estimate: Annotated[
        str | None,
        estimate_argument("Estimate to judge (default: the best found)."),
    ] = None,
    sdp: Annotated[
        bool, typer.Option("--sdp", help="Also solve the semidefinite program (slow).")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Solve it even if memory may run out.")
    ] = False,
    cycles: Annotated[
        Path | None,
        typer.Option(
            "--cycles",
            metavar="FILE",
            help="Write the proof by cycles about the rotations (certpgo check GRAPH FILE).",
        ),
    ] = None,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    json: Json = False,
    *,
    reading: Reading,
) -> None:
    """Compute bounds on the optimum, cheapest first, and what each implies for an estimate.

    They are about the chordal cost F, whatever the default cost of the graph is.
    """
    from certpgo.certify.cycle_file import provable_by_cycles
    from certpgo.graph.phrases import listed
    from certpgo.io.matching import Matching
    from certpgo.io.timestamps import timed
    from certpgo.objective.choose_cost import CHORDAL, own_cost
    from certpgo.objective.quadratic import Quadratic
    from certpgo.solve.bounds_table import ladder

    source, of_estimate = reading.resolve(graph), reading.resolve(estimate)
    with graph_comes_first("bounds", source, [] if of_estimate is None else [of_estimate]):
        instance = timed(reading.open(source, operation="bounds"), timestamps)
    given: Estimate | None = None
    if of_estimate is not None:
        how = Matching.of(timestamps, max_difference)
        instance, given = covered(of_estimate, instance, reading, how)
    if (own := own_cost(instance)) != CHORDAL:
        notice(f"the bounds are about the chordal cost F, not the default cost of {own}")
    outputs = Outputs(proof=cycles)
    outputs.refuse(source, of_estimate)
    written = None if cycles is None else provable_by_cycles(source.path(), instance)
    if blocks := instance.graph.blocks:
        others = listed([block.kind.plural for block in blocks])
        notice(f"the bounds are about F without {others}, whose terms are never negative")
        instance = replace(instance, graph=instance.graph.with_blocks(), numbers=None)
    documents = []
    parts = reading.parts(instance)
    for part in parts:
        point = None if given is None else restricted_to(part, given, instance)
        with working(f"bounds of {part.name}"), ends_at_once() if sdp else nullcontext():
            tried = True if cycles is not None else None
            found = ladder(Quadratic(part.graph), point, sdp=sdp, force=force, cycles=tried)
        if cycles is not None and written is not None:
            _write(cycles, written, part, found)
        if json:
            documents.append(_as_json(part, found))
        else:
            _show(part, found)
    if json:
        document(documents[0] if len(documents) == 1 else documents)


def _write(path: Path, source: Path, part: Instance, found: Ladder) -> None:
    """Write what cycles prove, optimal or not, as a lower bound it is."""
    from certpgo.certify.cycle_file import write_cycles

    if found.cycles is None:
        notice(f"no proof was written to {path}: {_by_cycles(found).says}")
    else:
        notice(f"{path}: {write_cycles(path, source, part, found.cycles)} (certpgo check)")


def _by_cycles(found: Ladder) -> Rung:
    return next(rung for rung in found.rungs if rung.key == "cycles")


def _as_json(part: Instance, found: Ladder) -> dict[str, Any]:
    """Bounds on the chordal cost, with angles in radians."""
    from certpgo.certify.wording import objective

    proof = found.cycles
    by_cycles = proof and {
        "proven": proof.proven,
        "reason": proof.reason,
        "ratio": proof.ratio if math.isfinite(proof.ratio) else None,
        "lower_bound": proof.lower_bound,
        "number": len(proof.cycles),
    }
    return {
        "graph": part.name,
        "options": dict(part.options),
        "objective": objective(part.options),
        "cost": found.cost,
        "given": found.given,
        "angles": "radians",
        "max_residual_angle": found.largest,
        "max_residual_angle_of_stationary_rotations": found.settled,
        "verdict": found.certificate.verdict.value,
        "cycles": by_cycles,
        "bounds": [asdict(rung) for rung in found.rungs],
    }


def _show(part: Instance, found: Ladder) -> None:
    facts(_head(part, found))
    rows = [(rung.title, rung.shown, rung.says, rung.needs, _seconds(rung)) for rung in found.rungs]
    table(
        "",
        ("bound", "value", "implication here", "what it needs", "seconds"),
        rows,
        optional=OPTIONAL,
    )


#: Columns that narrow terminals do without, the first one first.
OPTIONAL = ("what it needs", "seconds")


def _head(part: Instance, found: Ladder) -> Iterable[tuple[str, str]]:
    from certpgo.certify.wording import objective
    from certpgo.graph.phrases import cost_shown

    yield "graph", part.name
    source = "of the given estimate" if found.given else "of the best estimate found"
    cost = cost_shown(found.certificate.cost_upper)
    yield "chordal cost F", f"{cost}  ({source}: {found.certificate.verdict.value})"
    yield "largest residual", f"{math.degrees(found.largest):.4g} degrees"
    if found.settled is not None:
        after = "after local descent, where the residual-angle bounds apply"
        yield "", f"{math.degrees(found.settled):.4g} degrees {after}"
    yield "objective", objective(part.options)


def _seconds(rung: Rung) -> str:
    return "-" if rung.value is None and rung.seconds == 0.0 else f"{rung.seconds:.3f}"
