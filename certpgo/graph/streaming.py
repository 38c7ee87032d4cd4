"""A graph's measurements in the order in which they would arrive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.capabilities import require_capable
from certpgo.graph.concatenate import with_others
from certpgo.graph.dataset import Instance, graph_of
from certpgo.graph.graph import Graph
from certpgo.graph.labels import Label
from certpgo.linalg.arrays import IntArray


def arrivals(measured: Graph | Instance) -> IntArray:
    """(m,) edges by their later pose, then by place: a loop when both its poses are there.

    Priors and sightings of landmarks are there with their pose.
    """
    graph = graph_of(measured)
    order = np.where(graph.is_point, -1, np.arange(graph.num_nodes))
    if isinstance(measured, Instance) and measured.world is not None:
        order[measured.world] = -1
    return np.argsort(order[graph.edges].max(axis=1), kind="stable")


def streamed(
    measured: Graph | Instance, size: int = 1
) -> Iterator[tuple[Graph | Instance, list[Label]]]:
    """The measurements in that order, for `certpgo.Session.add`.

    Parameters
    ----------
    size : how many come at once

    Yields
    ------
    A graph of ``size`` edges, or an instance; and what its nodes are called: the labels of an
    instance, else numbers. Distances and other kinds of measurements come as soon as edges have
    come of both of their nodes.

    Raises
    ------
    InputError
        A node has no edges, and so never comes.

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> from certpgo.graph.streaming import streamed
    >>> [nodes for _, nodes in streamed(winding_cycle(4, 0.3, 0)[0].graph)]
    [[0, 1], [1, 2], [2, 3], [0, 3]]
    """
    graph = graph_of(measured)
    require_capable(graph, "follow")
    _refuse_unreached(measured)
    order = arrivals(measured)
    come, m = np.zeros(graph.num_nodes, dtype=bool), graph.num_edges
    pairs = graph.pairs
    waiting = np.ones(len(pairs) - m, dtype=bool)
    for first in range(0, len(order), size):
        edges = order[first : first + size]
        come[graph.edges[edges]] = True
        ready = waiting & come[pairs[m:]].all(axis=1)
        waiting &= ~ready
        rows = np.append(edges, m + np.flatnonzero(ready))
        nodes = np.unique(pairs[rows])
        part = with_others(graph.with_edges(edges), ready).subgraph(nodes)
        if isinstance(measured, Instance):
            one = _part(measured, part, nodes, rows)
            yield one, list(one.labels)
        else:
            yield part, nodes.tolist()


def _refuse_unreached(measured: Graph | Instance) -> None:
    """Refuse nodes that only have other measurements than edges."""
    graph = graph_of(measured)
    for block in graph.blocks:
        unreached = np.setdiff1d(block.edges, graph.edges)
        if len(unreached):
            said = f"{measured.name}: " if isinstance(measured, Instance) else ""
            node = int(unreached[0])
            named = measured.named(node) if isinstance(measured, Instance) else f"node {node}"
            raise InputError(f"{said}{named} has {block.kind.plural} alone, which are not streamed")


def _part(whole: Instance, graph: Graph, nodes: IntArray, rows: IntArray) -> Instance:
    """Some measurements of an instance, which takes time for these alone."""
    return Instance(
        whole.name,
        graph,
        whole.ids[nodes],
        source=whole.source,
        options=whole.options,
        names=tuple(whole.names[k] for k in nodes) if whole.names else (),
        world=len(nodes) - 1 if nodes[-1] == whole.world else None,
        origin=whole.origin,
        apart=None if whole.apart is None else whole.apart[nodes],
        moved_by=whole.moved_by,
        numbers=whole.known_numbers[rows],
    )
