"""Moreira 2020, Figures D.1 and D.2: the trajectory of a sequence, and its scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import certpgo
from certpgo.errors import InputError, MissingDependency
from certpgo.registration.fuse import voxel_means
from certpgo.registration.reconstruct import ReconstructSettings
from certpgo.registration.synthetic import synthetic_sequence
from certpgo.solve.metrics import angular_errors, position_errors
from reports.harness.experiments.figure import Data, Figure

from . import _style

FRAMES, FEW = 120, 8
#: Edges of the drawn voxels, metres; heights that are drawn are below the room's ceiling.
VOXEL, BELOW = 0.06, 1.1
#: Pixels between those drawn of a frame.
SPARSE = 4


def compute(quick: bool, data: Path | None) -> Data:
    """The sequence is computed: an orbit in a room that exists only here."""
    frames = synthetic_sequence(FRAMES)
    if quick:
        frames = frames.chosen(range(FEW))
    try:
        found = certpgo.reconstruct(frames, ReconstructSettings(dense=not quick))
    except MissingDependency as error:
        raise InputError(str(error)) from error
    truth = frames.truth.subset(found.nodes)
    R, t = truth.rotations[0], truth.translations[0]
    points = found.scene.points @ R.T + t
    low = points[:, 2] < BELOW
    # As many points as there are voxels, drawn by lot.
    count = len(voxel_means(points[low].astype(np.float64), VOXEL))
    nearest = np.random.default_rng(0).permutation(np.flatnonzero(low))[:count]
    view = frames.frame(0)
    poses = {
        "truth": truth.translations,
        "odometry": found.dead_reckoning.anchored(0).translations @ R.T + t,
        "certified": found.estimate.translations @ R.T + t,
    }
    kept, edges = found.averaged.kept, found.instance.graph.edges
    return {
        "frames": len(found.nodes),
        "edges": int(kept.sum()),
        "measured": len(kept),
        "verdict": found.answer.verdict.value,
        "points": len(found.scene),
        "millimetres": 1e3 * position_errors(found.estimate, truth).rmse,
        "degrees": angular_errors(found.estimate, truth).rmse_deg,
        "odometry_millimetres": 1e3 * position_errors(found.dead_reckoning, truth).rmse,
        "colour": view.colour[::SPARSE, ::SPARSE].tolist(),
        "depth": np.round(view.depth[::SPARSE, ::SPARSE].astype(float), 2).tolist(),
        "poses": {name: np.round(where, 4).tolist() for name, where in poses.items()},
        "loops": edges[kept & (np.abs(edges[:, 1] - edges[:, 0]) > 2)].tolist(),
        "scene": np.round(points[nearest], 2).tolist(),
        "shades": found.scene.colours[nearest].tolist(),
    }


def draw(figure, record: Data) -> None:
    """A frame, the trajectory from above with its loops, and the scene from above."""
    figure.set_size_inches(_style.PAGE, 0.36 * _style.PAGE)
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.7, 1.0, 1.1))
    depth = np.array(record["depth"])
    grey = np.repeat((255 * depth / depth.max()).astype(np.uint8)[:, :, None], 3, axis=2)
    left.imshow(np.vstack([np.array(record["colour"], dtype=np.uint8), grey]))
    left.set_axis_off()
    _style.panel(left, "a", "colour and depth")
    certified = np.array(record["poses"]["certified"])[:, :2]
    for i, j in record["loops"]:
        middle.plot(*certified[[i, j]].T, color=_style.SKY, linewidth=0.2)
    drawn = (("truth", _style.BLACK, 2.4), ("odometry", _style.VERMILION, 0.8))
    for name, colour, width in (*drawn, ("certified", _style.GREEN, 1.0)):
        where = np.array(record["poses"][name])[:, :2]
        middle.plot(*where.T, color=colour, linewidth=width, label=name)
    middle.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    middle.legend(loc="center")
    _style.panel(middle, "b", "trajectory, loops")
    scene = np.array(record["scene"])
    # What is higher hides what is below.
    order = np.argsort(scene[:, 2])
    shades = np.array(record["shades"])[order] / 255.0
    right.scatter(*scene[order, :2].T, c=shades, s=0.7, linewidths=0, rasterized=True)
    right.plot(*certified.T, color=_style.GREEN)
    right.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    _style.panel(right, "c", "scene")


FIGURE = Figure(
    name="moreira2020_figureD_1",
    title="Trajectory and scene from images (Moreira 2020, Figures D.1 and D.2)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figures D.1 and D.2",
    compute=compute,
    draw=draw,
    caption=(
        "{frames} frames of a computed room; {edges} of {measured} edges are kept, and the "
        "trajectory is {verdict}. (a) One frame. (b) Trajectory from above: {millimetres:.2f} mm "
        "and {degrees:.3f} degrees off the truth, odometry {odometry_millimetres:.2f} mm; loops "
        "are blue. (c) The scene from above without its ceiling, a sample of {points} points."
    ),
    notes=(
        "The thesis' frames of the Burghers of Calais are not here: these are of a room that is "
        "computed, so that the truth is known.",
    ),
)
