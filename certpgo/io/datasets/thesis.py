"""The synthetic data of Moreira 2020, chapters 3 and 5: Langevin noise, outliers, unit weights.

Section 5.2: a measured rotation is E_ij R_ij with E_ij of Lang(I, 1/sigma_R^2), a measured
translation t_ij + e_ij with e_ij of N(0, sigma_t^2 I). Its measured matrices are ours, see
`certpgo.graph`. Concentration 1/sigma_R^2 makes the deviation of a rotation vector
sigma_R/sqrt(2) per axis, see `certpgo.linalg.rotations.langevin`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.io.datasets.edges import edges_of_connectivity, path_with_closures, viewing_edges
from certpgo.io.datasets.synthetic import at_least, instance
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray


def langevin_scene(
    name: str,
    sigma_deg: float,
    rng: np.random.Generator,
    *,
    outliers: float = 0.0,
    per_axis: bool = False,
    turned: bool = False,
    data: str | Path | None = None,
) -> Instance:
    """Rotations on a real scene's viewing graph; 553 nodes and 103932 edges are Notre_Dame.mat's.

    Parameters
    ----------
    name : a dataset, of which only the graph's largest component is used
    sigma_deg : sigma_R, degrees
    outliers : probability that a measurement is a uniformly random rotation
    per_axis : sigma_R is the deviation of a rotation vector per axis, as the thesis' remark on
        eq. 2.5 has it: concentration 1/(2 sigma_R^2) instead of the equation's 1/sigma_R^2
    turned : an outlier is instead the true rotation, turned about a random axis by an angle that is
        uniform between 0 and 180 degrees
    data : folder to search first
    """
    stem, n, edges = viewing_edges(name, data)
    R, deviation = so.random(rng, n, 3), _deviation(sigma_deg, per_axis)
    return _rotations(f"{stem}-langevin", R, edges, deviation, outliers, rng, turned=turned)


def langevin_graph(
    n: int,
    fiedler: float,
    sigma_deg: float,
    rng: np.random.Generator,
    *,
    outliers: float = 0.0,
    d: int = 3,
    graph_seed: int | None = None,
) -> Instance:
    """Rotations on a random connected graph with a given Fiedler value, to 3 percent.

    Parameters
    ----------
    n : number of nodes: 553 in Figure 3.1, 550 in section 5.3.2
    fiedler : second eigenvalue of the graph Laplacian with unit weights
    sigma_deg : sigma_R, degrees
    outliers : probability that a measurement is a uniformly random rotation
    graph_seed : seed of the graph, to vary only the noise; by default ``rng`` generates the graph
    """
    at_least(2, n)
    drawing = rng if graph_seed is None else np.random.default_rng(graph_seed)
    edges = edges_of_connectivity(n, fiedler, drawing)
    name = f"langevin-{n}-{len(edges)}"
    return _rotations(name, so.random(rng, n, d), edges, sigma_deg, outliers, rng)


def spherical_path(
    missing: float,
    sigma_deg: float,
    sigma_t: float,
    rng: np.random.Generator,
    *,
    n: int = 1000,
    radius: float = 100.0,
    turns: int = 10,
    per_axis: bool = False,
    from_origin: bool = False,
) -> Instance:
    """The path of a robot on a sphere with most pairs of poses unmeasured; section 5.4.1.

    The thesis shows the path but does not define it. Here it is a spiral from pole to pole at
    constant speed, longitude proportional to colatitude; the robot's x axis points forward, its z
    axis outward. Consecutive poses are always measured, so that the graph is connected; the other
    measured pairs are uniformly random.

    Parameters
    ----------
    missing : share of the n(n-1)/2 pairs that are not measured, 0.8 to 0.99 in Table 5.5
    sigma_deg : sigma_R, degrees
    sigma_t : standard deviation of a measured translation per axis, metres
    radius : metres
    turns : of the spiral
    per_axis : as in `langevin_scene`
    from_origin : the first pose, not the centre of the sphere, is at the origin
    """
    pairs = n * (n - 1) // 2
    m = round((1.0 - missing) * pairs)
    if not 2 <= n <= m + 1 <= pairs + 1:
        raise InputError(f"a path of {n} poses cannot omit {missing:g} of its {pairs} pairs")
    if not sigma_t >= 0.0:
        raise InputError(f"sigma_t must not be negative: {sigma_t}")
    R, t = _spiral(n, radius, turns)
    t = t - t[0] if from_origin else t
    edges = path_with_closures(n, m, rng)
    i, j = edges.T
    measured = _langevin_measurements(R, edges, _deviation(sigma_deg, per_axis), rng)
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + sigma_t * rng.standard_normal((m, 3))
    graph = PoseGraph(RotationGraph(n, edges, measured, np.ones(m)), steps, np.ones(m))
    return instance(f"spherical_path-{n}-{m}", graph, Estimate(R, t))


def _rotations(
    name: str,
    R: FloatArray,
    edges: IntArray,
    sigma_deg: float,
    outliers: float,
    rng: np.random.Generator,
    *,
    turned: bool = False,
) -> Instance:
    if not 0.0 <= outliers <= 1.0:
        raise InputError(f"the probability of outliers must lie between 0 and 1: {outliers}")
    measured = _langevin_measurements(R, edges, sigma_deg, rng)
    wrong = rng.random(len(edges)) < outliers
    count, d = int(wrong.sum()), R.shape[-1]
    if turned:
        axes = rng.standard_normal((count, so.tangent_dim(d)))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        i, j = edges[wrong].T
        turn = so.exp(rng.uniform(0.0, np.pi, (count, 1)) * axes)
        measured[wrong] = turn @ np.swapaxes(R[i], 1, 2) @ R[j]
    else:
        measured[wrong] = so.random(rng, count, d)
    graph = RotationGraph(len(R), edges, measured, np.ones(len(edges)))
    return instance(name, graph, Estimate(R), wrong)


def _deviation(sigma_deg: float, per_axis: bool) -> float:
    """The sigma_R of eq. 2.5 that gives the reading's noise, degrees."""
    return float(np.sqrt(2.0)) * sigma_deg if per_axis else sigma_deg


