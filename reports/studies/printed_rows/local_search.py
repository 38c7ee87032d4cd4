"""Local searches on cycles, many at once: readings of the protocol of Eriksson's Table 1.

Levenberg and Marquardt's method, dense, in several parametrizations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from certpgo.io.datasets.synthetic import orbital
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray

#: Shares that Table 1 prints, by the number of cameras and sigma, percent.
PRINTED = {
    (20, 0.2): 48,
    (20, 0.5): 73,
    (50, 0.2): 50,
    (50, 0.5): 58,
    (100, 0.2): 55,
    (100, 0.5): 45,
    (200, 0.2): 40,
    (200, 0.5): 33,
}
#: Steps of a search, the factors of its damping, and where it ends.
STEPS, UP, DOWN, LEAST, SETTLED = 300, 4.0, 3.0, 1e-9, 1e-12
#: Relative difference of costs that are the same.
SAME = 1e-6

#: Parameters (b, n, p) to rotations, and how these turn with them, (b, n, 3, p).
Chart = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def possible_runs(largest: int = 200) -> list[int]:
    """Numbers of runs of which all printed shares are possible, rounded either way."""
    return [runs for runs in range(1, largest + 1) if set(PRINTED.values()) <= _shares(runs)]


def _shares(runs: int) -> set[int]:
    shares = [100.0 * hits / runs for hits in range(runs + 1)]
    return {math.floor(share + 0.5) for share in shares} | {round(share) for share in shares}


def optimum(measured: FloatArray) -> FloatArray:
    """(b,) F of the optimum of cycles (b, n, 3, 3): the closing error, shared out."""
    n = measured.shape[1]
    closing = measured[:, 0]
    for k in range(1, n):
        closing = closing @ measured[:, k]
    return np.asarray(8.0 * n * np.sin(so.angle(closing) / (2.0 * n)) ** 2)


def cycles(n: int, sigma: float, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, n, 3, 3) measurements of orbital cycles."""
    return np.stack([orbital(n, sigma, rng).graph.rotations for _ in range(count)])


