"""The ladder of bounds on two real graphs: what each says, and what it costs."""

from __future__ import annotations

from pathlib import Path

from certpgo import Quadratic
from certpgo.registry import get_solver
from certpgo.solve.bounds_table import ladder
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.timing import one_core

from . import _scenes, _style

#: Sets, whether rotations alone count, and whether a semidefinite program is within reach.
GRAPHS = (("smallGrid3D", True, True), ("sphere2500", False, False))
LABELS = {
    "spectral": "eigenvalues",
    "spectral_rotations": "eigenvalues, rotations alone",
    "spectral_poses": "eigenvalues, translations eliminated",
    "block_coordinate_descent": "block coordinate descent",
    "sdp": "semidefinite program",
    "proven": "certified solve, proven",
}
#: Where labels stand from their points, and how they are aligned, if not beside them to the right.
PLACES = {
    "sdp": ((-6, 0), "right"),
    "spectral_rotations": ((6, 3), "left"),
    "spectral_poses": ((6, -3), "left"),
}
#: What rounding leaves of the smallest gaps.
SMALLEST = 1e-12
MARKERS = {
    "spectral": ("o", _style.BLUE),
    "spectral_rotations": ("o", _style.BLUE),
    "spectral_poses": ("D", _style.SKY),
    "block_coordinate_descent": ("s", _style.ORANGE),
    "sdp": ("^", _style.VERMILION),
    "proven": ("v", _style.GREEN),
}


def compute(quick: bool, data: Path | None) -> Data:
    """Each bound, the part of the best cost that it leaves open, and its seconds."""
    names = _scenes.here(tuple(name for name, _, _ in GRAPHS), data)
    chosen = [entry for entry in GRAPHS if entry[0] in names]
    with one_core() as protocol:
        graphs = [_bounds(*entry, data, quick) for entry in (chosen[:1] if quick else chosen)]
    return {
        "graphs": graphs,
        "protocol": protocol,
        "said": "; ".join(
            f"on {g['name']} ({g['verdict']}) eigenvalues leave {g['rungs'][0]['open']:.1%} of the "
            f"cost open, the proof {g['rungs'][-1]['open']:.1e} of it"
            for g in graphs
        ),
    }


def _bounds(name: str, alone: bool, program: bool, data: Path | None, quick: bool) -> Data:
    graph = _scenes.load(name, data).graph
    graph = graph.rotations_alone if alone else graph
    problem = Quadratic(graph)
    climbed = ladder(problem, sdp=program and not quick)
    rungs = [
        {"key": rung.key, "value": rung.value, "seconds": rung.seconds}
        for rung in climbed.rungs
        if rung.about == "cost" and rung.value is not None
    ]
    if problem.has_positions:
        rungs[0]["key"] = "spectral_rotations"
    else:
        found = get_solver("block_coordinate_descent")().solve(Quadratic(graph))
        seconds = sum(found.seconds.values())
        between = {"key": "block_coordinate_descent", "value": found.lower_bound}
        rungs.insert(1, {**between, "seconds": seconds})
    for rung in rungs:
        rung["open"] = 1.0 - rung["value"] / climbed.cost
    return {
        "name": name,
        "n": problem.n,
        "m": graph.num_edges,
        "what": "rotations alone" if alone else "poses",
        "cost": climbed.cost,
        "verdict": climbed.certificate.verdict.value,
        "rungs": rungs,
    }


def draw(figure, record: Data) -> None:
    """A panel a graph: what bounds leave open against seconds."""
    figure.set_size_inches(_style.PAGE, 0.4 * _style.PAGE)
    panels = figure.subplots(1, len(record["graphs"]), sharey=True, squeeze=False)[0]
    for axes, letter, graph in zip(panels, "ab", record["graphs"], strict=False):
        for rung in graph["rungs"]:
            key, point = rung["key"], (rung["seconds"], max(rung["open"], SMALLEST))
            marker, colour = MARKERS[key]
            axes.plot(*point, marker, color=colour, markersize=6)
            offset, side = PLACES.get(key, ((6, 0), "left"))
            axes.annotate(
                LABELS[key],
                point,
                offset,
                textcoords="offset points",
                ha=side,
                va="center",
                color=colour,
                fontsize=7,
            )
        first, *_, last = sorted(rung["seconds"] for rung in graph["rungs"])
        axes.set(xscale="log", yscale="log", xlabel="seconds")
        axes.set_xlim(first / 2.0, last * (3.0 if last > 10.0 else 20.0))
        _style.panel(axes, letter, f"{graph['name']}, {graph['what']} (n = {graph['n']})")
    panels[0].set(ylabel="1 - bound / best cost")


FIGURE = Figure(
    name="gallery_bounds",
    title="The ladder of bounds: value against seconds",
    source="the bounds of `certpgo bounds`; A. Eriksson et al., Rotation Averaging and Strong "
    "Duality, 2018",
    compute=compute,
    draw=draw,
    caption=(
        "How much of the best cost a lower bound leaves open, and the seconds it takes, one run "
        "each: {said}. {protocol}."
    ),
    notes=(
        "The proven bound includes the search for the answer that it certifies; the others are "
        "computed in floating point and not proven.",
        "A semidefinite program of the larger graph is out of reach of interior points.",
    ),
    timed=True,
)
