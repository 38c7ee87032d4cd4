"""Moreira 2020, Figure C.3: trajectories of EIG-SE(3) and the loop closures."""

from __future__ import annotations

from pathlib import Path

from certpgo import metrics
from certpgo.harness.figure import Data, Figure
from certpgo.registry import get_solver

from . import _maps, _slam, _style


def compute(quick: bool, data: Path | None) -> Data:
    """EIG-SE(3)'s positions, set by set."""
    sets = []
    for name, problem, graph, _ in _slam.problems(quick, data):
        answer = get_solver("eig_se3")().solve(problem).estimate
        sets.append(
            {
                "name": name,
                "n": problem.n,
                "m": problem.graph.num_edges,
                "f_ml": metrics.f_ml(graph, answer),
                "eig_se3": _maps.positions(answer),
                "closures": _maps.closures(problem.graph),
            }
        )
    return {
        "sets": sets,
        "values": ", ".join(f"{entry['f_ml']:.1f} on {entry['name']}" for entry in sets),
    }


def draw(figure, record: Data) -> None:
    """Trajectories over loop closures."""
    _slam.draw(figure, record, {"eig_se3": ("EIG-SE(3)", _style.VERMILION)})


FIGURE = Figure(
    name="moreira2020_figureC_3",
    title="Trajectories of EIG-SE(3) and loop closures (Moreira 2020, Figure C.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure C.3",
    compute=compute,
    draw=draw,
    caption="EIG-SE(3) (red) over the loop closures (grey); f_ML is {values}.",
    notes=(
        _slam.LEFT_OUT,
        "The thesis' Garage and Cubicle are worse: see the notes of Table 5.7 for what its "
        "eigenvectors can have been.",
    ),
)