def turns(rng: np.random.Generator, count: int, n: int) -> FloatArray:
    """Rotation vectors of uniformly random axes and angles uniform in [0, 2 pi]."""
    axis = rng.standard_normal((count, n, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    return np.asarray(rng.uniform(0.0, 2.0 * np.pi, (count, n, 1)) * axis)


def about_z(angles: FloatArray) -> FloatArray:
    """Rotation vectors about the z axis."""
    return np.stack([0.0 * angles, 0.0 * angles, angles], axis=-1)


STARTS: dict[str, Callable[[np.random.Generator, int, int], FloatArray]] = {
    "a turn about a random axis": turns,
    "the true rotation times such a turn": lambda rng, b, n: so.log(
        so.exp(about_z(np.broadcast_to(2.0 * np.pi * np.arange(n) / n, (b, n))))
        @ so.exp(turns(rng, b, n))
    ),
    "uniformly random rotations": lambda rng, b, n: so.log(
        so.random(rng, b * n, 3).reshape(b, n, 3, 3)
    ),
    "a turn about the z axis": lambda rng, b, n: about_z(rng.uniform(0.0, 2.0 * np.pi, (b, n))),
}


def rotation_vectors(v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R = exp(v), of which the turn by dv is the right Jacobian's."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    V = so.hat(v)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    return so.exp(v), np.eye(3) - first * V + second * V @ V


def quaternions(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R of q / |q|, real part first."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    w, x, y, z = np.moveaxis(q / norm, -1, 0)
    rows = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
    turn = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    v = 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1, keepdims=True), q[..., :1])
    axis = q[..., 1:] / np.maximum(np.linalg.norm(q[..., 1:], axis=-1, keepdims=True), 1e-300)
    return so.exp(v * axis), 2.0 * turn / norm[..., None]


def search(measured: FloatArray, start: FloatArray, chart: str) -> FloatArray:
    """(b,) F where the search ends.

    Parameters
    ----------
    measured : (b, n, 3, 3) of edges k to k + 1
    start : (b, n, 3) rotation vectors
    chart : ``"manifold"``, ``"rotation vectors"`` or ``"quaternions"``
    """
    b, n = measured.shape[:2]
    if chart == "quaternions":
        angle = np.linalg.norm(start, axis=-1, keepdims=True)
        x = np.concatenate([np.cos(angle / 2.0), np.sinc(angle / 2.0 / np.pi) * start / 2.0], -1)
        of: Chart = quaternions
    else:
        x, of = start.copy(), rotation_vectors
    R, turn = of(x)
    if chart == "manifold":
        turn = np.broadcast_to(np.eye(3), turn.shape)
    cost, damping = _cost(R, measured), np.full(b, 1e-3)
    active = np.ones(b, dtype=bool)
    for _ in range(STEPS):
        k = np.flatnonzero(active)
        if not len(k):
            break
        H, g = _normal(R[k], measured[k], turn[k])
        diagonal = np.einsum("bii->bi", H)
        diagonal += damping[k, None] * diagonal.mean(axis=1, keepdims=True)
        step = -np.linalg.solve(H, g[..., None]).reshape(len(k), n, -1)
        if chart == "manifold":
            tried, new_turn = R[k] @ so.exp(step), turn[k]
            moved = x[k]
        else:
            moved = x[k] + step
            tried, new_turn = of(moved)
        reached = _cost(tried, measured[k])
        gain = cost[k] - reached
        better = gain >= 0.0
        won = k[better]
        R[won], x[won], cost[won] = tried[better], moved[better], reached[better]
        if chart != "manifold":
            turn[won] = new_turn[better]
        damping[k] = np.maximum(np.where(better, damping[k] / DOWN, damping[k] * UP), LEAST)
        still = np.abs(gain) <= SETTLED * np.maximum(cost[k], 1e-3)
        active[k[(better & still) | (damping[k] > 1e12)]] = False
    return cost


def _cost(R: FloatArray, measured: FloatArray) -> FloatArray:
    residual = R @ measured - np.roll(R, -1, axis=1)
    return np.asarray((residual**2).sum(axis=(1, 2, 3)))


def _normal(R: FloatArray, measured: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gauss and Newton's matrix (b, np, np), and half the gradient (b, np)."""
    b, n, _, p = turn.shape
    basis = so.hat(np.eye(3))
    residual = (R @ measured - np.roll(R, -1, axis=1)).reshape(b, n, 9)
    ahead = np.einsum("bnij,ajk,bnkl->bnila", R, basis, measured).reshape(b, n, 9, 3) @ turn
    behind = -np.einsum("bnij,ajk->bnika", R, basis).reshape(b, n, 9, 3) @ turn
    behind = np.roll(behind, -1, axis=1)
    H, g = np.zeros((b, n, p, n, p)), np.zeros((b, n, p))
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    cross = np.einsum("bnra,bnrc->nbac", ahead, behind)
    H[:, i, :, i, :] += np.einsum("bnra,bnrc->nbac", ahead, ahead)
    H[:, j, :, j, :] += np.einsum("bnra,bnrc->nbac", behind, behind)
    H[:, i, :, j, :] += cross
    H[:, j, :, i, :] += np.swapaxes(cross, 2, 3)
    g[:, i] += np.einsum("bnra,bnr->bna", ahead, residual)
    g[:, j] += np.einsum("bnra,bnr->bna", behind, residual)
    return H.reshape(b, n * p, n * p), g.reshape(b, n * p)


def readings(sizes: tuple[tuple[int, float], ...], count: int) -> Iterator[tuple[str, ...]]:
    """A row for each start, parametrization and reading of sigma."""
    for noise in ("standard deviation", "variance"):
        for start, draw in STARTS.items():
            for chart in ("manifold", "rotation vectors", "quaternions"):
                shares = []
                for n, sigma in sizes:
                    rng = np.random.default_rng([n, round(10 * sigma)])
                    deviation = sigma if noise == "standard deviation" else math.sqrt(sigma)
                    measured = cycles(n, deviation, count, rng)
                    ends, best = search(measured, draw(rng, count, n), chart), optimum(measured)
                    shares.append(100.0 * float(np.mean(ends - best <= SAME * (1.0 + best))))
                yield (noise, start, chart, *(f"{share:.0f}" for share in shares))
