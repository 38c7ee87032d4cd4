"""Weighted least squares on a network of offsets, by eliminating one node after another.

Slower than a factorization of the graph Laplacian, and without its cancellation: only positive
numbers are added, so that weights over any number of decades are served.
"""

from __future__ import annotations

import itertools

import numpy as np

from certpgo.linalg.arrays import FloatArray, IntArray

#: What ties a node to another: the weight, and the other's position less the node's own.
_Ties = dict[int, tuple[float, FloatArray]]


def positions(
    n: int, edges: IntArray, weights: FloatArray, offsets: FloatArray, order: IntArray
) -> FloatArray:
    """(n, r) positions x that minimise sum w |x_j - x_i - b|^2, the last in ``order`` at zero.

    Each node in turn gives way to ties among its neighbours (the star-mesh transformation of
    electrical networks, carried out on offsets as well).

    Parameters
    ----------
    edges : (m, 2) of a connected graph
    weights : (m,) positive w
    offsets : (m, r) measured b
    order : (n,) in which nodes are eliminated
    """
    ties: list[_Ties] = [{} for _ in range(n)]
    for (i, j), w, b in zip(edges.tolist(), weights.tolist(), offsets, strict=True):
        _tie(ties, i, j, w, b)
    eliminated = []
    for v in order[:-1].tolist():
        total = sum(w for w, _ in ties[v].values())
        shares = {u: (w / total, b) for u, (w, b) in ties[v].items()}
        eliminated.append((v, shares))
        for u in shares:
            del ties[u][v]
        for (first, (share, a)), (second, (_, b)) in itertools.combinations(shares.items(), 2):
            weight = share * ties[v][second][0]
            if weight > 0.0:  # what underflows ties two nodes that hold on to stronger ones
                _tie(ties, first, second, weight, b - a)
        ties[v].clear()
    x = np.zeros((n, offsets.shape[1]))
    for v, shares in reversed(eliminated):
        x[v] = sum(share * (x[u] - b) for u, (share, b) in shares.items())
    return x


def _tie(ties: list[_Ties], i: int, j: int, w: float, b: FloatArray) -> None:
    """Add a tie; with one that is there already it makes one of their weighted mean."""
    if j in ties[i]:
        v, a = ties[i][j]
        b = (v * a + w * b) / (v + w)
        w += v
    ties[i][j], ties[j][i] = (w, b), (w, -b)
