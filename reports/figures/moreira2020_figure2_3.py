"""Moreira 2020, Figure 2.3: rotations on their way from random ones to the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo import Estimate
from certpgo.linalg import rotations as so
from certpgo.optimize.methods.riemannian_gradient import RiemannianGradient
from certpgo.solve import metrics
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

SIGMA_DEG, OUTLIERS, SHOWN, ITERATIONS = 3.0, 0.02, 4, 60


def compute(quick: bool, data: Path | None) -> Data:
    """Iterates of gradient descent with a constant step, aligned with the truth."""
    exact = _scenes.exact_random(60, 5.0) if quick else _scenes.exact_notre_dame(data)
    problem = _scenes.noisy(exact, SIGMA_DEG, _scenes.generator(1), outliers=OUTLIERS)
    rng = _scenes.generator(2)
    # Each step depends on the point alone, so that single steps make the descent.
    descent = RiemannianGradient(rule="constant", tolerance=0.0, max_iterations=1)
    points = [Estimate(so.random(rng, problem.n, 3))]
    for _ in range(ITERATIONS):
        points.append(descent.solve(problem, initial=points[-1]).estimate)
    S = metrics.align(points[-1], exact.truth)
    R = np.array([S @ point.rotations for point in points])
    errors = np.degrees(so.angle(np.swapaxes(R, -1, -2) @ exact.truth.rotations))
    chosen = np.sort(rng.choice(problem.n, SHOWN, replace=False))
    return {
        "n": problem.n,
        "m": problem.graph.num_edges,
        "sigma_deg": SIGMA_DEG,
        "outliers": OUTLIERS,
        "iterations": ITERATIONS,
        "nodes": chosen.tolist(),
        "vectors": np.round(so.log(R[:, chosen]), 4).tolist(),
        "truth": np.round(so.log(exact.truth.rotations[chosen]), 4).tolist(),
        "errors_deg": errors[:, chosen].tolist(),
        "mean_errors_deg": errors.mean(axis=1).tolist(),
        "last_mean_error_deg": errors[-1].mean(),
    }


def draw(figure, record: Data) -> None:
    """Each component, and the angle to the truth, against the iteration."""
    figure.set_size_inches(_style.PAGE, 0.36 * _style.PAGE)
    grid = figure.add_gridspec(2, 3, width_ratios=(1.0, 1.0, 1.1))
    panels = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(SHOWN)]
    angle = figure.add_subplot(grid[:, 2])
    vectors, errors = np.array(record["vectors"]), np.array(record["errors_deg"])
    steps = range(len(vectors))
    for k, axes in enumerate(panels):
        for a, name in enumerate("xyz"):
            colour = _style.COLOURS[a]
            axes.plot(steps, _unwrapped(vectors[:, k, a], vectors[:, k]), color=colour, label=name)
            axes.axhline(record["truth"][k][a], color=colour, linestyle=":", linewidth=0.8)
        _style.panel(axes, "abcd"[k], f"node {record['nodes'][k]}")
        axes.set(ylim=(-3.4, 3.4), yticks=(-3, 0, 3), ylabel="vector (rad)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    angle.semilogy(steps, errors, color=_style.GREY, linewidth=0.8)
    angle.semilogy(steps, record["mean_errors_deg"], color=_style.BLACK)
    angle.set_yticks([1, 10, 100], labels=["1", "10", "100"])
    angle.set(ylabel="angle to the truth (degrees)")
    _style.panel(angle, "e", "four nodes, and the mean")
    for axes in (*panels[2:], angle):
        axes.set_xlabel("iteration")


def _unwrapped(component, vectors):
    """A component with a gap where the vector changes sign at the angle pi."""
    jumps = np.linalg.norm(np.diff(vectors, axis=0), axis=1) > np.pi
    return np.where(np.r_[jumps, False], np.nan, component)


FIGURE = Figure(
    name="moreira2020_figure2_3",
    title="Rotations on their way from random ones to the truth (Moreira 2020, Figure 2.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 2.3",
    compute=compute,
    draw=draw,
    caption=(
        "(a) to (d) Rotation vectors of four of {n} nodes (lines) and of the truth (dotted) over "
        "{iterations} steps of Riemannian gradient descent from random rotations; {m} measurements "
        "with sigma_R = {sigma_deg:g} degrees, a share of {outliers:g} of them random. (e) The "
        "angle to the truth of each of the four (grey) and the mean over all (black), which ends "
        "at {last_mean_error_deg:.2g} degrees."
    ),
    notes=(
        "The step is constant as in the thesis, but each node's gradient is divided by its own "
        "curvature, where the thesis has 1e-4 for all. Lines are broken where a rotation passes "
        "the angle pi, at which its vector jumps to the other side.",
    ),
)
