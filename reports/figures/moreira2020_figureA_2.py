"""Moreira 2020, Figure A.2: how fast the maximum-likelihood mean of rotations converges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import special

from certpgo.linalg import rotations as so
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

CONCENTRATIONS, REPEATED = (1.0, 5.0, 20.0), 200
SIZES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def compute(quick: bool, data: Path | None) -> Data:
    """Root mean square angles between means and the identity, and what theory says of them."""
    repeated, sizes = (20, SIZES[:7]) if quick else (REPEATED, SIZES)
    curves = []
    for place, k in enumerate(CONCENTRATIONS):
        rms = []
        for size in sizes:
            samples = so.langevin(_scenes.generator(8, place, size), k, repeated * size, 3)
            means = so.project(samples.reshape(repeated, size, 3, 3).mean(axis=1))
            rms.append(float(np.degrees(np.sqrt(np.mean(so.angle(means) ** 2)))))
        constant = np.degrees(np.sqrt(4.5 / (k * mean_trace(k))))
        curves.append(
            {
                "k": k,
                "rms_deg": rms,
                "asymptotic_deg": (constant / np.sqrt(sizes)).tolist(),
                "last_ratio": rms[-1] / (constant / np.sqrt(sizes[-1])),
            }
        )
    return {
        "repeated": repeated,
        "sizes": list(sizes),
        "curves": curves,
        "ratios": ", ".join(f"{curve['last_ratio']:.2f}" for curve in curves),
        "last": sizes[-1],
    }


def mean_trace(k: float) -> float:
    """E[tr R] of Lang(I, k) on SO(3): 1 + 2 E[cos t], t of density (1 - cos t) exp(2 k cos t)."""
    i0, i1, i2 = (special.ive(order, 2.0 * k) for order in range(3))
    return float(1.0 + 2.0 * (i1 - 0.5 * (i0 + i2)) / (i0 - i1))


def draw(figure, record: Data) -> None:
    """Errors, and their asymptotes."""
    figure.set_size_inches(_style.COLUMN, 0.75 * _style.COLUMN)
    axes = figure.add_subplot()
    for curve, colour, marker in zip(
        record["curves"], _style.COLOURS, _style.MARKERS, strict=False
    ):
        label = f"k = {curve['k']:g}"
        axes.loglog(record["sizes"], curve["rms_deg"], color=colour, marker=marker, label=label)
        axes.loglog(
            record["sizes"], curve["asymptotic_deg"], color=colour, linestyle=":", linewidth=0.9
        )
    axes.set(xlabel="sample size n", ylabel="angle to the true mean, RMS (degrees)")
    axes.set_yticks([0.1, 1, 10, 100], labels=["0.1", "1", "10", "100"])
    axes.legend()


FIGURE = Figure(
    name="moreira2020_figureA_2",
    title="The maximum-likelihood mean of rotations (Moreira 2020, Figure A.2)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure A.2",
    compute=compute,
    draw=draw,
    caption=(
        "Root mean square angle between the projected mean of n samples of Lang(I, k) and the "
        "identity, over {repeated} repetitions; dotted, what the Fisher information allows, "
        "sqrt(9 / (2 k n E[tr R])). At n = {last} the quotients are {ratios}."
    ),
    notes=(
        "The thesis has single runs, concentrations that it does not print, and sqrt(2) times the "
        "angle.",
    ),
)
