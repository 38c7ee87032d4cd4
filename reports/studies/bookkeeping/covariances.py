"""Covariances against dense inverses of the oracle's Gauss-Newton matrix."""

from __future__ import annotations

import numpy as np

from certpgo import Marginals, solve
from certpgo.costs import certifiable
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import Findings, poses_of
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Relative error of a covariance, over its largest entry, and what is lost to each condition.
OFF, LOST = 1e-6, 1e-13


def judge(rng: np.random.Generator, found: Findings) -> None:
    """Of each node, of two jointly, and of one relative to another, at an estimate."""
    of = draw(rng, noises=(1e-3, 0.05, 0.3))
    cost = Cost(of, str(rng.choice(["chordal", "g2o", "gtsam"])))
    with found.refusals("covariances"):
        answer = solve(of.instance, cost=cost.name)
        x = poses_of(answer.estimate)
        poses = np.flatnonzero(~of.points)
        anchor = int(rng.choice(poses))
        marginals = Marginals(certifiable(of.instance, cost.name), answer.estimate, anchor)
        dense, slack = inverse(cost, x, anchor)
        if not slack < OFF:
            found.said["ill-conditioned"] += 1
            return
        found.said["compared"] += 1
        a, b = rng.choice(of.n, 2, replace=False).tolist()
        rows = np.concatenate([_rows(of, a), _rows(of, b)])
        i = int(rng.choice(poses[poses != b]))
        said = {
            f"covariance of {a}": (marginals.covariance(a), dense[np.ix_(_rows(of, a), _rows(of, a))]),
            f"joint of {a} and {b}": (marginals.joint(a, b), dense[np.ix_(rows, rows)]),
            f"of {b} from {i}": (marginals.relative(i, b), relative(cost, x, i, b)),
        }
        size = len(_rows(of, a))
        said["all at once"] = marginals.covariances[a][:size, :size], said[f"covariance of {a}"][1]
        for name, (ours, true) in said.items():
            off = np.abs(ours - true).max() / max(np.abs(true).max(), 1e-300)
            found.require(off <= OFF or not np.abs(ours - true).any(), f"{name}: off by {off:.3g}")


def inverse(cost: Cost, x: Poses, anchor: int) -> tuple[Array, float]:
    """The inverse of J^T J without the anchor, zero there; and its expected relative error."""
    J = cost.jacobian(x, body=True)
    free = np.setdiff1d(np.arange(cost.rows), _rows(cost.of, anchor))
    H = J[:, free].T @ J[:, free]
    scaled = np.sqrt(np.diagonal(H))
    unit = H / scaled[:, None] / scaled
    dense = np.zeros((cost.rows, cost.rows))
    dense[np.ix_(free, free)] = np.linalg.inv(unit) / scaled[:, None] / scaled
    return dense, LOST / STEP_ERROR * float(np.linalg.cond(unit))


#: Central differences know about nine digits.
STEP_ERROR = 1e-4


def relative(cost: Cost, x: Poses, i: int, j: int) -> Array:
    """Of node j with node i as the anchor: nothing but the frame of i moves."""
    dense, _ = inverse(cost, x, i)
    rows = _rows(cost.of, j)
    found = dense[np.ix_(rows, rows)]
    if cost.of.points[j]:
        R = x[0][i]
        found = R.T @ found @ R
    return found


def _rows(of: Measurements, node: int) -> Array:
    """Where a node moves: translation, then rotation."""
    d, q = of.d, of.d * (of.d - 1) // 2
    steps = node * d + np.arange(d)
    if of.points[node]:
        return steps
    before = int((~of.points[:node]).sum())
    return np.concatenate([steps, of.n * d + before * q + np.arange(q)])
