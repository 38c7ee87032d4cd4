"""Relative poses integrated along a spanning tree: how iSAM's ground-truth files are meant."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from certpgo.graph import Instance, PoseGraph, require_connected
from certpgo.io.format import LabelledPoses
from certpgo.linalg.arrays import BoolArray, IntArray


def integrated(instance: Instance) -> LabelledPoses:
    """Poses relative to the node of smallest id, from noise-free relative poses.

    A breadth-first tree keeps the chains, and with them the file's rounding, short.

    Raises
    ------
    GraphError
        The graph is not connected.
    """
    graph = instance.graph
    require_connected(graph)
    rotation = graph.rotation if isinstance(graph, PoseGraph) else graph
    t_edges = graph.translations if isinstance(graph, PoseGraph) else None
    n, d = graph.num_nodes, graph.d
    R = np.tile(np.eye(d), (n, 1, 1))
    t = np.zeros((n, d))
    for parent, child, edge, forward in zip(*_tree(graph.edges, n), strict=True):
        step = rotation.rotations[edge]
        R[child] = R[parent] @ (step if forward else step.T)
        if t_edges is not None:
            t[child] = t[parent] + (
                R[parent] @ t_edges[edge] if forward else -R[child] @ t_edges[edge]
            )
    return LabelledPoses(R, None if t_edges is None else t, ids=instance.ids)


def _tree(edges: IntArray, n: int) -> tuple[IntArray, IntArray, IntArray, BoolArray]:
    """Parents, children, tree edges and whether they run from parent to child; parents first."""
    both = np.concatenate([edges, edges[:, ::-1]])
    key, last = np.unique((both @ np.array([n, 1]))[::-1], return_index=True)
    edge_of = (2 * len(edges) - 1 - last) % len(edges)
    adjacency = sparse.csr_array((np.ones(len(key)), (key // n, key % n)), shape=(n, n))
    order, parents = csgraph.breadth_first_order(adjacency, 0, directed=False)
    children = order[1:].astype(np.intp)
    above = parents[children].astype(np.intp)
    tree_edges = edge_of[np.searchsorted(key, above * n + children)]
    return above, children, tree_edges, edges[tree_edges, 0] == above
