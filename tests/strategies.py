"""Hypothesis strategies and reference implementations shared by the tests."""

import numpy as np
from hypothesis import strategies as st

from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so

dimensions = st.sampled_from([2, 3])
seeds = st.integers(0, 2**32 - 1)


def rng_of(seed):
    return np.random.default_rng(seed)


def random_edges(rng, n, extra):
    """A random tree on n nodes plus ``extra`` random, possibly parallel edges, in any direction."""
    tree = [(int(rng.integers(0, k)), k) for k in range(1, n)]
    more = [tuple(rng.choice(n, 2, replace=False)) for _ in range(extra)]
    edges = np.array(tree + more, dtype=np.intp)
    flip = rng.random(len(edges)) < 0.5
    edges[flip] = edges[flip][:, ::-1]
    return edges


def rotation_graph(rng, n, d, *, extra=None, noise=0.3, weights=True):
    edges = random_edges(rng, n, 2 * n if extra is None else extra)
    truth = so.random(rng, n, d)
    i, j = edges.T
    m = len(edges)
    noise_R = so.exp(noise * rng.standard_normal((m, so.tangent_dim(d))))
    R = np.swapaxes(truth[i], 1, 2) @ truth[j] @ noise_R
    kappa = rng.uniform(0.5, 4.0, m) if weights else np.ones(m)
    return RotationGraph(n, edges, R, kappa), truth


def pose_graph(rng, n, d, *, extra=None, noise=0.1, weights=True):
    rotation, R = rotation_graph(rng, n, d, extra=extra, noise=noise, weights=weights)
    t = 3.0 * rng.standard_normal((n, d))
    i, j = rotation.edges.T
    step = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    m = len(rotation.edges)
    tau = rng.uniform(0.5, 4.0, m) if weights else np.ones(m)
    graph = PoseGraph(rotation, step + noise * rng.standard_normal((m, d)), tau)
    return graph, R, t


def dense_cost(graph, R, t=None):
    """F by a loop over the edges, as DESIGN's formula reads."""
    rotation = graph.rotations_alone if graph.has_positions else graph
    total = 0.0
    for e, (i, j) in enumerate(rotation.edges):
        total += rotation.kappa[e] * np.linalg.norm(R[j] - R[i] @ rotation.rotations[e]) ** 2
        if t is not None:
            r = t[j] - t[i] - R[i] @ graph.translations[e]
            total += graph.tau[e] * float(r @ r)
    return total


def definite(rng, m, p, condition=10.0):
    """Random symmetric positive definite matrices (m, p, p) of at most that condition."""
    B = np.linalg.qr(rng.standard_normal((m, p, p)))[0]
    A = (B * condition ** rng.uniform(-1.0, 0.0, (m, 1, p))) @ np.swapaxes(B, 1, 2)
    return 0.5 * (A + np.swapaxes(A, 1, 2))


def general_graph(rng, n, d, **options):
    """A graph whose edges have arms, and couplings N of which some have det N < 0."""
    graph, R, t = pose_graph(rng, n, d, **options)
    m = graph.num_edges
    N = graph.rotations @ definite(rng, m, d)
    N[::4, :, 0] *= -1.0
    rotation = RotationGraph(n, graph.edges, graph.rotations, graph.kappa, N)
    arms = 0.5 * rng.standard_normal((m, d))
    return PoseGraph(rotation, graph.translations, graph.tau, arms), R, t


def point_graph(rng, poses, points, d, *, noise=0.1, odometry=True):
    """A graph in which each point is seen by three poses or more, and which nodes are points.

    Nodes are in random order.
    """
    from certpgo.graph import Estimate

    n = poses + points
    place = rng.permutation(n)
    R = so.random(rng, n, d)
    t = 3.0 * rng.standard_normal((n, d))
    chain = [(k, k + 1) for k in range(poses - 1)] if odometry else []
    pairs = list(chain)
    for point in range(poses, n):
        seen = rng.choice(poses, min(poses, 3 + int(rng.integers(0, 3))), replace=False)
        pairs += [(int(pose), point) for pose in seen]
    i, j = np.array(pairs).T
    m, k, q = len(pairs), len(chain), so.tangent_dim(d)
    moved = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + noise * rng.standard_normal((m, d))
    turned = np.tile(np.eye(d), (m, 1, 1))
    turned[:k] = (
        np.swapaxes(R[i[:k]], 1, 2) @ R[j[:k]] @ so.exp(noise * rng.standard_normal((k, q)))
    )
    kappa = np.where(np.arange(m) < k, rng.uniform(0.5, 4.0, m), 0.0)
    rotation = RotationGraph(n, place[np.array(pairs)], turned, kappa)
    flags = np.zeros(n, dtype=bool)
    flags[place[poses:]] = True
    graph = PoseGraph(rotation, moved, rng.uniform(0.5, 4.0, m), points=flags)
    back = np.argsort(place)
    return graph, Estimate(R[back], t[back])
