"""Weighted least squares on a network of offsets, by eliminating one node after another.

Slower than a factorization of the graph Laplacian, but without cancellation: only positive numbers
are added, so that weights may range over any number of decades.
"""

from __future__ import annotations

import itertools

import numpy as np

from certpgo.linalg.arrays import FloatArray, IntArray

#: Edges of a node: to each neighbour, the weight and the neighbour's position minus the node's.
_Neighbours = dict[int, tuple[float, FloatArray]]


def positions(
    n: int, edges: IntArray, weights: FloatArray, offsets: FloatArray, order: IntArray
) -> FloatArray:
    """(n, r) positions x that minimise sum w |x_j - x_i - b|^2, the last in ``order`` at zero.

    Each node in turn is replaced by edges between its neighbours (the star-mesh transformation of
    electrical networks, extended to offsets).

    Parameters
    ----------
    edges : (m, 2) of a connected graph
    weights : (m,) positive w
    offsets : (m, r) measured b
    order : (n,) elimination order of the nodes
    """
    neighbours: list[_Neighbours] = [{} for _ in range(n)]
    for (i, j), w, b in zip(edges.tolist(), weights.tolist(), offsets, strict=True):
        _connect(neighbours, i, j, w, b)
    eliminated = []
    for v in order[:-1].tolist():
        total = sum(w for w, _ in neighbours[v].values())
        shares = {u: (w / total, b) for u, (w, b) in neighbours[v].items()}
        eliminated.append((v, shares))
        for u in shares:
            del neighbours[u][v]
        for (first, (share, a)), (second, (_, b)) in itertools.combinations(shares.items(), 2):
            weight = share * neighbours[v][second][0]
            if weight > 0.0:  # else it underflows, next to stronger edges
                _connect(neighbours, first, second, weight, b - a)
        neighbours[v].clear()
    x = np.zeros((n, offsets.shape[1]))
    for v, shares in reversed(eliminated):
        x[v] = sum(share * (x[u] - b) for u, (share, b) in shares.items())
    return x


def _connect(neighbours: list[_Neighbours], i: int, j: int, w: float, b: FloatArray) -> None:
    """Add an edge; parallel edges are merged into their weighted mean."""
    if j in neighbours[i]:
        v, a = neighbours[i][j]
        b = (v * a + w * b) / (v + w)
        w += v
    neighbours[i][j], neighbours[j][i] = (w, b), (w, -b)
