"""Moreira 2020, Figure A.1: samples of Langevin distributions as rotation vectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import special

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

SAMPLES, SHOWN = 10_000, 2_500
MEAN = (np.pi / 2.0) * np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
#: Concentrations and means, as the panels have them.
PANELS = ((2.0, MEAN), (10.0, MEAN), (50.0, MEAN), (10.0, np.zeros(3)))
BINS = 30


def compute(quick: bool, data: Path | None) -> Data:
    """Rotation vectors to draw, and the angles to the mean of all samples, in bins."""
    samples, shown = (1_000, 200) if quick else (SAMPLES, SHOWN)
    panels = []
    for place, (k, mean) in enumerate(PANELS):
        noise = so.langevin(_scenes.generator(7, place), k, samples, 3)
        angles = so.angle(noise)
        edges = np.linspace(0.0, angles.max(), BINS + 1)
        counts = np.histogram(angles, edges)[0]
        vectors = so.log(so.exp(mean) @ noise)
        panels.append(
            {
                "k": k,
                "mean": mean.tolist(),
                "vectors": np.round(vectors[:shown], 2).tolist(),
                "bins_deg": np.degrees(edges).tolist(),
                "counts": counts.tolist(),
                "distance": float(np.abs(counts.cumsum() / samples - _share(k, edges[1:])).max()),
            }
        )
    return {
        "samples": samples,
        "shown": shown,
        "panels": panels,
        "concentrations": ", ".join(f"{k:g}" for k, _ in PANELS[:3]),
        "last_k": PANELS[3][0],
        "largest_distance": max(panel["distance"] for panel in panels),
        "critical": 1.63 / np.sqrt(samples),
    }


def _density(k: float, angle: FloatArray) -> FloatArray:
    """Of the angle in [0, pi]: (1 - cos t) exp(2 k cos t), normalized; Haar measure times f_L."""
    total = np.pi * (special.ive(0, 2.0 * k) - special.ive(1, 2.0 * k))
    return np.asarray((1.0 - np.cos(angle)) * np.exp(2.0 * k * (np.cos(angle) - 1.0)) / total)


def _share(k: float, angle: FloatArray) -> FloatArray:
    """Of rotations up to an angle."""
    fine = np.linspace(0.0, np.pi, 20_001)
    area = np.concatenate([[0.0], np.cumsum(_density(k, fine)[:-1] * np.diff(fine))])
    return np.interp(angle, fine, area)


def draw(figure, record: Data) -> None:
    """Vectors in the ball of radius pi above, the distribution of angles below."""
    figure.set_size_inches(_style.PAGE, 0.48 * _style.PAGE)
    grid = figure.add_gridspec(2, len(record["panels"]), height_ratios=(1.5, 1.0))
    for place, panel in enumerate(record["panels"]):
        cloud = figure.add_subplot(grid[0, place], projection="3d")
        _style.ball(cloud, np.pi)
        x, y, z = np.array(panel["vectors"]).T
        cloud.scatter(x, y, z, s=1.0, color=_style.BLUE, alpha=0.35, linewidths=0, rasterized=True)
        what = "mean $\\pi/2$" if any(panel["mean"]) else "mean $I$"
        _style.panel(cloud, "abcd"[place], f"k = {panel['k']:g}, {what}")
        axes = figure.add_subplot(grid[1, place])
        bins = np.array(panel["bins_deg"])
        density = np.array(panel["counts"]) / sum(panel["counts"]) / np.diff(bins)
        axes.stairs(density, bins, fill=True, color=_style.SKY)
        fine = np.linspace(0.0, bins[-1], 200)
        exact = np.radians(_density(panel["k"], np.radians(fine)))
        axes.plot(fine, exact, color=_style.BLACK, linewidth=0.9)
        axes.set(xlabel="angle to mean (deg)", ylim=(0.0, None))
        if place == 0:
            axes.set_ylabel("density (1/deg)")


FIGURE = Figure(
    name="moreira2020_figureA_1",
    title="Samples of Langevin distributions (Moreira 2020, Figure A.1)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure A.1",
    compute=compute,
    draw=draw,
    caption=(
        "Above, {shown} of {samples} samples as rotation vectors in the ball of radius pi: (a) to "
        "(c) concentrations {concentrations} about the turn by pi/2 around (1, 0, 1)/sqrt(2), (d) "
        "concentration {last_k:g} about the identity. Below, the angles between all samples and "
        "the mean (blue) and their density (1 - cos t) exp(2 k cos t), normalized (line); the "
        "largest distance of a distribution from its own is {largest_distance:.2g}, where "
        "Kolmogorov's test at 1 percent has {critical:.2g}."
    ),
    notes=(
        "The thesis does not print its concentrations. It takes the angle for von Mises' (eq. "
        "A.5), which is the density of f_L along the angle; the volume of rotations of an angle t, "
        "1 - cos t, belongs to it, so that near the mean there are few.",
    ),
)
