"""Graphs that have one world, but measure positions from different origins of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph, PoseGraph
from certpgo.linalg.arrays import FloatArray

#: A graph, its world, and the origin (d,) of that in the source's frame, as in `certpgo.Instance`.
Measured = tuple[Graph, int | None, FloatArray | None]


def from_one_origin(
    measured: Sequence[Measured],
) -> tuple[FloatArray | None, list[Graph]]:
    """Graphs whose positions are measured from one origin, and where that is.

    It is that of the first graph with a world, or the sources' own where that is not exact.

    Parameters
    ----------
    measured : graphs, their worlds, and where these have their origins in the sources' frame

    Raises
    ------
    InputError
        No double is a position from either origin.
    """
    origins = [origin for _, world, origin in measured if world is not None]
    for common in [origins[0], None] if origins else []:
        there = [moved(graph, world, own, common) for graph, world, own in measured]
        if all(graph is not None for graph in there):
            return common, [graph for graph in there if graph is not None]
    if origins:
        raise InputError(
            "positions are measured from origins that are too far apart to be joined exactly: "
            f"{' and '.join(str(np.zeros(1) if o is None else o) for o in origins[:2])}"
        )
    return None, [graph for graph, _, _ in measured]


def moved(
    graph: Graph, world: int | None, own: FloatArray | None, other: FloatArray | None
) -> Graph | None:
    """The graph with the world's positions from another origin; None if that is not exact."""
    if world is None or own is other or not isinstance(graph, PoseGraph):
        return graph
    zero = np.zeros(graph.d)
    by = _exact_sum(zero if own is None else own, zero if other is None else -other)
    t, chosen = graph.translations.copy(), (graph.edges[:, 0] == world) & (graph.tau > 0.0)
    positions = None if by is None else _exact_sum(t[chosen], by)
    if positions is None:
        return None
    t[chosen] = positions
    return replace(graph, translations=t)


def in_frame(
    estimate: Estimate, world: int, own: FloatArray | None, other: FloatArray | None
) -> Estimate:
    """The same estimate for measurements that were `moved`: the world is elsewhere."""
    t = estimate.translations
    if t is None:
        return estimate
    by = (0.0 if own is None else own) - (0.0 if other is None else other)
    t = t.copy()
    t[world] -= estimate.rotations[world] @ by
    return estimate.with_translations(t)


def _exact_sum(a: FloatArray, b: FloatArray) -> FloatArray | None:
    """The sums a + b, if none of them is rounded."""
    total = np.asarray(a + b)
    return total if ((total - a == b) & (total - b == a)).all() else None
