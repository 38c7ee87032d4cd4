"""Moreira 2020, Figure 4.4: which measurements disagree with the truth, and with EigenRA."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo import Estimate, Quadratic
from certpgo.optimize.methods.eigen_ra import EigenRA
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

NAME = "Ellis_Island"
#: Degrees: errors above are gross, and the colours' range.
GROSS, RANGE = 20.0, (0.5, 180.0)
LEVELS = 16


def compute(quick: bool, data: Path | None) -> Data:
    """The angular errors of the measurements between cameras whose truth is known."""
    instance, nodes, truth = _scenes.with_truth(NAME, data)
    answer = EigenRA(weights="unit").solve(Quadratic(instance.graph)).estimate
    graph = instance.graph.subgraph(nodes)
    degrees = np.bincount(graph.edges.ravel(), minlength=len(nodes))
    place = np.argsort(np.argsort(-degrees, kind="stable"), kind="stable")
    problem = Quadratic(graph)

    def errors_of(estimate: Estimate) -> np.ndarray:
        return np.round(np.degrees(problem.residual_angles(estimate)), 1)

    measured, fitted = errors_of(truth), errors_of(answer.subset(nodes))
    gross = measured > GROSS
    return {
        "cameras": instance.graph.num_nodes,
        "known": len(nodes),
        "m": graph.num_edges,
        "edges": place[graph.edges].tolist(),
        "of_truth_deg": measured.tolist(),
        "of_answer_deg": fitted.tolist(),
        "gross_deg": GROSS,
        "gross_percent": 100.0 * gross.mean(),
        "median_truth_deg": np.median(measured),
        "median_answer_deg": np.median(fitted),
        "found_percent": 100.0 * np.mean(fitted[gross] > GROSS),
        "false_percent": 100.0 * np.mean(fitted[~gross] > GROSS),
    }


def draw(figure, record: Data) -> None:
    """Two heat maps with one scale, cameras by their number of measurements."""
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    figure.set_size_inches(_style.PAGE, 0.47 * _style.PAGE)
    panels = figure.subplots(1, 2)
    colours = colormaps["cividis"].resampled(LEVELS)
    i, j = np.array(record["edges"]).T
    for axes, letter, key, title in (
        (panels[0], "a", "of_answer_deg", "to EigenRA's answer"),
        (panels[1], "b", "of_truth_deg", "to the ground truth"),
    ):
        errors = np.full((record["known"], record["known"]), np.nan)
        errors[i, j] = errors[j, i] = record[key]
        image = axes.imshow(errors, norm=LogNorm(*RANGE), cmap=colours, interpolation="none")
        _style.panel(axes, letter, title)
        axes.set(xlabel="camera, by degree", ylabel="camera, by degree")
    bar = figure.colorbar(image, ax=panels, extend="min", shrink=0.8)
    bar.set_label("angular error (degrees)")
    bar.set_ticks([1, 3, 10, 30, 90, 180], labels=["1", "3", "10", "30", "90", "180"])
    bar.ax.minorticks_off()


FIGURE = Figure(
    name="moreira2020_figure4_4",
    title="Which measurements disagree (Moreira 2020, Figure 4.4, on Ellis Island)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 4.4",
    compute=compute,
    draw=draw,
    caption=(
        "Angular errors of the {m} measurements between the {known} of {cameras} cameras whose "
        "truth is known, white where there is none; (a) to EigenRA's answer, median "
        "{median_answer_deg:.3g} degrees, (b) to the truth, median {median_truth_deg:.3g}. Of the "
        "{gross_percent:.2g} percent that are more than {gross_deg:g} degrees from the truth, "
        "{found_percent:.3g} percent are as far from the answer, and of the others "
        "{false_percent:.2g} percent."
    ),
    notes=(
        "Ellis Island, because Notre Dame's measurements are not here; angles, where the thesis "
        "has Frobenius norms of logarithms, sqrt(2) times as much.",
    ),
)
