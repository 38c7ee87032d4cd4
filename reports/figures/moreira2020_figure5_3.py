"""Moreira 2020, Figure 5.3: EigenRAO's errors and smallest eigenvalue, iteration by iteration."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from certpgo import Quadratic
from certpgo.optimize.methods.adaptive_trimming import AdaptiveTrimming
from certpgo.optimize.methods.eigen_rao import EigenRAO
from certpgo.solve import metrics
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

NAME, ITERATIONS, QUICK_ITERATIONS = "Ellis_Island", 30, 4
MEASURES = {"mean_deg": "mean", "median_deg": "median", "rmse_deg": "RMSE"}


def compute(quick: bool, data: Path | None) -> Data:
    """Errors of each iterate, and of adaptive trimming."""
    instance, nodes, truth = _scenes.with_truth(NAME, data)
    problem = Quadratic(instance.graph).with_unit_weights()

    def errors_of(estimate) -> list[float]:
        errors = metrics.angular_errors(estimate.subset(nodes), truth)
        return [getattr(errors, measure) for measure in MEASURES]

    count = (QUICK_ITERATIONS if quick else ITERATIONS) + 1
    steps = list(islice(EigenRAO().steps(problem), count))
    errors = np.array([errors_of(step.estimate) for step in steps])
    stopped = min(EigenRAO().solve(problem).iterations, count - 1)
    trimming = AdaptiveTrimming(max_iterations=3) if quick else AdaptiveTrimming()
    trimmed = dict(zip(MEASURES, errors_of(trimming.solve(problem).estimate), strict=True))
    return {
        "cameras": instance.graph.num_nodes,
        "m": instance.graph.num_edges,
        "known": len(nodes),
        "errors_deg": dict(zip(MEASURES, errors.T.tolist(), strict=True)),
        "eigenvalues": [step.eigenvalue for step in steps],
        "replaced_percent": [100.0 * float(step.replaced.mean()) for step in steps],
        "trimmed": trimmed,
        "stopped": stopped,
        "stop": "the quick profile stops" if quick else "EigenRAO's defaults stop",
        "steps": " after three steps" if quick else "",
        "first": dict(zip(MEASURES, errors[0].tolist(), strict=True)),
        "last": dict(zip(MEASURES, errors[stopped].tolist(), strict=True)),
    }


def draw(figure, record: Data) -> None:
    """Errors on the left, the eigenvalue on the right."""
    figure.set_size_inches(_style.PAGE, 0.36 * _style.PAGE)
    left, right = figure.subplots(1, 2)
    steps = range(len(record["eigenvalues"]))
    for (measure, label), colour, marker in zip(
        MEASURES.items(), _style.COLOURS, _style.MARKERS, strict=False
    ):
        errors = record["errors_deg"][measure]
        left.semilogy(steps, errors, color=colour, marker=marker, label=label)
        left.axhline(record["trimmed"][measure], color=colour, linestyle="--", linewidth=0.8)
    left.set(ylabel="error (degrees)")
    left.set_yticks([0.5, 1, 2, 5, 10, 20], labels=["0.5", "1", "2", "5", "10", "20"])
    left.minorticks_off()
    left.plot([], color=_style.BLACK, linestyle="--", linewidth=0.8, label="adaptive trimming")
    left.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.08, 1.0))
    _style.panel(left, "a")
    right.plot(steps, record["eigenvalues"], color=_style.BLACK, marker="o")
    right.set(ylabel="smallest eigenvalue $\\lambda_1$")
    _style.panel(right, "b")
    for axes in (left, right):
        axes.set(
            xlabel="iteration (0 is EigenRA)", xticks=range(0, len(steps), 1 + len(steps) // 8)
        )
        axes.axvline(record["stopped"], color=_style.GREY, linestyle=":", linewidth=0.8)


FIGURE = Figure(
    name="moreira2020_figure5_3",
    title="EigenRAO, iteration by iteration (Moreira 2020, Figure 5.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 5.3",
    compute=compute,
    draw=draw,
    caption=(
        "Ellis Island, {cameras} cameras and {m} measurements. (a) Errors against the truth of "
        "{known} cameras: mean {first[mean_deg]:.3g}, median {first[median_deg]:.3g} and RMSE "
        "{first[rmse_deg]:.3g} degrees at the start, {last[mean_deg]:.3g}, "
        "{last[median_deg]:.3g} and {last[rmse_deg]:.3g} at iteration {stopped}, where "
        "{stop} (grey line); dashed, adaptive trimming{steps}: {trimmed[mean_deg]:.3g}, "
        "{trimmed[median_deg]:.3g} and {trimmed[rmse_deg]:.3g}. (b) The smallest eigenvalue of the "
        "weighted block matrix."
    ),
    notes=("Alignment by the least sum of squared chordal distances.",),
)
