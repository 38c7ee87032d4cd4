"""Trajectories and loop closures: kept in a record, aligned, and drawn from one side."""

from __future__ import annotations

import numpy as np

from certpgo import Estimate, PoseGraph
from certpgo.assess import metrics
from certpgo.linalg.arrays import FloatArray

from . import _style

#: How far the view looks down on the plane that positions lie nearest to, degrees.
ELEVATION = 60.0
#: Positions are kept to this part of the largest extent, far below a pixel.
RESOLUTION = 1e-4


def closures(graph: PoseGraph) -> list[list[int]]:
    """The edges that are no step from one pose to the next."""
    edges = np.unique(np.sort(graph.edges, axis=1), axis=0)
    return edges[edges[:, 1] - edges[:, 0] > 1].tolist()


def positions(estimate: Estimate) -> list[list[float]]:
    """Positions (n, 3) about their mean, rounded far below a pixel, metres."""
    t = estimate.translations - estimate.translations.mean(axis=0)
    decimals = max(0, int(np.ceil(-np.log10(RESOLUTION * np.ptp(t, axis=0).max()))))
    return np.round(t, decimals).tolist()


def distance(estimate: Estimate, onto: Estimate) -> float:
    """Root mean square distance of positions after alignment, metres."""
    return metrics.position_errors(estimate, onto).rmse


def draw_map(
    axes, trajectories, edges=(), *, colours=(_style.BLUE,), widths=(0.5,), like=None
) -> None:
    """Trajectories (each (n, 3)) over loop closures of the first, and a bar of known length.

    They are seen from the side of the first, or of the trajectory ``like``.
    """
    from matplotlib.collections import LineCollection

    frame = _frame(np.array(trajectories[0] if like is None else like))
    flat = [_seen(np.array(t), frame) for t in trajectories]
    if len(edges):
        lines = LineCollection(flat[0][np.array(edges)], colors=_style.GREY, linewidths=0.15)
        lines.set(rasterized=True, alpha=0.6)
        axes.add_collection(lines)
    for line, colour, width in zip(flat, colours, widths, strict=True):
        axes.plot(*line.T, color=colour, linewidth=width, rasterized=True)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    _bar(axes, np.ptp(flat[0][:, 0]), flat[0].min(axis=0))


def _seen(t: FloatArray, frame: FloatArray) -> FloatArray:
    """Positions (n, 3) in the plane of the picture, (n, 2)."""
    along, across, up = (t @ frame.T).T
    tilt = np.radians(ELEVATION)
    return np.stack([along, np.sin(tilt) * across + np.cos(tilt) * up], axis=1)


def _frame(t: FloatArray) -> FloatArray:
    """Principal axes of positions as rows, each with its largest component positive."""
    axes = np.linalg.svd(t - t.mean(axis=0), full_matrices=False)[2]
    largest = np.argmax(np.abs(axes), axis=1)
    return axes * np.sign(axes[range(3), largest])[:, None]


def _bar(axes, extent: float, corner: FloatArray) -> None:
    """A length of 1, 2 or 5 times a power of ten, about a fifth of the picture."""
    power = 10.0 ** np.floor(np.log10(extent / 5.0))
    length = power * max(step for step in (1, 2, 5) if step * power <= extent / 5.0)
    x, y = corner[0], corner[1] - 0.06 * extent
    axes.plot([x, x + length], [y, y], color=_style.BLACK, linewidth=1.5, solid_capstyle="butt")
    axes.text(x + 0.5 * length, y, f"{length:g} m\n", ha="center", va="center", fontsize=7)