def _langevin_measurements(
    R: FloatArray, edges: IntArray, sigma_deg: float, rng: np.random.Generator
) -> FloatArray:
    """E_ij R_i^T R_j, (m, d, d)."""
    if not sigma_deg >= 0.0:
        raise InputError(f"sigma_R must not be negative: {sigma_deg}")
    i, j = edges.T
    with np.errstate(divide="ignore", over="ignore"):
        concentration = float(np.radians(sigma_deg) ** -2.0)  # infinite without noise
    E = so.langevin(rng, concentration, len(edges), R.shape[-1])
    return np.asarray(E @ np.swapaxes(R[i], 1, 2) @ R[j])


def _spiral(n: int, radius: float, turns: int) -> tuple[FloatArray, FloatArray]:
    """Rotations (n, 3, 3) and positions (n, 3) at equal distances along the spiral."""
    fine = np.linspace(0.0, np.pi, 100 * n)
    arc = cumulative_trapezoid(np.hypot(1.0, 2.0 * turns * np.sin(fine)), fine, initial=0.0)
    colatitude = np.interp(np.linspace(0.0, arc[-1], n), arc, fine)
    longitude = 2.0 * turns * colatitude
    sin, cos = np.sin(colatitude), np.cos(colatitude)
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(n)], axis=1)
    level = np.stack([np.cos(longitude), np.sin(longitude), np.zeros(n)], axis=1)
    pole = np.array([0.0, 0.0, 1.0])
    up = sin[:, None] * level + cos[:, None] * pole
    south = cos[:, None] * level - sin[:, None] * pole
    ahead = south + 2.0 * turns * sin[:, None] * east
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack([ahead, np.cross(up, ahead), up], axis=2), radius * up
