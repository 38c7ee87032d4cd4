"""A graph's measurements in the order in which they would arrive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.graph.graph import Graph
from certpgo.graph.instance import Instance
from certpgo.linalg.arrays import IntArray


def arrivals(graph: Graph) -> IntArray:
    """(m,) edges by their larger node, then by place: each loop when its later pose is there."""
    return np.argsort(graph.edges.max(axis=1), kind="stable")


def streamed(measured: Graph | Instance, size: int = 1) -> Iterator[tuple[Graph, list[int]]]:
    """The measurements in that order, for `certpgo.Session.add`.

    Parameters
    ----------
    size : how many come at once

    Yields
    ------
    A graph of ``size`` edges, and the names of its nodes: ids of an instance, else numbers.

    Examples
    --------
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> from certpgo.graph.streaming import streamed
    >>> [nodes for _, nodes in streamed(winding_cycle(4, 0.3, 0)[0].graph)]
    [[0, 1], [1, 2], [2, 3], [0, 3]]
    """
    graph = measured.graph if isinstance(measured, Instance) else measured
    names = measured.ids if isinstance(measured, Instance) else np.arange(graph.num_nodes)
    order = arrivals(graph)
    for first in range(0, len(order), size):
        edges = order[first : first + size]
        nodes = np.unique(graph.edges[edges])
        yield graph.with_edges(edges).subgraph(nodes), names[nodes].tolist()
