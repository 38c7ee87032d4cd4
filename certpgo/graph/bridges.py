"""Bridges of a measurement graph: edges whose removal disconnects it.

No other measurement checks a bridge: its residual is zero at the optimum.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph.edges import adjacency
from certpgo.graph.graph import Graph
from certpgo.graph.kinds import Measurements
from certpgo.linalg import compiled
from certpgo.linalg.arrays import IntArray, frozen_indices


def bridges(graph: Graph | Measurements) -> IntArray:
    """(k, 2) node pairs, smaller first, of the bridges, in linear time (up to sorting).

    The tree edge above v is a bridge if all other edges from v's subtree end in that subtree.
    Subtrees are intervals of preorder numbers, in any spanning tree. A graph keeps what was found.
    """
    kept: dict[str, IntArray] = vars(graph)
    if "bridges" not in kept:
        kept["bridges"] = frozen_indices(_bridges(graph))
    return kept["bridges"]


def _bridges(graph: Graph | Measurements) -> IntArray:
    n = graph.num_nodes
    low, high = np.sort(graph.edges, axis=1).T
    pairs, copies = np.unique(low * n + high, return_counts=True)
    low, high = np.divmod(pairs, n)
    order, parent = _spanning_tree(n, graph.components, low, high)
    is_tree = (parent[low] == high) | (parent[high] == low)
    number, size = _preorder(order, parent)
    other = ~is_tree | (copies > 1)  # a parallel edge is not the tree edge
    least, most = number.copy(), number.copy()
    for a, b in ((low[other], high[other]), (high[other], low[other])):
        np.minimum.at(least, a, number[b])
        np.maximum.at(most, a, number[b])
    lowest, highest, up = least.tolist(), most.tolist(), parent.tolist()
    for v in order[::-1].tolist():
        p = up[v]
        if p >= 0:
            lowest[p] = min(lowest[p], lowest[v])
            highest[p] = max(highest[p], highest[v])
    inside = (lowest >= number) & (highest < number + size) & (parent >= 0)
    nodes = np.flatnonzero(inside)
    return np.unique(np.sort(np.stack([nodes, parent[nodes]], axis=1), axis=1), axis=0)


def _spanning_tree(
    n: int, components: IntArray, low: IntArray, high: IntArray
) -> tuple[IntArray, IntArray]:
    """Breadth-first order of all nodes, and each one's parent (-1 for the roots)."""
    _, roots = np.unique(components, return_index=True)
    # One extra node, connected to a node of each component, joins the forest to one tree.
    i = np.concatenate([low, np.full(len(roots), n)])
    j = np.concatenate([high, roots])
    if compiled.AVAILABLE:
        parent, order = np.empty((2, n + 1), dtype=np.int64)
        compiled.kernel.tree(np.stack([i, j], axis=1).astype(np.int64), n, parent, order)
    else:
        from scipy.sparse import csgraph

        joined = adjacency(n + 1, i, j, np.ones(len(i)))
        order, parent = csgraph.breadth_first_order(joined, n, directed=False)
    parent = np.where(parent[:n] == n, -1, parent[:n])
    return np.asarray(order[1:], dtype=np.intp), np.asarray(parent, dtype=np.intp)


def _preorder(order: IntArray, parent: IntArray) -> tuple[IntArray, IntArray]:
    """Preorder number and subtree size of each node."""
    n = len(order)
    size, number, free = [1] * n, [0] * n, [0] * n
    up = parent.tolist()
    for v in order[::-1].tolist():
        if up[v] >= 0:
            size[up[v]] += size[v]
    next_root = 0
    for v in order.tolist():
        p = up[v]
        if p < 0:
            number[v], next_root = next_root, next_root + size[v]
        else:
            number[v], free[p] = free[p], free[p] + size[v]
        free[v] = number[v] + 1
    return np.array(number, dtype=np.intp), np.array(size, dtype=np.intp)
