"""Synthetic maps of unknown scale: random ones, drifting trajectories, and sightings by cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph, SimilarityGraph
from certpgo.graph.picture import closures
from certpgo.graph.trees import compose
from certpgo.io.sightings import graph_of_sightings
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import IntArray


def random_maps(
    rng: np.random.Generator,
    d: int = 3,
    n: int = 8,
    m: int = 14,
    *,
    turn: float = 0.1,
    scale: float = 0.1,
    move: float = 0.1,
    known: Sequence[int] = (),
    points: int = 0,
) -> tuple[Graph, Estimate]:
    """A random graph with its truth: a chain, and loops between random poses.

    Parameters
    ----------
    n, m : numbers of nodes and of measurements between poses
    turn, scale, move : standard deviations of the noise of rotations, radians, of logarithms of
        scales, and of translations, in the unit of the world; positions have one of 3
    known : poses of scale 1, besides pose 0
    points : how many of the last nodes are points, each seen by two poses
    """
    poses = n - points
    R, t = so.random(rng, n, d), 3.0 * rng.standard_normal((n, d))
    s = np.exp(0.5 * rng.standard_normal(n))
    free = np.ones(n, dtype=bool)
    free[[0, *known, *range(poses, n)]] = False
    s[~free] = 1.0
    edges = [(k, k + 1) for k in range(poses - 1)]
    while len(edges) < m:
        first, second = rng.choice(poses, 2, replace=False).tolist()
        edges.append((first, second))
    edges += [(i, p) for p in range(poses, n) for i in rng.choice(poses, 2, replace=False).tolist()]
    k, (i, j) = len(edges), np.array(edges).T
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


def keyframes(plane: Estimate, edges: IntArray, every: int) -> tuple[Estimate, IntArray]:
    """Every so many poses of a trajectory in the plane, in space, and the loops between them.

    Parameters
    ----------
    plane : poses in the order of travel, with translations
    edges : (m, 2) measured pairs; those of two keyframes that are no step from one to the next are
        loops
    """
    kept = np.arange(0, plane.num_nodes, every)
    R = np.tile(np.eye(3), (len(kept), 1, 1))
    R[:, :2, :2] = plane.rotations[kept]
    t = np.pad(np.asarray(plane.translations)[kept], ((0, 0), (0, 1)))
    return Estimate(R, t), closures(edges // every)


def drifting(
    truth: Estimate,
    loops: np.ndarray,
    rng: np.random.Generator,
    *,
    walk: float = 0.02,
    turn: float = 0.002,
    move: float = 0.02,
    matched: float = 0.01,
) -> tuple[Graph, Estimate]:
    """Monocular odometry along a trajectory, and loops that measure how its scale has drifted.

    Each frame has a unit of its own: the logarithms of the scales are a random walk, of which
    odometry, which measures scales of 1, knows nothing.

    Parameters
    ----------
    truth : n poses in the order of travel, with translations
    loops : (k, 2) pairs of poses that see the same place
    walk : standard deviation of the walk's steps
    turn : of the noise of rotations, radians
    move : of translations, as a share of their length
    matched : of the logarithms of scales that loops measure

    Returns
    -------
    The graph, with all scales unknown and weights of these deviations in the unit of frame 0, where
    kappa is that of the scales, the looser ones; and the truth with the scales of the frames.
    """
    n, d, R = truth.num_nodes, truth.d, truth.rotations
    t = np.asarray(truth.translations)
    s = np.exp(np.r_[0.0, np.cumsum(walk * rng.standard_normal(n - 1))])
    steps = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    edges = np.concatenate([steps, np.asarray(loops, dtype=np.intp).reshape(-1, 2)])
    m, (i, j) = len(edges), edges.T
    measured = np.swapaxes(R[i], 1, 2) @ R[j]
    measured = measured @ so.exp(turn * rng.standard_normal((m, so.tangent_dim(d))))
    scales = s[j] / s[i] * np.exp(matched * rng.standard_normal(m))
    scales[: n - 1] = 1.0
    moved = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    length = np.linalg.norm(moved, axis=1)
    typical = float(np.median(length[: n - 1])) or 1.0
    spread = move * np.maximum(length, typical)
    moved = moved + spread[:, None] * rng.standard_normal((m, d))
    off = np.where(np.arange(m) < n - 1, walk, matched)
    rotation = RotationGraph(n, edges, measured, 0.5 / np.maximum(off, turn) ** 2)
    graph = SimilarityGraph(rotation, moved / s[i][:, None], spread**-2, scales=scales)
    return graph, Estimate(R, t, scales=s)


def ring_of_depths(
    n: int, points: int, seen: int, rng: np.random.Generator, *, noise: float = 0.03
) -> tuple[Graph, Estimate]:
    """Points that a ring of cameras sees at depths of a unit of each camera's own.

    Parameters
    ----------
    n, points : numbers of cameras, on a circle and looking inwards, and of points before them
    seen : by how many cameras each point is seen, out of the 2 ``seen`` nearest
    noise : standard deviation of depths, as a share of them

    Returns
    -------
    The graph, with all scales unknown and weights of 1; and the truth with the scales of cameras.
    """
    radius, turned = n / 16.0, 2.0 * np.pi * np.arange(n) / n
    c, sine, flat, up = np.cos(turned), np.sin(turned), np.zeros(n), np.ones(n)
    R = np.stack([[-sine, flat, -c], [c, flat, -sine], [flat, -up, flat]]).transpose(2, 0, 1)
    centres = np.stack([radius * c, radius * sine, 0.2 * rng.standard_normal(n)], axis=1)
    s = np.exp(0.3 * rng.standard_normal(n))
    around, inner = rng.uniform(0.0, n, points), radius - rng.uniform(1.0, 3.0, points)
    angle = 2.0 * np.pi * around / n
    where = np.stack([inner * np.cos(angle), inner * np.sin(angle)], axis=1)
    where = np.concatenate([where, rng.uniform(-1.0, 1.0, (points, 1))], axis=1)
    near = np.argsort(rng.random((points, min(2 * seen, n))), axis=1)[:, :seen]
    i = ((around[:, None] - seen).astype(np.intp) + near).ravel() % n
    pairs = np.stack([i, np.repeat(np.arange(points), seen)], axis=1)
    seen_at = np.einsum("kba,kb->ka", R[i], where[pairs[:, 1]] - centres[i]) / s[i][:, None]
    seen_at *= 1.0 + noise * rng.standard_normal((len(i), 1))
    graph, *_ = graph_of_sightings(pairs, seen_at, np.ones(len(i)), free=True)
    rotations = np.concatenate([R, np.tile(np.eye(3), (points, 1, 1))])
    scales = np.concatenate([s, np.ones(points)])
    truth = Estimate(rotations, np.concatenate([centres, where]), scales=scales)
    return graph, truth


def in_one_unit(graph: Graph) -> Graph:
    """The measurements as those of ordinary poses: what a program without scales makes of them."""
    return PoseGraph(graph.rotations_alone, graph.translations, graph.tau, points=graph.is_point)


def odometry(graph: Graph) -> Estimate:
    """Poses composed from one to the next, all of scale 1."""
    n = graph.num_nodes
    return replace(compose(in_one_unit(graph), np.arange(n) - 1), scales=np.ones(n))
