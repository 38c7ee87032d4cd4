"""Spanning trees of a graph, and poses composed along them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.edges import adjacency
from certpgo.graph.graph_data import GraphData
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def spanning_tree(
    graph: GraphData,
    lengths: FloatArray | None = None,
    *,
    root: int | Literal["center"] = 0,
) -> IntArray:
    """(n,) parent of each node, negative for the root, in a spanning tree of a connected graph.

    Parameters
    ----------
    lengths : (m,) positive edge lengths, whose sum the tree minimises; by default the tree is
        breadth-first, with the shortest paths
    root : a node, or ``"center"`` for one in the middle: errors accumulate along paths
    """
    if lengths is None and root == "center" and compiled.AVAILABLE:
        parents, order = np.empty((2, graph.num_nodes), dtype=np.int64)
        edges = np.ascontiguousarray(graph.edges, dtype=np.int64)
        compiled.kernel.tree(edges, -1, parents, order)
        return parents
    tree = _neighbours(graph) if lengths is None else minimum_spanning_tree(graph, lengths)
    start = _center(tree) if root == "center" else root
    return _breadth_first(tree, start)[1]


def edges_of(graph: GraphData, parents: IntArray) -> IntArray:
    """(n - 1,) the edges of a tree, in the order of the children."""
    children = np.flatnonzero(parents >= 0)
    return _edges_between(graph, parents[children], children)[0]


def tree_initialization(graph: GraphData) -> Estimate:
    """Poses composed along the breadth-first tree of a central node."""
    return compose(graph, spanning_tree(graph, root="center"))


def minimum_spanning_tree(graph: GraphData, lengths: FloatArray) -> csr_array:
    """(n, n) lengths of the edges of a minimum spanning tree, for positive lengths (m,)."""
    from scipy.sparse import csgraph

    return csgraph.minimum_spanning_tree(_simple(graph, lengths))


def _neighbours(graph: GraphData) -> csr_array:
    """(n, n) adjacency, above the diagonal."""
    low, high = np.sort(graph.edges, axis=1).T
    return adjacency(graph.num_nodes, low, high, np.ones(graph.num_edges))


def _simple(graph: GraphData, lengths: FloatArray) -> csr_array:
    """(n, n) edge lengths, the shortest of parallel edges: csgraph would add them up."""
    low, high = np.sort(graph.edges, axis=1).T
    order = np.lexsort((lengths, high, low))
    low, high = low[order], high[order]
    first = np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)]
    return adjacency(graph.num_nodes, low[first], high[first], lengths[order][first])


def _center(graph: csr_array) -> int:
    """The middle of a long shortest path."""
    end = int(_breadth_first(graph, 0)[0][-1])
    order, parents = _breadth_first(graph, end)
    path = [int(order[-1])]
    while path[-1] != end:
        path.append(int(parents[path[-1]]))
    return path[len(path) // 2]


def _breadth_first(graph: csr_array, root: int) -> tuple[IntArray, IntArray]:
    from scipy.sparse import csgraph

    order, parents = csgraph.breadth_first_order(graph, root, directed=False)
    return np.asarray(order, dtype=np.intp), np.asarray(parents, dtype=np.intp)


def compose(graph: GraphData, parents: IntArray) -> Estimate:
    """Absolute poses from the measurements on tree edges (child, parent).

    Parameters
    ----------
    parents : (n,) parent of each node, negative for the root
    """
    n, d = graph.num_nodes, graph.d
    if not compiled.AVAILABLE:
        return _composed(graph, parents)
    R, t, moved = np.empty((n, d, d)), None, None
    if graph.has_positions:
        t, moved = np.empty((n, d)), graph.steps
    edges = graph.edges, graph.rotations, None, graph.kappa, None, moved, None
    compiled.kernel.compose(edges, d, np.ascontiguousarray(parents, dtype=np.int64), R, t)
    return Estimate(so.project(R), t)


def with_leaves_placed(graph: GraphData, estimate: Estimate) -> Estimate:
    """The estimate with nodes of a single edge where that measures them, so that it costs nothing.

    Nodes that a file holds are such leaves, see `certpgo.graph.held`.
    """
    is_leaf = np.bincount(graph.edges.ravel(), minlength=graph.num_nodes) == 1
    chosen = np.flatnonzero(is_leaf[graph.edges].sum(axis=1) == 1)
    if not len(chosen):
        return estimate
    i, j = graph.edges[chosen].T
    forward = is_leaf[j]
    leaf, other = np.where(forward, [j, i], [i, j])
    R, turn = estimate.rotations.copy(), graph.rotations[chosen]
    turn = np.where(forward[:, None, None], turn, np.swapaxes(turn, 1, 2))
    turns = graph.measures_rotation[chosen]
    R[leaf[turns]] = so.project((R[other] @ turn)[turns])
    if not graph.has_positions or estimate.translations is None:
        return replace(estimate, rotations=R)
    t, arms = estimate.translations.copy(), graph.arms
    step = np.einsum("mab,mb->ma", R[i], graph.translations[chosen])
    if arms is not None:
        step -= np.einsum("mab,mb->ma", R[j], arms[chosen])
    there = t[other] + np.where(forward[:, None], step, -step)
    moves = graph.measures_translation[chosen]
    t[leaf[moves]] = there[moves]
    return replace(estimate, rotations=R, translations=t)


def _composed(graph: GraphData, parents: IntArray) -> Estimate:
    n, d = graph.num_nodes, graph.d
    children = np.flatnonzero(parents >= 0)
    edge, forward = _edges_between(graph, parents[children], children)
    R, t = np.tile(np.eye(d), (n, 1, 1)), None
    measured = graph.rotations[edge]
    R[children] = np.where(forward[:, None, None], measured, np.swapaxes(measured, 1, 2))
    if graph.has_positions:
        step, t = graph.steps[edge], np.zeros((n, d))
        back = -np.einsum("mba,mb->ma", measured, step)
        t[children] = np.where(forward[:, None], step, back)
    _jump(parents, R, t)
    return Estimate(so.project(R), t)


def _jump(parents: IntArray, R: FloatArray, t: FloatArray | None) -> None:
    """Poses in their parents' frames, composed in place by pointer jumping.

    Each round composes every node's pose with its ancestor's, then moves on to the ancestor's
    ancestor, so that log2(n) rounds suffice.
    """
    ancestor = np.where(parents >= 0, parents, np.arange(len(parents)))
    while len(below := np.flatnonzero(parents[ancestor] >= 0)):
        above = ancestor[below]
        if t is not None:
            t[below] = t[above] + np.einsum("nab,nb->na", R[above], t[below])
        R[below] = R[above] @ R[below]
        ancestor[below] = ancestor[above]


def _edges_between(
    graph: GraphData, parents: IntArray, children: IntArray
) -> tuple[IntArray, BoolArray]:
    """For each parent and child an edge between them, and whether it points to the child."""
    n, (i, j) = graph.num_nodes, graph.edges.T
    key = np.minimum(i, j) * n + np.maximum(i, j)
    # Among parallel edges the heaviest, the first of equals.
    order = np.lexsort((-graph.kappa, key))
    expected = np.minimum(parents, children) * n + np.maximum(parents, children)
    edge = order[np.searchsorted(key[order], expected)]
    return edge, i[edge] == parents
