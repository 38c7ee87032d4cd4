"""Random graphs of similarities, and their costs by loops."""

import numpy as np

from certpgo import Estimate, RotationGraph, SimilarityGraph
from certpgo.linalg import rotations as so


def similarity_graph(rng, d=3, n=8, m=14, *, turn=0.1, scale=0.1, move=0.1, known=(), points=0):
    """A random graph with its truth, and noise of rotations, log-scales and translations.

    Pose 0 and those ``known`` have scale 1; the last ``points`` nodes are points.
    """
    poses = n - points
    R, t = so.random(rng, n, d), 3.0 * rng.standard_normal((n, d))
    s = np.exp(0.5 * rng.standard_normal(n))
    free = np.ones(n, dtype=bool)
    free[[0, *known, *range(poses, n)]] = False
    s[~free] = 1.0
    edges = [(k, k + 1) for k in range(poses - 1)]
    while len(edges) < m:
        edges.append(tuple(rng.choice(poses, 2, replace=False)))
    edges += [(i, p) for p in range(poses, n) for i in rng.choice(poses, 2, replace=False)]
    i, j = np.array(edges).T
    k = len(edges)
    seen = np.arange(k) >= k - 2 * points
    measured = np.swapaxes(R[i], 1, 2) @ R[j]
    measured = measured @ so.exp(turn * rng.standard_normal((k, so.tangent_dim(d))))
    scales = s[j] / s[i] * np.exp(scale * rng.standard_normal(k))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + move * rng.standard_normal((k, d))
    measured[seen], scales[seen] = np.eye(d), 1.0
    kappa, tau = np.exp(rng.standard_normal((2, k)))
    rotation = RotationGraph(n, np.array(edges), measured, np.where(seen, 0.0, kappa))
    is_point = np.arange(n) >= poses if points else None
    steps = steps / s[i][:, None]
    graph = SimilarityGraph(rotation, steps, tau, points=is_point, scales=scales, free=free)
    return graph, Estimate(R, t, scales=s)


def cost_by_loops(graph, estimate):
    """F, edge by edge."""
    total, rotation = 0.0, graph.rotation
    A = estimate.scales[:, None, None] * estimate.rotations
    for k, (i, j) in enumerate(graph.edges.tolist()):
        E = A[j] - graph.scales[k] * A[i] @ rotation.rotations[k]
        r = estimate.translations[j] - estimate.translations[i] - A[i] @ graph.translations[k]
        total += rotation.kappa[k] * (E * E).sum() + graph.tau[k] * (r * r).sum()
    return total
