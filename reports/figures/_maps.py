"""Trajectories and loop closures: kept in a record, aligned, and drawn from one side."""

from __future__ import annotations

import numpy as np

from certpgo import Estimate, Graph
from certpgo.graph import picture
from certpgo.plot import scale_bar
from certpgo.solve import metrics

from . import _style

#: Positions are kept to this part of the largest extent, far below a pixel.
RESOLUTION = 1e-4


def closures(graph: Graph) -> list[list[int]]:
    """The edges that are no step from one pose to the next."""
    return picture.closures(graph.edges).tolist()


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
    """Trajectories (each (n, d)) over loop closures of the first, and a bar of known length.

    In space they are seen from the side of the first, or of the trajectory ``like``.
    """
    from matplotlib.collections import LineCollection

    flat = [np.array(t) for t in trajectories]
    if flat[0].shape[1] == 3:
        frame = picture.principal_frame(flat[0] if like is None else np.array(like))
        flat = [picture.seen(t, frame) for t in flat]
    if len(edges):
        lines = LineCollection(flat[0][np.array(edges)], colors=_style.GREY, linewidths=0.15)
        lines.set(rasterized=True, alpha=0.6)
        axes.add_collection(lines)
    for line, colour, width in zip(flat, colours, widths, strict=True):
        axes.plot(*line.T, color=colour, linewidth=width, rasterized=True)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    scale_bar(axes, np.concatenate(flat))
