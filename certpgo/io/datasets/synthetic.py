"""Families of graphs with known truth, as functions of a size and a random generator.

Noise multiplies a measured rotation by exp of a Gaussian tangent vector and adds a Gaussian vector
to a measured translation, each of the given standard deviation per axis. Families of poses in
space state it: kappa = 1/(2 sigma^2) and tau = 1/sigma^2, so that both terms of an edge have a mean
of 3 at the truth. Impossible sizes and parameters are refused by an InputError.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph
from certpgo.io.datasets.edges import connected_choice, random_edges, viewing_edges
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray


def winding_cycle(n: int, theta: float, winding: int, d: int = 3) -> tuple[Instance, Estimate]:
    """A cycle of n identity measurements except one Rz(theta), and a stationary point.

    At the point of winding k every residual angle is (theta + 2 pi k)/n, and the cost is
    8 n sin^2((theta + 2 pi k)/(2 n)); only k = 0, the instance's truth, is optimal (for
    abs(theta) < pi).

    Parameters
    ----------
    n : number of nodes, at least 3
    theta : angle of the last measurement, radians
    winding : k
    """
    edges = _cycle_edges(n)
    angles = np.zeros(n)
    angles[-1] = theta
    graph = RotationGraph(n, edges, _turns(angles, d), np.ones(n))

    def stationary(k: int) -> Estimate:
        return Estimate(_turns(-np.arange(n) * (theta + 2.0 * np.pi * k) / n, d))

    return instance(f"winding_cycle-{n}", graph, stationary(0)), stationary(winding)


def cycle(n: int, sigma: float, rng: np.random.Generator, d: int = 3) -> Instance:
    """A cycle of n relative rotations with noise ``sigma`` (radians) and unit weights."""
    return _rotations(f"cycle-{n}", n, _cycle_edges(n), sigma, rng, d)


def orbital(
    n: int, sigma: float, rng: np.random.Generator, closures: int = 0, reach: int = 3
) -> Instance:
    """Cameras once around the z axis: a cycle of n, as in Eriksson et al., section 6.

    Consecutive true rotations differ by 2 pi / n about z. The noise is a rotation about a uniformly
    random axis by an angle of standard deviation ``sigma`` (radians); in `cycle` that is the
    deviation per axis. Unit weights.

    Parameters
    ----------
    closures : number of additional random measurements, which make the graph a near-cycle
    reach : their maximal distance along the orbit, at least 2
    """
    if closures < 0:
        raise InputError(f"the number of closures must not be negative: {closures}")
    if closures and not 2 <= reach <= n // 2:
        raise InputError(f"reach must be 2 to half of the {n} cameras, not {reach}")
    edges = _cycle_edges(n)
    truth = Estimate(_turns(2.0 * np.pi * np.arange(n) / n, 3))
    if closures:
        i = rng.integers(0, n, closures)
        j = (i + rng.integers(2, reach + 1, closures)) % n
        edges = np.concatenate([edges, np.stack([i, j], axis=1)])
    return instance(f"orbital-{n}", _axis_noise(truth, edges, sigma, rng), truth)


def viewing_graph(
    name: str, sigma: float, rng: np.random.Generator, data: str | Path | None = None
) -> Instance:
    """Simulated rotations on a real scene's viewing graph, noise ``sigma`` per axis, unit weights.

    Parameters
    ----------
    name : a dataset, of which only the graph's largest component is used
    data : folder to look in first
    """
    stem, n, edges = viewing_edges(name, data)
    return _rotations(f"{stem}-simulated", n, edges, sigma, rng, 3)


def complete(n: int, sigma: float, rng: np.random.Generator, d: int = 3) -> Instance:
    """Relative rotations between all pairs of n nodes, noise ``sigma``, unit weights."""
    at_least(2, n)
    return _rotations(f"complete-{n}", n, np.argwhere(np.tri(n, k=-1).T), sigma, rng, d)


def random_graph(
    n: int, mean_degree: float, sigma: float, rng: np.random.Generator, d: int = 3
) -> Instance:
    """A connected random graph of relative rotations, noise ``sigma``, unit weights.

    A random tree (each node after the first is connected to an earlier one, in random order) and
    uniformly random pairs, round(n mean_degree / 2) distinct edges in total.
    """
    at_least(2, n)
    m = round(n * mean_degree / 2)
    if not n - 1 <= m <= n * (n - 1) // 2:
        raise InputError(
            f"a connected graph of {n} nodes has a mean degree of {2 - 2 / n:g} to {n - 1}, "
            f"not {mean_degree:g}"
        )
    edges = random_edges(n, m, rng)
    return _rotations(f"random-{n}-{m}", n, edges, sigma, rng, d)


def helix(
    turns: int,
    rng: np.random.Generator,
    *,
    uneven: bool = False,
    rotation_noise: float = 0.02,
    translation_noise: float = 0.02,
) -> Instance:
    """A helix of ``turns`` turns of ``turns`` poses: odometry, and edges to the turn above.

    The cylinder has circumference ``turns`` and the helix pitch 1, so that edges have about unit
    length (metres). Rotations are uniformly random; kappa is 1250 and tau 2500 for the default
    noise.

    Parameters
    ----------
    uneven : odometry has random lengths between 0 and turns / 2 instead, so that rotations act on
        long lever arms and edges between turns cross the cylinder
    """
    at_least(3, turns)
    k = np.arange(turns**2)
    arc = np.cumsum(rng.uniform(0.0, turns / 2.0, len(k))) if uneven else k
    angle, radius = 2.0 * np.pi * arc / turns, turns / (2.0 * np.pi)
    t = np.stack([radius * np.cos(angle), radius * np.sin(angle), k / turns], axis=1)
    edges = _at_distances(turns**2, (1, turns))
    return _poses(
        f"{'uneven_' * uneven}helix-{turns}", t, edges, rotation_noise, translation_noise, rng
    )


def sphere(
    rings: int,
    rng: np.random.Generator,
    *,
    rotation_noise: float = 0.05,
    translation_noise: float = 0.05,
) -> Instance:
    """A spiral of 2 rings^2 poses around a sphere: odometry, and edges to the ring above.

    Rings are 1 m apart, and cameras look outward with the way ahead to their right. kappa is 200
    and tau 400 for the default noise.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.io.datasets.synthetic import sphere
    >>> sphere(6, np.random.default_rng(0)).graph.num_edges
    131
    """
    at_least(3, rings)
    around, n = 2 * rings, 2 * rings**2
    turn = 2.0 * np.pi * np.arange(n) / around
    polar = np.pi * (np.arange(n) + 0.5) / n
    out = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1) * np.sin(polar)[:, None]
    out[:, 2] = -np.cos(polar)
    ahead = np.stack([-np.sin(turn), np.cos(turn), np.zeros(n)], axis=1)
    R = np.stack([ahead, np.cross(out, ahead), out], axis=2)
    t = rings / np.pi * out
    edges = _at_distances(n, (1, around))
    return _poses(f"sphere-{rings}", t, edges, rotation_noise, translation_noise, rng, R)


def corridor(
    n: int,
    rng: np.random.Generator,
    *,
    laps: int = 5,
    information: float = 9e3,
    noise: float = 3e-6,
) -> Instance:
    """Laps through the corridors of a building in 2D, with tiny residuals.

    A robot takes steps of about 0.4 m around a rectangle of corridors, four times as long as wide,
    and matches each scan with the last one and that of the previous lap. As in the log FRH of
    Freiburg's hospital, the measurements come from a solved map: their noise is far below that
    stated by the weights. With the defaults and n = 1316, F* is 3.5e-4 and 1.4e-11 of
    W = sum kappa + sum tau |t|^2.

    Parameters
    ----------
    n : number of poses
    laps : number of laps, of at least 8 poses each
    information : kappa (1/rad^2) and tau (1/m^2) of all edges
    noise : standard deviation per axis (radians, metres)

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.io.datasets.synthetic import corridor
    >>> instance = corridor(40, np.random.default_rng(0))
    >>> instance.graph.num_edges
    71
    """
    at_least(1, laps)
    lap = n // laps
    at_least(8, lap)
    length = 0.4 * lap  # of a lap, metres
    corners = length * np.array([0.0, 0.4, 0.5, 0.9, 1.0])
    arc = 0.4 * np.arange(n) % length
    x = np.interp(arc, corners, length * np.array([0.0, 0.4, 0.4, 0.0, 0.0]))
    y = np.interp(arc, corners, length * np.array([0.0, 0.0, 0.1, 0.1, 0.0]))
    t = np.stack([x, y], axis=1) + rng.uniform(-0.3, 0.3, (n, 2))
    heading = np.pi / 2.0 * (np.searchsorted(corners, arc, side="right") - 1)
    R = _turns(heading + rng.uniform(-0.2, 0.2, n), 2)
    edges = _at_distances(n, (1, lap))
    graph = _measured_poses(R, t, edges, (noise, noise), (information, information), rng)
    return instance(f"corridor-{n}", graph, Estimate(R, t))


def grid3d(
    side: int,
    rng: np.random.Generator,
    *,
    fraction: float = 0.95,
    rotation_noise: float = 0.1,
    translation_noise: float = 0.1,
) -> Instance:
    """A cubic grid of side^3 poses with a random ``fraction`` of its edges, kept connected.

    Neighbours are 1 m apart. Rotations are uniformly random; kappa is 50 and tau 100 for the
    default noise.
    """
    at_least(2, side)
    n = side**3
    index = np.arange(n).reshape(side, side, side)
    pairs = [
        np.stack([np.delete(index, -1, a).ravel(), np.delete(index, 0, a).ravel()], axis=1)
        for a in range(3)
    ]
    edges = np.concatenate(pairs)
    kept = round(fraction * len(edges))
    if not n - 1 <= kept <= len(edges):
        raise InputError(f"{fraction:g} of the edges do not make a connected grid of side {side}")
    chosen = connected_choice(n, edges, kept, rng)
    t = np.stack(np.unravel_index(np.arange(n), index.shape), axis=1).astype(float)
    return _poses(f"grid3d-{side}", t, edges[chosen], rotation_noise, translation_noise, rng)


def _rotations(
    name: str, n: int, edges: IntArray, sigma: float, rng: np.random.Generator, d: int
) -> Instance:
    truth = Estimate(so.random(rng, n, d))
    measured = _measured_rotations(truth.rotations, edges, sigma, rng)
    return instance(name, RotationGraph(n, edges, measured, np.ones(len(edges))), truth)


def _poses(
    name: str,
    t: FloatArray,
    edges: IntArray,
    rotation_noise: float,
    translation_noise: float,
    rng: np.random.Generator,
    R: FloatArray | None = None,
) -> Instance:
    R = so.random(rng, *t.shape) if R is None else R
    noise = rotation_noise, translation_noise
    weights = 0.5 / rotation_noise**2, 1.0 / translation_noise**2
    graph = _measured_poses(R, t, edges, noise, weights, rng)
    return instance(name, graph, Estimate(R, t))


def _measured_poses(
    R: FloatArray,
    t: FloatArray,
    edges: IntArray,
    noise: tuple[float, float],
    weights: tuple[float, float],
    rng: np.random.Generator,
) -> Graph:
    """Relative poses with noise of rotations and translations, and weights kappa and tau."""
    (n, d), m, (i, j) = t.shape, len(edges), edges.T
    measured = _measured_rotations(R, edges, noise[0], rng)
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    steps += noise[1] * rng.standard_normal((m, d))
    rotation = RotationGraph(n, edges, measured, np.full(m, weights[0]))
    return PoseGraph(rotation, steps, np.full(m, weights[1]))


def _measured_rotations(
    R: FloatArray, edges: IntArray, sigma: float, rng: np.random.Generator
) -> FloatArray:
    i, j = edges.T
    noise = sigma * rng.standard_normal((len(edges), so.tangent_dim(R.shape[-1])))
    return np.asarray(np.swapaxes(R[i], 1, 2) @ R[j] @ so.exp(noise))


def _axis_noise(truth: Estimate, edges: IntArray, sigma: float, rng: np.random.Generator) -> Graph:
    """Measurements with noise about uniformly random axes by normally distributed angles."""
    R, (i, j), m = truth.rotations, edges.T, len(edges)
    axis = rng.standard_normal((m, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    noise = so.exp(sigma * rng.standard_normal((m, 1)) * axis)
    measured = np.swapaxes(R[i], 1, 2) @ R[j] @ noise
    return RotationGraph(truth.num_nodes, edges, measured, np.ones(m))


def instance(
    name: str, graph: Graph, truth: Estimate, outliers: BoolArray | None = None
) -> Instance:
    """An instance of a synthetic graph."""
    return Instance(
        name,
        graph,
        np.arange(graph.num_nodes),
        truth=truth,
        source="synthetic",
        options={"weights": "synthetic"},
        outliers=outliers,
    )


def _cycle_edges(n: int) -> IntArray:
    at_least(3, n)
    k = np.arange(n)
    return np.stack([k, (k + 1) % n], axis=1)


def _at_distances(n: int, distances: tuple[int, ...]) -> IntArray:
    """Edges between n nodes in a row at the given distances."""
    k = np.arange(n)
    return np.concatenate([np.stack([k[:-s], k[s:]], axis=1) for s in distances])


def _turns(angles: FloatArray, d: int) -> FloatArray:
    """Rotations by angles about the z axis, or in 2D."""
    return so.exp(angles[:, None] * np.eye(so.tangent_dim(d))[-1])


def at_least(smallest: int, size: int) -> None:
    """Refuse a smaller size by an InputError."""
    if size < smallest:
        raise InputError(f"the size must be at least {smallest}, not {size}")
