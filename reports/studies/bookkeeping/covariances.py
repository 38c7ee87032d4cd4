"""Covariances against dense inverses of the oracle's Gauss-Newton matrix."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo import Marginals, solve
from certpgo.objective.choose_cost import objective_of
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import Findings, poses_of
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Relative error of a covariance, over its largest entry; and what central differences leave of J.
OFF, LOST = 1e-6, 1e-9


def judge(rng: np.random.Generator, found: Findings) -> None:
    """Of each node, of two jointly, and of one relative to another, at an estimate."""
    of = draw(rng, noises=(1e-3, 0.05, 0.3))
    cost = Cost(of, str(rng.choice(["chordal", "g2o", "gtsam"])))
    with found.refusals("covariances"):
        answer = solve(of.instance, cost=cost.name)
        poses = np.flatnonzero(~of.points)
        problem = objective_of(of.instance, cost.name)
        marginals = Marginals(problem, answer.estimate, int(rng.choice(poses)))
        dense, condition = inverse(cost, poses_of(answer.estimate), marginals.anchor)
        if not LOST * condition < OFF:
            found.said["ill-conditioned"] += 1
            return
        found.said["compared"] += 1
        a, b = rng.choice(of.n, 2, replace=False).tolist()
        pairs = _pairs(marginals, cost, dense, a, b, int(rng.choice(poses[poses != b])))
        for name, ours, true in pairs:
            off = np.abs(ours - true).max(initial=0.0)
            found.require(off <= OFF * np.abs(true).max(initial=0.0), f"{name}: off by {off:.3g}")


def _pairs(
    marginals: Marginals, cost: Cost, dense: Array, a: int, b: int, i: int
) -> Iterator[tuple[str, Array, Array]]:
    """What the package says, and the truth."""
    own, both = rows_of(cost.of, a), np.concatenate([rows_of(cost.of, node) for node in (a, b)])
    true, size = dense[np.ix_(own, own)], len(own)
    yield f"covariance of {a}", marginals.covariance(a), true
    yield f"covariances[{a}]", marginals.covariances[a][:size, :size], true
    yield f"joint of {a} and {b}", marginals.joint(a, b), dense[np.ix_(both, both)]
    x = poses_of(marginals.estimate)
    yield f"of {b} from {i}", marginals.relative(i, b), relative(cost, x, i, b)


def inverse(cost: Cost, x: Poses, anchor: int) -> tuple[Array, float]:
    """The inverse of J^T J without the anchor, zero there; and its condition, scaled."""
    J = cost.jacobian(x, body=True)
    free = np.setdiff1d(np.arange(cost.rows), rows_of(cost.of, anchor))
    H = J[:, free].T @ J[:, free]
    scale = np.sqrt(np.outer(np.diagonal(H), np.diagonal(H)))
    dense = np.zeros((cost.rows, cost.rows))
    dense[np.ix_(free, free)] = np.linalg.inv(H / scale) / scale
    return dense, float(np.linalg.cond(H / scale))


def relative(cost: Cost, x: Poses, i: int, j: int) -> Array:
    """Of node j where node i is the anchor; of a point in the frame of i."""
    dense, rows = inverse(cost, x, i)[0], rows_of(cost.of, j)
    found = dense[np.ix_(rows, rows)]
    return x[0][i].T @ found @ x[0][i] if cost.of.points[j] else found


def rows_of(of: Measurements, node: int) -> Array:
    """Where a node moves: translation, then rotation."""
    d, q = of.d, of.d * (of.d - 1) // 2
    steps = node * d + np.arange(d)
    if of.points[node]:
        return steps
    before = int((~of.points[:node]).sum())
    return np.concatenate([steps, of.n * d + before * q + np.arange(q)])
