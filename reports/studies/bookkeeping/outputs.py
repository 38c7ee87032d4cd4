"""What commands say and write beside the verdict, judged by the oracle."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from reports.studies.bookkeeping.asking import told
from reports.studies.bookkeeping.covariances import rows_of
from reports.studies.bookkeeping.drawing import Array, Measurements
from reports.studies.bookkeeping.judging import ROUNDINGS, SAME, Findings
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Errors of trajectories in two programs, over their extent; of covariances, over their largest.
CLOSE, OFF = 1e-7, 1e-5
#: Covariances of worse conditions are not compared.
CONDITION = 1e4
#: Distances of nodes, metres, whose directions rounding changes.
SHORT = 0.05
#: Rejected measurements of which all choices are tried.
MOST = 4


def judge_truth(
    found: Findings, said: dict[str, Any] | None, estimate: Array, truth: Array
) -> None:
    """The absolute trajectory error of positions (k, d): after the best motion, by Kabsch."""
    if said is None:
        found.false.append("no accuracy, though the truth is given")
        return
    a, b = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    U, sizes, V = np.linalg.svd(a.T @ b)
    if len(a) < 3 or sizes[-1] < 1e-3 * sizes[0]:  # on a line, rotations tell
        return
    sign = np.r_[np.ones(len(sizes) - 1), np.sign(np.linalg.det(U @ V))]
    own = np.sqrt(((a @ (U * sign) @ V - b) ** 2).sum(axis=1).mean())
    size = float(np.abs(np.concatenate([a, b])).max())
    found.require(said["poses"] == len(a), f"truth of {said['poses']} poses, not {len(a)}")
    off = abs(own - said["ate_m"])
    far = np.abs(truth).max() * 1e-15
    found.require(off <= CLOSE * size + far, f"ATE {said['ate_m']!r}, not {own!r}")


def judge_proof(
    found: Findings, graph: Path, proof: Path, cost: Cost, best: float | None, *, exact: bool
) -> None:
    """A proof that was written is accepted, and its bound is below what is attained."""
    checked = told(["check", graph, proof, "--json"])
    found.require(checked.code == 0, f"check: exit {checked.code}: {checked.complaint[-200:]}")
    if checked.code == 0:
        lower = json.loads(checked.out)["lower_bound"]
        slack = SAME * abs(best or 0.0) + ROUNDINGS * cost.rounding((cost.of.R, cost.of.t))
        below = best is None or lower <= best + slack
        found.require(below, f"a proof of {lower!r} above {best!r}")
    if not exact:
        return
    checked = told(["check", graph, proof, "--exact"])
    said = f"check --exact: exit {checked.code}: {checked.complaint[-200:]}"
    found.require(checked.code == 0, said)


def judge_covariances(
    found: Findings, path: Path, cost: Cost, x: Poses, anchors: Sequence[int], ids: Sequence[int]
) -> None:
    """The rows of the file, of the nodes that have these ids, against the oracle's inverse."""
    i, j = cost.of.pairs.T
    lengths = np.linalg.norm(x[1][i] - x[1][j], axis=1)
    if cost.name == "rotations" or lengths.min(initial=1.0) < SHORT:
        return
    J = cost.jacobian(x, body=True)
    fixed = np.concatenate([rows_of(cost.of, node) for node in anchors])
    free = np.setdiff1d(np.arange(cost.rows), fixed)
    H = J[:, free].T @ J[:, free]
    sizes = np.sqrt(np.diagonal(H))
    if not (sizes > 0.0).all() or not np.linalg.cond(H / np.outer(sizes, sizes)) < CONDITION:
        found.said["ill-conditioned"] += 1
        return
    dense = np.zeros((cost.rows, cost.rows))
    dense[np.ix_(free, free)] = np.linalg.inv(H / np.outer(sizes, sizes)) / np.outer(sizes, sizes)
    with path.open() as file:
        rows = {int(row[0]): row[1:] for row in list(csv.reader(file))[1:]}
    found.require(set(rows) == set(ids), f"covariances of {sorted(rows)}, not {sorted(ids)}")
    for node, name in enumerate(ids):
        if name not in rows:
            continue
        own = rows_of(cost.of, node)
        true = dense[np.ix_(own, own)]
        own = true[np.triu_indices(len(true))]
        said = np.array([float(word) for word in rows[name] if word])
        size = float(np.abs(np.diagonal(dense)).max())
        same = said.shape == own.shape and np.abs(said - own).max() <= OFF * size
        found.require(same, f"covariance of {name}: {said[:4]}, not {own[:4]}")


def judge_rejection(
    found: Findings,
    name: str,
    whole: Cost,
    rejected: Sequence[int],
    prices: Array,
    poses: Poses,
    said: dict[str, Any],
) -> None:
    """The truncated cost of an estimate, and its bound, against all choices."""
    terms = whole.terms(poses)
    kept = np.delete(np.arange(whole.of.m), rejected)
    of_distances = whole.value(poses) - terms.sum()
    own = terms[kept].sum() + of_distances + np.minimum(terms[list(rejected)], prices).sum()
    slack = SAME * own + ROUNDINGS * whole.rounding(poses)
    off = abs(own - said["cost"])
    found.require(off <= slack + said["tolerance"], f"{name}: {said['cost']!r}, not {own!r}")
    if len(rejected) > MOST:
        return
    best = min(own, least(whole, rejected, prices, [poses, (whole.of.R, whole.of.t)]))
    lower = said["lower_bound"]
    found.require(lower <= best + slack, f"{name}: bound {lower!r} above {best!r}")
    if said["verdict"] == "CERTIFIED":
        said_so = f"{name}: CERTIFIED {own!r}, but {best!r} is attained"
        found.require(own - best <= said["tolerance"] + slack, said_so)


def least(whole: Cost, rejected: Sequence[int], prices: Array, starts: Iterable[Poses]) -> float:
    """The least truncated cost over all choices of the rejected ones that are paid for."""
    values, starts = [], list(starts)
    for count in range(len(rejected) + 1):
        for paid in combinations(range(len(rejected)), count):
            out = [rejected[k] for k in paid]
            rest = Cost(whole.of.subset(np.delete(np.arange(whole.of.m), out)), whole.name)
            values.append(rest.best(starts)[0] + float(prices[list(paid)].sum()))
    return min(values)


def stamped(times: Sequence[str], poses: Poses, of: Measurements) -> str:
    """Poses as TUM has them, with these times."""
    lines = []
    for time, R, t in zip(times, *poses, strict=True):
        turn, at = np.eye(3), np.zeros(3)
        turn[: of.d, : of.d], at[: of.d] = R, t
        numbers = [*at.tolist(), *Rotation.from_matrix(turn).as_quat().tolist()]
        lines.append(" ".join([time, *map(repr, numbers)]))
    return "\n".join(lines) + "\n"
