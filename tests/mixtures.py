"""Graphs with full information, GPS, landmarks and distances, and their costs in NumPy."""

import numpy as np
from features import added
from scipy.spatial.transform import Rotation

from certpgo import Estimate, Ranges, SimilarityGraph
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.linalg import rotations as so

COSTS = ["chordal", "g2o", "gtsam"]


def mixture(rng, d, n=14, landmarks=4, fixes=5, distances=12):
    """A walk with loops, landmarks that it sees, fixes, and distances between any two nodes."""
    q, N = so.tangent_dim(d), n + landmarks
    world = N
    R = so.exp(0.6 * rng.normal(size=(N + 1, q)))
    t = np.cumsum(rng.normal(size=(N + 1, d)), axis=0)
    R[-1], t[-1] = np.eye(d), 0.0
    steps = [(k, k + 1) for k in range(n - 1)]
    loops = [tuple(rng.choice(n, 2, replace=False)) for _ in range(n)]
    seen = [(int(rng.integers(n)), n + k) for k in range(landmarks) for _ in range(3)]
    gps = [(world, int(k)) for k in rng.choice(n, fixes, replace=False)]
    edges = np.array(steps + loops + seen + gps)
    m, whole = len(edges), len(steps) + len(loops)
    A = rng.normal(size=(m, d + q, d + q))
    information = 40.0 * (np.eye(d + q) + 0.1 * A @ np.swapaxes(A, 1, 2))
    information[whole:, d:] = information[whole:, :, d:] = 0.0
    information = 0.5 * (information + np.swapaxes(information, 1, 2))
    i, j = edges.T
    noise = 0.1 * rng.normal(size=(m, d + q))
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ so.exp(noise[:, d:])
    measured[whole:] = np.eye(d)
    steps_ = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + noise[:, :d]
    kappa = np.where(np.arange(m) < whole, 40.0, 0.0)
    graph = PoseGraph(
        RotationGraph(N + 1, edges, measured, kappa),
        steps_,
        np.full(m, 40.0),
        points=(np.arange(N + 1) >= n) & (np.arange(N + 1) < N),
        absolute=i == world,
    )
    about = "quaternion" if d == 3 else "tangent"
    graph = graph.with_information(Information.of(information, "g2o", about))
    pairs = np.array([rng.choice(N, 2, replace=False) for _ in range(distances)])
    length = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
    measured_lengths = np.abs(length + 0.1 * rng.normal(size=distances))
    ranges = Ranges(N + 1, pairs, measured_lengths, rng.uniform(20.0, 60.0, distances))
    return graph.with_ranges(ranges), Estimate(R, t)


def scaled_mixture(rng, d, n=8, *, noise=0.03, known=(), distances=6, fixes=4, heights=4, points=1):
    """A monocular map with loops, GPS from a world, distances of any nodes, heights in the world.

    The world is the last node, and the points are before it.
    """
    q, N = so.tangent_dim(d), n + points + 1
    world = N - 1
    R = so.exp(0.6 * rng.normal(size=(N, q)))
    t = 2.0 * np.cumsum(rng.normal(size=(N, d)), axis=0) / np.sqrt(n)
    R[world], t[world] = np.eye(d), 0.0
    s = np.exp(0.5 * rng.normal(size=N))
    free = np.arange(N) < n
    free[list(known)] = False
    s[~free] = 1.0
    steps = [(k, k + 1) for k in range(n - 1)]
    loops = [tuple(rng.choice(n, 2, replace=False)) for _ in range(n)]
    seen = [(int(i), n + k) for k in range(points) for i in rng.choice(n, 3, replace=False)]
    gps = [(world, int(k)) for k in rng.choice(n, fixes, replace=False)]
    edges = np.array(steps + loops + seen + gps)
    (i, j), m, whole = edges.T, len(edges), len(steps) + len(loops)
    turned = np.arange(m) < whole
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ so.exp(noise * rng.normal(size=(m, q)))
    measured[~turned] = np.eye(d)
    scales = np.where(turned, s[j] / s[i] * np.exp(noise * rng.normal(size=m)), 1.0)
    moved = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] / s[i, None]
    moved = moved + noise * rng.normal(size=(m, d))
    is_point = (np.arange(N) >= n) & (np.arange(N) < world)
    graph = SimilarityGraph(
        RotationGraph(N, edges, measured, np.where(turned, 30.0, 0.0)),
        moved,
        rng.uniform(20.0, 60.0, m),
        points=is_point,
        absolute=i == world,
        scales=scales,
        free=free,
    )
    blocks = []
    if distances:
        pairs = np.array([rng.choice(N, 2, replace=False) for _ in range(distances)])
        length = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
        length = np.abs(length + noise * rng.normal(size=distances))
        blocks.append(Ranges(N, pairs, length, rng.uniform(20.0, 60.0, distances)))
    if heights:
        above = rng.choice(N - 1, heights, replace=False)
        normals = rng.normal(size=(heights, d))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        high = (normals * t[above]).sum(axis=1) + noise * rng.normal(size=heights)
        pairs = np.stack([np.full(heights, world), above], axis=1)
        weights = rng.uniform(20.0, 60.0, heights)
        blocks.append(added.Heights(N, pairs, normals, high, weights))
    return graph.with_blocks(*blocks), Estimate(R, t, scales=s)


def independent(graph, cost, x):
    """Residuals by the documented formulas, in SciPy's rotations: nothing of the package."""
    d, n = graph.d, graph.num_nodes
    t, w = x[: n * d].reshape(n, d), x[n * d :].reshape(n, -1)
    if d == 2:
        c, s = np.cos(w[:, 0]), np.sin(w[:, 0])
        R = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    else:
        R = Rotation.from_rotvec(w).as_matrix()
    out = []
    for e, (i, j) in enumerate(graph.edges):
        M, tau, kappa = graph.rotations[e], graph.tau[e], graph.kappa[e]
        omega = graph.information_matrices[e]
        v, Q = R[i].T @ (t[j] - t[i]), R[i].T @ R[j]
        E, y = M.T @ Q, M.T @ (v - graph.translations[e])
        if cost == "chordal":
            out += [np.sqrt(tau) * y, np.sqrt(kappa) * (E - np.eye(d)).ravel()]
            continue
        if kappa == 0.0:
            T = omega[:d, :d]
            out.append(np.linalg.cholesky(T).T @ (v - graph.translations[e]))
            continue
        if d == 2:
            a = np.arctan2(E[1, 0], E[0, 0])
            if cost == "gtsam":
                h = 0.5 * a / np.tan(0.5 * a) if a else 1.0
                y = np.array([[h, 0.5 * a], [-0.5 * a, h]]) @ y
            r = np.r_[y, a]
        else:
            o = Rotation.from_matrix(E).as_rotvec()
            if cost == "gtsam":
                theta = np.linalg.norm(o)
                K = np.cross(o, np.eye(3)).T
                c = (1.0 - 0.5 * theta / np.tan(0.5 * theta)) / theta**2
                r = np.r_[(np.eye(3) - 0.5 * K + c * K @ K) @ y, o]
            else:
                quaternion = Rotation.from_matrix(E).as_quat()
                r = np.r_[y, quaternion[:3] * np.sign(quaternion[3])]
        out.append(np.linalg.cholesky(omega).T @ r)
    i, j = graph.ranges.edges.T
    off = np.linalg.norm(t[j] - t[i], axis=1) - graph.ranges.distances
    out.append(np.sqrt(graph.ranges.weights) * off)
    return np.concatenate(out)


def coordinates(estimate):
    return np.concatenate([estimate.translations.ravel(), so.log(estimate.rotations).ravel()])
