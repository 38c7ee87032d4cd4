"""A graph's measurements in the order in which they would arrive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.dataset import Instance, graph_of
from certpgo.graph.graph import Graph, require_one_unit
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
    instance, else numbers.

    Raises
    ------
    InputError
        There are distances, which a session does not take.

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> from certpgo.graph.streaming import streamed
    >>> [nodes for _, nodes in streamed(winding_cycle(4, 0.3, 0)[0].graph)]
    [[0, 1], [1, 2], [2, 3], [0, 3]]
    """
    graph = graph_of(measured)
    if graph.blocks:
        said = f"{measured.name}: " if isinstance(measured, Instance) else ""
        raise InputError(f"{said}{graph.blocks[0].kind.plural} cannot be streamed")
    order = arrivals(measured)
    for first in range(0, len(order), size):
        edges = order[first : first + size]
        nodes = np.unique(graph.edges[edges])
        require_one_unit(graph, "certpgo follow does")
        part = graph.with_edges(edges).subgraph(nodes)
        if isinstance(measured, Instance):
            one = _part(measured, part, nodes, edges)
            yield one, list(one.labels)
        else:
            yield part, nodes.tolist()


def _part(whole: Instance, graph: Graph, nodes: IntArray, edges: IntArray) -> Instance:
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
        numbers=whole.known_numbers[edges],
    )
