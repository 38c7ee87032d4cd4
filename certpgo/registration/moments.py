"""Many matched points as a few: the same sum of squares for all similarities.

The cost of matches p_k, q_k of two nodes, sum w_k |A_i p_k + t_i - A_j q_k - t_j|^2, is a quadratic
form of A and t that depends on the moments of (1, p_k, q_k) alone. Any other matches with these
moments have the same cost, and seven are enough in space.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from certpgo.graph import RotationGraph, SimilarityGraph
from certpgo.linalg.arrays import FloatArray


def condensed(p: FloatArray, q: FloatArray, weights: FloatArray) -> tuple[FloatArray, ...]:
    """At most 2 d + 1 matches with the moments of many.

    Parameters
    ----------
    p, q : (k, d) matched points, each in its own frame
    weights : (k,) positive

    Returns
    -------
    Points (r, d) and (r, d), and their weights (r,), which are equal.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.registration.moments import condensed
    >>> rng = np.random.default_rng(0)
    >>> p, q, A, B = (rng.standard_normal(shape) for shape in ((99, 3), (99, 3), (3, 3), (3, 3)))
    >>> few, others, weights = condensed(p, q, np.ones(99))
    >>> total, costs = ((p @ A + q @ B) ** 2).sum(), ((few @ A + others @ B) ** 2).sum(axis=1)
    >>> len(few), bool(abs(weights @ costs - total) < 1e-9 * total)
    (7, True)
    """
    d = p.shape[1]
    rows = np.sqrt(weights)[:, None] * np.hstack([np.ones((len(p), 1)), p, q])
    # Rows of R have the moments of all; their first entries are (r, 0, ... 0).
    R = np.asarray(np.linalg.qr(rows, mode="r"))
    R[0] *= np.sign(R[0, 0])
    # A reflection makes these equal, so that each row is a match again.
    r = len(R)
    axis = np.full(r, -1.0 / np.sqrt(r))
    axis[0] += 1.0
    if r > 1:
        R -= np.outer(axis, axis @ R) * (2.0 / (axis @ axis))
    ones = R[:, :1]
    return R[:, 1 : d + 1] / ones, R[:, d + 1 :] / ones, ones[:, 0] ** 2


Matches = tuple[FloatArray, FloatArray, FloatArray]


def matched_graph(n: int, matches: Mapping[tuple[int, int], Matches]) -> SimilarityGraph:
    """The graph whose cost is sum w |A_i p + t_i - A_j q - t_j|^2 over matches, all scales unknown.

    Each match is a point that both nodes see, with twice its weight: at the best place of the point
    the two terms add up to that of the match. Those of a pair of nodes are `condensed`.

    Parameters
    ----------
    n : number of nodes, which come first
    matches : for pairs of nodes (i, j), points (k, d) in i and in j, and weights (k,)
    """
    ends, places, tau = [], [], []
    total = n
    for (i, j), found in matches.items():
        p, q, weights = condensed(*found)
        points = np.arange(total, total + len(p))
        total += len(p)
        for node, seen in ((i, p), (j, q)):
            ends.append(np.stack([np.full(len(p), node), points], axis=1))
            places.append(seen)
            tau.append(2.0 * weights)
    edges, d = np.concatenate(ends), places[0].shape[1]
    m = len(edges)
    rotation = RotationGraph(total, edges, np.tile(np.eye(d), (m, 1, 1)), np.zeros(m))
    return SimilarityGraph(
        rotation, np.concatenate(places), np.concatenate(tau), points=np.arange(total) >= n
    )
