"""Trajectories and loop closures: prepared for a record, aligned, and drawn from one side."""

from __future__ import annotations

import numpy as np

from certpgo import Estimate, PoseGraph, metrics
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray

from . import _style

#: The four of the thesis' six sets whose files can be had, as its tables name them, with the
#: options that reproduce its Table 5.7: (reading, EigenMA's projection).
SETS = {
    "parking-garage": ("Garage", {}, "none"),
    "cubicle": ("Cubicle", {"keep": "last"}, "none"),
    "sphere_bignoise_vertex3": ("Sphere", {}, "first"),
    "torus3D": ("Torus3D", {}, "none"),
}
#: Whose camera looks down by this angle and turns by that one, degrees.
ELEVATION, AZIMUTH = 35.0, -50.0
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


def aligned(estimate: Estimate, onto: Estimate) -> Estimate:
    """The estimate moved so that its positions lie nearest to the other's."""
    given, wished = (e.translations - e.translations.mean(axis=0) for e in (estimate, onto))
    S = so.project((wished.T @ given)[None])[0]
    shift = onto.translations.mean(axis=0) - S @ estimate.translations.mean(axis=0)
    return estimate.moved(S, shift)


def distance(estimate: Estimate, onto: Estimate) -> float:
    """Root mean square distance of positions after alignment, metres."""
    return metrics.position_errors(estimate, onto).rmse


def draw_map(axes, trajectories, edges=(), *, colours=(_style.BLUE,), widths=(0.7,)) -> None:
    """Trajectories (each (n, 3)) over loop closures of the first, and a bar of known length."""
    from matplotlib.collections import LineCollection

    flat = [_seen(np.array(t)) for t in trajectories]
    if len(edges):
        lines = LineCollection(flat[0][np.array(edges)], colors=_style.GREY, linewidths=0.15)
        lines.set(rasterized=True, alpha=0.6)
        axes.add_collection(lines)
    for line, colour, width in zip(flat, colours, widths, strict=True):
        axes.plot(*line.T, color=colour, linewidth=width, rasterized=True)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    _bar(axes, np.ptp(flat[0][:, 0]), flat[0].min(axis=0))


def _seen(t: FloatArray) -> FloatArray:
    """Positions (n, 3) in the plane of the picture, (n, 2)."""
    up, turn = np.radians(ELEVATION), np.radians(AZIMUTH)
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    return t @ np.stack([right, np.cos(up) * np.array([0.0, 0.0, 1.0]) - np.sin(up) * ahead], axis=1)


def _bar(axes, extent: float, corner: FloatArray) -> None:
    """A length of 1, 2 or 5 times a power of ten, about a fifth of the picture."""
    power = 10.0 ** np.floor(np.log10(extent / 5.0))
    length = power * max(step for step in (1, 2, 5) if step * power <= extent / 5.0)
    x, y = corner[0], corner[1] - 0.06 * extent
    axes.plot([x, x + length], [y, y], color=_style.BLACK, linewidth=1.5, solid_capstyle="butt")
    axes.text(x + 0.5 * length, y, f"{length:g} m\n", ha="center", va="center", fontsize=7)
