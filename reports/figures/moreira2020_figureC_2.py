"""Moreira 2020, Figure C.2: EigenMA beside ten Gauss-Newton iterations from there."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from certpgo import Estimate, Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.registry import get_solver
from certpgo.solve import metrics
from reports.harness.experiments.figure import Data, Figure

from . import _maps, _slam, _style

ITERATIONS = 10


def compute(quick: bool, data: Path | None) -> Data:
    """Positions of both, aligned, and their distance."""
    gtsam = importlib.util.find_spec("gtsam") is not None
    sets = []
    for name, problem, graph, method in _slam.problems(quick, data):
        start = method.solve(problem).estimate
        refined = metrics.align_positions(_refined(problem, start, gtsam), start)
        sets.append(
            {
                "name": name,
                "n": problem.n,
                "m": problem.graph.num_edges,
                "eigen_ma": _maps.positions(start),
                "refined": _maps.positions(refined),
                "f_ml": metrics.f_ml(graph, start),
                "refined_f_ml": metrics.f_ml(graph, refined),
                "distance": _maps.distance(refined, start),
            }
        )
    return {
        "sets": sets,
        "by": "Gauss-Newton (GTSAM)" if gtsam else "Newton's method",
        "iterations": ITERATIONS,
        "distances": ", ".join(f"{entry['distance']:.2g} m on {entry['name']}" for entry in sets),
        "gains": ", ".join(
            f"{entry['f_ml']:.1f} to {entry['refined_f_ml']:.1f} on {entry['name']}"
            for entry in sets
        ),
    }


def _refined(problem: Quadratic, start: Estimate, gtsam: bool) -> Estimate:
    if not gtsam:
        return newton(problem, start, NewtonSettings(max_iterations=ITERATIONS)).estimate
    solver = get_solver("gtsam_gauss_newton")(max_iterations=ITERATIONS)
    return solver.solve(problem, initial=start).estimate


def draw(figure, record: Data) -> None:
    """Two trajectories a panel."""
    lines = {
        "eigen_ma": ("EigenMA", _style.BLUE),
        "refined": (record["by"], _style.VERMILION),
    }
    _slam.draw(figure, record, lines)


FIGURE = Figure(
    name="moreira2020_figureC_2",
    title="EigenMA and Gauss-Newton (Moreira 2020, Figure C.2)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure C.2",
    compute=compute,
    draw=draw,
    caption=(
        "EigenMA (blue) and at most {iterations} iterations of {by} from there (red), aligned: "
        "{distances}, root mean square. They bring f_ML from {gains}."
    ),
    notes=(_slam.LEFT_OUT, "The thesis has g2o's Gauss-Newton."),
)
