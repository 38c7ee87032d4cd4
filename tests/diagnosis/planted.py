"""Small graphs whose noise is as stated, in which mistakes are planted."""

from dataclasses import replace

import numpy as np
from strategies import rng_of

from certpgo import Instance, PoseGraph, RotationGraph, with_priors
from certpgo.graph.information import Information
from certpgo.graph.trees import compose
from certpgo.linalg import rotations as so

#: Standard deviations of translations and of angles, and numbers of poses and loop closures.
MOVED, TURNED = 0.05, 0.01
N, CLOSURES = 40, 30


def walk(d, seed=0, *, nodes=False):
    """An instance as of a g2o file: odometry, then loop closures; its nodes are along odometry."""
    rng = rng_of(seed + 100 * d)
    turns = so.exp(0.3 * rng.standard_normal((N, so.tangent_dim(d))))
    R, t = np.empty((N, d, d)), np.zeros((N, d))
    R[0] = so.project(rng.standard_normal((1, d, d)))[0]
    for k in range(1, N):
        R[k] = R[k - 1] @ turns[k]
        t[k] = t[k - 1] + R[k - 1] @ (np.eye(d)[0] + 0.2 * rng.standard_normal(d))
    steps = [(k, k + 1) for k in range(N - 1)]
    pairs = [(i, j) for i in range(N) for j in range(i + 6, N)]
    chosen = rng.choice(len(pairs), CLOSURES, replace=False)
    edges = np.array(steps + [pairs[k][:: 1 if rng.random() < 0.5 else -1] for k in chosen])
    return posed(edges, *relative(R, t, edges, rng), nodes=nodes)


def relative(R, t, edges, rng):
    """Noisy poses of the second nodes in the first ones."""
    (i, j), (d, m) = edges.T, (R.shape[1], len(edges))
    back = np.swapaxes(R[i], 1, 2)
    Q, v = back @ R[j], np.einsum("mab,mb->ma", back, t[j] - t[i])
    v = v + np.einsum("mab,mb->ma", Q, MOVED * rng.standard_normal((m, d)))
    return Q @ so.exp(TURNED * rng.standard_normal((m, so.tangent_dim(d)))), v


def posed(edges, R, t, matrices=None, *, nodes=False):
    """The instance of these measurements; information is about quaternions, as g2o takes it."""
    d, m = R.shape[1], len(edges)
    turned = np.full(so.tangent_dim(d), (1.0 if d == 2 else 4.0) / TURNED**2)
    if matrices is None:
        matrices = np.tile(np.diag(np.r_[np.full(d, MOVED**-2), turned]), (m, 1, 1))
    kappa, tau = matrices[:, -1, -1], matrices[:, 0, 0]
    rotation = RotationGraph(int(edges.max()) + 1, edges, R, kappa * (1.0 if d == 2 else 0.125))
    information = Information.of(matrices, "g2o", "tangent" if d == 2 else "quaternion")
    graph = PoseGraph(rotation, t, tau, information=information)
    initial = along_odometry(graph) if nodes else None
    return Instance("walk", graph, np.arange(graph.num_nodes), initial=initial)


def along_odometry(graph):
    """Poses composed along odometry."""
    return compose(graph, np.arange(graph.num_nodes) - 1)


def changed(instance, **columns):
    """Other edges, rotations or translations."""
    return replace(instance, graph=replace(instance.graph, **columns))


def inverted(instance, rows):
    """Some measurements as their inverses."""
    graph = instance.graph
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[rows] = np.swapaxes(R[rows], 1, 2)
    t[rows] = -np.einsum("mab,mb->ma", R[rows], t[rows])
    return changed(instance, rotations=R, translations=t)


def weighed(instance, matrices):
    """Other information matrices, as read with them."""
    graph = instance.graph
    return posed(graph.edges, graph.rotations, graph.translations, matrices)


def with_positions(instance, positions, sigma):
    """Measured positions of all poses, in the world."""
    n = len(positions)
    graph = with_priors(
        instance.graph.with_information(None),
        np.arange(n),
        translations=positions,
        tau=sigma**-2,
    )
    return replace(instance, graph=graph, ids=np.arange(n + 1), world=n)
