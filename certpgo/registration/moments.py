"""Many matched points as a few: the same sum of squares for all similarities.

The cost of matches p_k, q_k of two nodes, sum |A_i p_k + t_i - A_j q_k - t_j|^2, is a quadratic
form of A and t that depends on the moments of (1, p_k, q_k) alone. Any other matches with these
moments have the same cost, and seven are enough in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph, RotationGraph, SimilarityGraph
from certpgo.linalg.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Matches:
    """Matched points of two nodes, and the noise of both.

    Attributes
    ----------
    i, j : the nodes
    p, q : (k, d) points, each in the frame and unit of its node
    sigma : standard deviations of their coordinates, each in the unit of its node
    """

    i: int
    j: int
    p: FloatArray
    q: FloatArray
    sigma: tuple[float, float]


def condensed(p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """At most 2 d + 1 matches with the moments of many.

    Parameters
    ----------
    p, q : (k, d) matched points, each in its own frame

    Returns
    -------
    Points (r, d) and (r, d), and the weight of each of these matches.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.registration.moments import condensed
    >>> rng = np.random.default_rng(0)
    >>> p, q, A, B = (rng.standard_normal(shape) for shape in ((99, 3), (99, 3), (3, 3), (3, 3)))
    >>> few, others, weight = condensed(p, q)
    >>> cost, same = ((p @ A - q @ B) ** 2).sum(), weight * ((few @ A - others @ B) ** 2).sum()
    >>> len(few), bool(abs(cost - same) < 1e-9 * cost)
    (7, True)
    """
    k, d = p.shape
    # R has the moments of all matches; its first column is (+-sqrt k, 0, ... 0).
    R = np.asarray(np.linalg.qr(np.hstack([np.ones((k, 1)), p, q]), mode="r"))
    r = len(R)
    R[0] *= np.sign(R[0, 0])
    if r > 1:
        # A reflection makes the column constant: then each row is a match again.
        axis = np.full(r, -1.0 / np.sqrt(r))
        axis[0] += 1.0
        R = R - np.outer(axis, axis @ R) * (2.0 / (axis @ axis))
    points = R[:, 1:] / R[:, :1]
    return points[:, :d], points[:, d:], k / r


def matched_graph(n: int, matches: Sequence[Matches]) -> Graph:
    """The graph of matched points of nodes, all of unknown scale.

    Each match of the `condensed` ones is a point that both nodes see. At the best place of the
    point, its two terms add up to |A_i p + t_i - A_j q - t_j|^2 / (sigma_i^2 + sigma_j^2).

    Parameters
    ----------
    n : number of nodes, which come before the points
    matches : of pairs of nodes
    """
    edges, places, tau, total = [], [], [], n
    for found in matches:
        p, q, weight = condensed(found.p, found.q)
        points = np.arange(total, total + len(p))
        for node, seen, sigma in ((found.i, p, found.sigma[0]), (found.j, q, found.sigma[1])):
            edges.append(np.stack([np.full(len(p), node), points], axis=1))
            places.append(seen)
            tau.append(np.full(len(p), weight / sigma**2))
        total += len(p)
    ends, seen = np.concatenate(edges), np.concatenate(places)
    m, d = seen.shape
    rotation = RotationGraph(total, ends, np.tile(np.eye(d), (m, 1, 1)), np.zeros(m))
    return SimilarityGraph(rotation, seen, np.concatenate(tau), points=np.arange(total) >= n)
