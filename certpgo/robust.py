"""What robust methods share: weights that keep a graph in one piece."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csgraph

from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.blocks import adjacency
from certpgo.problem import Problem

#: Measurements over those of a tree, below which a fit says little.
MEANINGFUL = 1.1


def connected(problem: Problem, weights: FloatArray, costs: FloatArray) -> FloatArray:
    """The weights (m,) with as many zeros made ones as keep the graph connected.

    Where all measurements that tie a part of the graph to the rest are rejected, one of them must
    be believed nevertheless: the cheapest, as ``costs`` (m,) have it. It alone then says how the
    part stands, so that its residual is zero at the optimum, whatever its weight.
    """
    n, (i, j) = problem.n, problem.graph.edges.T
    kept = weights > 0.0
    tied = adjacency(n, i[kept], j[kept], np.ones(int(kept.sum())))
    count, part = csgraph.connected_components(tied, directed=False)
    if count == 1:
        return weights
    crossing = np.flatnonzero(part[i] != part[j])
    cheapest = _one_a_pair(count, part[i[crossing]], part[j[crossing]], costs[crossing])
    crossing = crossing[cheapest]
    # A minimum spanning tree by rank, as trees take zeros for missing edges.
    rank = np.empty(len(crossing))
    rank[np.argsort(costs[crossing], kind="stable")] = np.arange(1.0, len(crossing) + 1.0)
    ends = part[i[crossing]], part[j[crossing]]
    tree = csgraph.minimum_spanning_tree(adjacency(count, *ends, rank))
    believed = np.array(weights)
    believed[crossing[np.isin(rank, tree.data)]] = 1.0
    return believed


def remark(problem: Problem, weights: FloatArray) -> str:
    """What a reader should know of what was kept; empty where that is as it should be."""
    kept, n = int((weights > 0.0).sum()), problem.n
    if kept == problem.graph.num_edges:
        return "no measurement was rejected"
    if kept < MEANINGFUL * (n - 1):
        return (
            f"{kept} measurements of {n} nodes are hardly more than a tree, which any answer fits"
        )
    return ""


def _one_a_pair(n: int, i: IntArray, j: IntArray, costs: FloatArray) -> IntArray:
    """Places of the cheapest of each pair {i, j}."""
    order = np.argsort(costs, kind="stable")
    codes = np.minimum(i, j) * n + np.maximum(i, j)
    return order[np.unique(codes[order], return_index=True)[1]]
