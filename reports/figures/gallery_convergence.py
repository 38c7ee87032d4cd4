"""How far several methods are from a proven lower bound, second by second."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from certpgo import Iteration, Quadratic, solve
from certpgo.errors import CertPGOError
from certpgo.optimize.methods.spanning_tree import SpanningTree
from certpgo.registry import get_solver
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.timing import one_core

from . import _scenes, _style

#: Label, name and settings.
METHODS = (
    ("Newton", "newton", {}),
    ("Laplacian Gauss-Newton", "laplacian_gauss_newton", {}),
    ("Riemannian gradient", "riemannian_gradient", {}),
    ("rotation coordinate descent", "rotation_coordinate_descent", {}),
    ("fixed point", "fixed_point", {"max_iterations": 100_000}),
)
SET, BUDGET, QUICK_BUDGET = "sphere2500", 20.0, 0.5
#: Points that a curve keeps at most.
POINTS = 150


@dataclass(slots=True)
class Recorder:
    """Keeps seconds and costs, and stops a method when its time is up."""

    budget: float
    told: list[tuple[float, float]] = field(default_factory=list)

    def __call__(self, iteration: Iteration) -> bool:
        """Whether the time is up."""
        self.told.append((iteration.seconds, iteration.cost))
        return iteration.seconds > self.budget


def compute(quick: bool, data: Path | None) -> Data:
    """Seconds and costs of each method from one start, and a proven lower bound."""
    if quick:
        graph = _scenes.exact_random(60, 5.0)
        problem, name = _scenes.noisy(graph, 10.0, _scenes.generator(13)), "random graph"
    else:
        problem, name = Quadratic(_scenes.load(SET, data).graph.rotations_alone), SET
    proven = solve(problem)
    start = SpanningTree().solve(problem).estimate
    methods, budget = [], QUICK_BUDGET if quick else BUDGET
    with one_core() as protocol:
        for label, key, settings in METHODS:
            recorder = Recorder(budget)
            try:
                get_solver(key)(**settings).solve(problem, initial=start, monitor=recorder)
            except CertPGOError as error:
                methods.append({"label": label, "seconds": [], "gaps": [], "failed": str(error)})
                continue
            curve = np.array(recorder.told)
            chosen = np.unique(np.geomspace(1, len(curve), POINTS).astype(int)) - 1
            seconds, costs = curve[chosen].T
            gaps = costs - proven.certificate.lower_bound
            curve = {"seconds": seconds.tolist(), "gaps": gaps.tolist()}
            methods.append({"label": label, **curve, "failed": ""})
    return {
        "name": name,
        "n": problem.n,
        "m": problem.graph.num_edges,
        "verdict": proven.verdict.value,
        "cost": proven.cost,
        "lower_bound": proven.certificate.lower_bound,
        "tolerance": proven.certificate.tolerance,
        "budget": budget,
        "protocol": protocol,
        "methods": methods,
        "failed": "".join(f" {m['label']} failed: {m['failed']}." for m in methods if m["failed"]),
    }


def draw(figure, record: Data) -> None:
    """Cost minus lower bound against seconds, on logarithmic axes."""
    figure.set_size_inches(_style.PAGE, 0.45 * _style.PAGE)
    axes = figure.add_subplot()
    for place, method in enumerate(record["methods"]):
        if not method["gaps"]:
            continue
        axes.loglog(
            np.maximum(method["seconds"], 1e-3),
            method["gaps"],
            color=_style.COLOURS[place % len(_style.COLOURS)],
            marker=_style.MARKERS[place % len(_style.MARKERS)],
            markersize=2.5,
            label=method["label"],
        )
    axes.axhline(record["tolerance"], color=_style.BLACK, linewidth=0.8, linestyle=":")
    axes.annotate(
        "CERTIFIED below",
        (0.01, record["tolerance"]),
        (0, -3),
        xycoords=axes.get_yaxis_transform(),
        textcoords="offset points",
        va="top",
        fontsize=7,
    )
    axes.set(xlabel="seconds", ylabel="cost less the proven lower bound")
    figure.legend(loc="outside right center")


FIGURE = Figure(
    name="gallery_convergence",
    title="Cost above a proven lower bound, second by second",
    source="the methods of certpgo",
    compute=compute,
    draw=draw,
    caption=(
        "{name}, rotations alone (n = {n}, m = {m}), every method from one spanning tree, drawn at "
        "a millisecond, and for {budget:g} s at most, one run each. The lower bound is "
        "{lower_bound:.10g} and the best cost {cost:.10g} ({verdict}). {protocol}.{failed}"
    ),
    timed=True,
)
