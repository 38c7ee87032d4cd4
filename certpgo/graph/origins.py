"""Graphs that have one world, but measure positions from different origins of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph
from certpgo.graph.kinds import places_world
from certpgo.graph.priors import measures_from
from certpgo.linalg.arrays import BoolArray, FloatArray

#: A graph, its world, and the origin (d,) of that in the source's frame, as in `certpgo.Instance`.
Measured = tuple[Graph, int | None, FloatArray | None]


def in_one_world(measured: Sequence[Measured]) -> tuple[FloatArray | None, list[Graph]]:
    """The graphs with the same world, measured from one origin, and where that is.

    It is that of the first graph with a world, or the sources' own where that is not exact. Where a
    position of the world is measured, none is assumed, and where none is, the first assumption
    stands; the edges of others are left out. Graphs that need no change are returned as they are.

    Raises
    ------
    InputError
        No double is a position from either origin.
    """
    origins = [origin for _, world, origin in measured if world is not None]
    for common in [origins[0], None] if origins else []:
        there = [_moved(graph, world, own, common) for graph, world, own in measured]
        graphs = [graph for graph in there if graph is not None]
        if len(graphs) == len(there):
            return common, _placed_once(graphs, [world for _, world, _ in measured])
    if origins:
        both = " and ".join("0" if one is None else str(one.tolist()) for one in origins[:2])
        raise InputError(f"positions from the origins {both} cannot be joined without rounding")
    return None, [graph for graph, _, _ in measured]


def _placed_once(graphs: Sequence[Graph], worlds: Sequence[int | None]) -> list[Graph]:
    """The graphs without assumptions about where the world is that are needless."""
    free = not any(map(_places, graphs, worlds))
    placed: list[Graph] = []
    for graph in graphs:
        placing = places_world(graph)
        if placing.any():
            if not free:
                graph = graph.with_edges(~placing)
            free = False
        placed.append(graph)
    return placed


def _places(graph: Graph, world: int | None) -> bool:
    """Whether a graph measures a position from its world, or holds one there."""
    if world is None or not graph.has_positions:
        return False
    return bool(_of_world(graph, world).any()) or measures_from(graph, world)


def _of_world(graph: Graph, world: int) -> BoolArray:
    """(m,) which edges know a position in the world."""
    moved = (graph.edges[:, 0] == world) & graph.measures_translation
    return np.asarray(moved & ~places_world(graph))


def _moved(
    graph: Graph, world: int | None, own: FloatArray | None, other: FloatArray | None
) -> Graph | None:
    """The graph with the world's positions from another origin; None if that is not exact."""
    if world is None or own is other or not graph.has_positions:
        return graph
    zero = np.zeros(graph.d)
    by = _exact_sum(zero if own is None else own, zero if other is None else -other)
    t, chosen = graph.translations.copy(), _of_world(graph, world)
    positions = None if by is None else _exact_sum(t[chosen], by)
    if positions is None:
        return None
    t[chosen] = positions
    return replace(graph, translations=t)


def in_frame(
    estimate: Estimate, world: int, own: FloatArray | None, other: FloatArray | None
) -> Estimate:
    """The same estimate for measurements from another origin: the world is elsewhere."""
    t = estimate.translations
    if t is None or own is other:
        return estimate
    zero, t = np.zeros(estimate.d), t.copy()
    by = (zero if own is None else own) - (zero if other is None else other)
    t[world] -= estimate.rotations[world] @ by
    return estimate.with_translations(t)


def _exact_sum(a: FloatArray, b: FloatArray) -> FloatArray | None:
    """The sums a + b, if none of them is rounded."""
    total = np.asarray(a + b)
    return total if ((total - a == b) & (total - b == a)).all() else None
