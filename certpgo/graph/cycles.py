"""Graphs that are a single cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.edges import adjacency
from certpgo.graph.graph import Graph
from certpgo.linalg.arrays import BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Walk:
    """Once around a cycle, from node 0.

    Attributes
    ----------
    nodes : (n,) in order
    parents : (n,) the node before each, negative for node 0
    edges : (n,) the edge that leaves each node of ``nodes``
    forward : (n,) whether that edge is measured in the direction of the walk
    """

    nodes: IntArray
    parents: IntArray
    edges: IntArray
    forward: BoolArray


def is_cycle(graph: Graph) -> bool:
    """Whether the (connected) graph is a single cycle of at least three nodes."""
    degree = np.bincount(graph.edges.ravel(), minlength=graph.num_nodes)
    return graph.num_nodes >= 3 and graph.num_edges == graph.num_nodes and bool((degree == 2).all())


def walk(graph: Graph) -> Walk:
    """The walk around a cycle; GraphError for other graphs."""
    from scipy.sparse import csgraph

    n, (i, j) = graph.num_nodes, graph.edges.T
    if not is_cycle(graph):
        raise GraphError(
            f"this graph of {n} nodes and {graph.num_edges} edges is not a single cycle of at "
            "least 3 nodes"
        )
    # Depth-first search follows the cycle.
    nodes, parents = csgraph.depth_first_order(adjacency(n, i, j, np.ones(n)), 0, directed=False)
    position = np.empty(n, dtype=np.intp)
    position[nodes] = np.arange(n)
    forward = (position[j] - position[i]) % n == 1
    edges = np.argsort(np.where(forward, position[i], position[j]))
    return Walk(
        np.asarray(nodes, dtype=np.intp),
        np.asarray(parents, dtype=np.intp),
        edges,
        forward[edges],
    )
