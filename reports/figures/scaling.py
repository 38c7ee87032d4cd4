"""How the time of the thesis' methods grows with the number of poses."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from certpgo import Estimate, Graph
from certpgo.errors import CertPGOError
from certpgo.graph import PoseGraph
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Solver
from certpgo.registry import get_solver, solver_names
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.timing import one_core

from . import _scenes, _style

#: Label, name and settings; names that are not here are left out.
METHODS = (
    ("EigenRA", "eigen_ra", {}),
    ("chordal", "eigen_ra", {"anchor": "chordal"}),
    ("EigenRAO", "eigen_rao", {}),
    ("EigenMA", "eigen_ma", {}),
    ("EIG-SE(3)", "eig_se3", {"tol": 1e-5}),
    ("IRLS EIG-SE(3)", "irls_eig_se3", {"tol": 1e-5}),
    ("Chatterjee, Govindu", "chatterjee_govindu", {}),
    ("adaptive trimming", "adaptive_trimming", {}),
    ("Riemannian gradient", "riemannian_gradient", {}),
    ("expectation maximization", "expectation_maximization", {}),
    ("damped Newton", "damped_newton", {}),
    ("low rank and sparse", "low_rank_sparse", {}),
    ("augmented Lagrangian", "augmented_lagrangian", {}),
)
SIZES, QUICK_SIZES = (200, 400, 800, 1600, 3000), (30, 60)
MEAN_DEGREE, SIGMA, SIGMA_T = 8.0, np.radians(3.0), 0.02
RUNS, BUDGET = 3, 10.0


def compute(quick: bool, data: Path | None) -> Data:
    """Median seconds of each method, up to the size that its budget allows."""
    sizes, runs = (QUICK_SIZES, 1) if quick else (SIZES, RUNS)
    graphs = [scene(n, place) for place, n in enumerate(sizes)]
    here = solver_names()
    absent = [label for label, name, _ in METHODS if name not in here]
    with one_core() as protocol:
        methods = [
            {"label": label, **_timed(get_solver(name)(**settings), graphs, runs)}
            for label, name, settings in METHODS
            if name in here
        ]
    return {
        "sizes": list(sizes),
        "mean_degree": MEAN_DEGREE,
        "sigma_deg": float(np.degrees(SIGMA)),
        "runs": runs,
        "budget": BUDGET,
        "protocol": protocol,
        "methods": methods,
        "left_out": "; ".join(f"{m['label']}: {m['stopped']}" for m in methods if m["stopped"])
        or "none",
        "absent": ", ".join(absent) or "none",
    }


def scene(n: int, place: int) -> Graph:
    """A random graph of poses in a cube, with noise on rotations and translations."""
    rng = _scenes.generator(11, place)
    instance = synthetic.random_graph(n, MEAN_DEGREE, SIGMA, rng)
    rotation = instance.graph
    truth = Estimate(instance.truth.rotations, n ** (1.0 / 3.0) * rng.random((n, 3)))
    i, j = rotation.edges.T
    steps = truth.translations[j] - truth.translations[i]
    measured = np.einsum("mba,mb->ma", truth.rotations[i], steps)
    noise = SIGMA_T * rng.standard_normal(measured.shape)
    return PoseGraph(rotation, measured + noise, np.ones(len(i)))


def _timed(solver: Solver, graphs: list[Graph], runs: int) -> Data:
    """Seconds by size; a size whose run is expected to exceed the budget is not begun."""
    spent, stopped = [], ""
    for place, graph in enumerate(graphs):
        if place and _expected(graphs, spent) > BUDGET:
            stopped = f"above {graphs[place - 1].num_nodes} nodes beyond {BUDGET:g} s"
            break
        try:
            spent.append(median(_seconds(solver, graph) for _ in range(runs)))
        except CertPGOError as error:
            stopped = f"not with {graph.num_nodes} nodes ({error})"
            break
    n = [graph.num_nodes for graph in graphs[: len(spent)]]
    slope = np.polyfit(np.log(n), np.log(spent), 1)[0] if len(spent) > 1 else None
    return {
        "takes": "poses" if solver.poses else "rotations",
        "seconds": spent,
        "slope": slope,
        "stopped": stopped,
    }


def _seconds(solver: Solver, graph: Graph) -> float:
    # A new problem each time: nothing remembered from the run before.
    problem = Quadratic(replace(graph) if solver.poses else replace(graph.rotations_alone))
    start = time.perf_counter()
    solver.solve(problem)
    return time.perf_counter() - start


def _expected(graphs: list[Graph], spent: list[float]) -> float:
    """Seconds of the next size, when time grows as it did last, and at least in proportion."""
    n = [graph.num_nodes for graph in graphs[: len(spent) + 1]]
    power = 1.0
    if len(spent) > 1:
        power = max(1.0, np.log(spent[-1] / spent[-2]) / np.log(n[-2] / n[-3]))
    return float(spent[-1] * (n[-1] / n[-2]) ** power)


def draw(figure, record: Data) -> None:
    """Seconds against nodes, with the power that fits best."""
    figure.set_size_inches(_style.PAGE, 0.55 * _style.PAGE)
    axes = figure.add_subplot()
    for place, method in enumerate(record["methods"]):
        seconds = method["seconds"]
        power = "" if method["slope"] is None else f", $n^{{{method['slope']:.2f}}}$"
        axes.loglog(
            record["sizes"][: len(seconds)],
            seconds,
            color=_style.COLOURS[place % len(_style.COLOURS)],
            linestyle="-" if place < len(_style.COLOURS) else "--",
            marker=_style.MARKERS[place % len(_style.MARKERS)],
            label=f"{method['label']}{power}",
        )
    axes.set_xticks(record["sizes"], labels=[str(n) for n in record["sizes"]])
    axes.minorticks_off()
    axes.set(xlabel="poses n", ylabel="seconds")
    figure.legend(loc="outside right center")


FIGURE = Figure(
    name="scaling",
    title="How the time of the thesis' methods grows with the number of poses",
    source="the methods of G. Moreira, A Unified Approach for Pose Graph Optimization, 2020",
    compute=compute,
    draw=draw,
    caption=(
        "Median seconds of {runs} runs on random graphs of mean degree {mean_degree:g}, sigma_R "
        "{sigma_deg:.2g} degrees, poses where a method takes them and rotations otherwise; the "
        "powers of n fit best. {protocol}. Left out, for a run would take more than {budget:g} s "
        "or fails: {left_out}. Not here: {absent}."
    ),
    notes=(
        "Everything counts: the assembly and analysis of matrices, the start of iterative methods.",
    ),
    timed=True,
)
