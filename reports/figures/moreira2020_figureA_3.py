"""Moreira 2020, Figure A.3: a mean rotation and its estimate."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.linalg import rotations as so
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

CONCENTRATIONS, SAMPLES, SHOWN = (20.0, 4.0), 10_000, 2_000
#: Its angle is pi, where both signs are the same rotation.
MEAN = np.pi * np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)


def compute(quick: bool, data: Path | None) -> Data:
    """Rotation vectors to draw, the estimate, and the angle between it and the mean."""
    samples, shown = (1_000, 200) if quick else (SAMPLES, SHOWN)
    panels = []
    for place, k in enumerate(CONCENTRATIONS):
        R = so.exp(MEAN) @ so.langevin(_scenes.generator(9, place), k, samples, 3)
        estimate = so.project(R.mean(axis=0)[None])[0]
        vector = so.log(estimate)
        panels.append(
            {
                "k": k,
                "vectors": np.round(so.log(R[:shown]), 2).tolist(),
                "estimate": (vector if vector @ MEAN > 0.0 else -vector).tolist(),
                "error_deg": float(np.degrees(so.angle(so.exp(MEAN).T @ estimate))),
            }
        )
    return {
        "samples": samples,
        "shown": shown,
        "mean": MEAN.tolist(),
        "panels": panels,
        "errors": " and ".join(f"{panel['error_deg']:.2g}" for panel in panels),
    }


def draw(figure, record: Data) -> None:
    """The samples, the mean's direction and the estimate's."""
    figure.set_size_inches(_style.PAGE, 0.42 * _style.PAGE)
    for place, panel in enumerate(record["panels"], start=1):
        axes = figure.add_subplot(1, len(record["panels"]), place, projection="3d")
        _style.ball(axes, np.pi)
        x, y, z = np.array(panel["vectors"]).T
        axes.scatter(x, y, z, s=3.0, color=_style.SKY, alpha=0.6, linewidths=0, rasterized=True)
        for vector, colour, width, label in (
            (record["mean"], _style.BLUE, 3.0, "mean S"),
            (panel["estimate"], _style.VERMILION, 1.2, "its estimate"),
        ):
            end = 1.25 * np.array(vector)
            axes.plot(*np.stack([-end, end], axis=1), color=colour, linewidth=width, label=label)
        _style.panel(axes, "ab"[place - 1], f"k = {panel['k']:g}")
    axes.legend(loc="lower right")


FIGURE = Figure(
    name="moreira2020_figureA_3",
    title="A mean rotation and its estimate (Moreira 2020, Figure A.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure A.3",
    compute=compute,
    draw=draw,
    caption=(
        "{shown} of {samples} samples as rotation vectors, the axis of the mean S (blue) and of "
        "the projected mean of all samples (red), which are {errors} degrees from S."
    ),
    notes=(
        "S = rot([pi/sqrt(2), 0, pi/sqrt(2)]) as printed is a turn by pi, whose vector has two "
        "signs: samples lie at both ends of its axis.",
    ),
)
