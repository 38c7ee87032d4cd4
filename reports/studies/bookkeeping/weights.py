"""Weights over 100 decades within a graph, and all of a file's rotational information."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo import Estimate, certify, solve
from certpgo.objective.quadratic import Quadratic
from reports.studies.bookkeeping.drawing import Measurements, draw
from reports.studies.bookkeeping.judging import SAME, Claim, Findings, judge, poses_of
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Seconds for an answer.
LIMIT = 5.0


def judge_extremes(rng: np.random.Generator, found: Findings) -> None:
    """A true verdict, or a documented refusal."""
    of = _uneven(rng, draw(rng, full=0.0, distances=0.2))
    cost, starts = Cost(of), [_along(of, "kappa"), _along(of, "tau")]
    with found.refusals("solve"):
        from_file = not len(of.pairs) and rng.random() < 0.3
        instance = of.read() if from_file else of.instance
        answer = solve(instance, cost="chordal", time_limit=LIMIT)
        judge(found, cost, [Claim.of("solve", answer.certificate, answer.estimate)], starts)
    if len(of.pairs):
        return
    with found.refusals("certify"):
        tier, given = str(rng.choice(["standard", "proof"])), Estimate(*starts[0])
        certificate = certify(Quadratic(of.graph), given, tier=tier, time_limit=LIMIT)
        claim = Claim.of(f"certify, {tier}", certificate, given)
        judge(found, cost, [claim], [poses_of(certificate.best)])


def _uneven(rng: np.random.Generator, of: Measurements) -> Measurements:
    """Other weights of rotations, translations and distances, or of both alike."""
    half = 0.5 * float(rng.choice([20.0, 60.0, 100.0]))
    factors = 10.0 ** rng.uniform(-half, half, (of.m, 2))
    if rng.random() < 0.5:
        factors[:, 1] = factors[:, 0]
    rows = factors[:, (np.arange(of.information.shape[-1]) >= of.d).astype(int)]
    precisions = of.precisions * 10.0 ** rng.uniform(-half, half, len(of.pairs))
    return replace(of, information=of.information * rows[:, :, None], precisions=precisions)


def _along(of: Measurements, name: str) -> Poses:
    """Poses composed along a tree of the largest weights of this name."""
    weights = getattr(of, name)
    R, t = np.tile(np.eye(of.d), (of.n, 1, 1)), np.zeros((of.n, of.d))
    known = {int(of.edges[0, 0])}
    while len(known) < of.n:
        reach = [e for e, (i, j) in enumerate(of.edges.tolist()) if (i in known) != (j in known)]
        e = max(reach, key=lambda e: (bool(of.turned[e]), weights[e]))
        i, j = of.edges[e].tolist()
        if i in known:
            R[j] = np.eye(of.d) if of.points[j] else R[i] @ of.turns[e]
            t[j] = t[i] + R[i] @ of.steps[e]
        else:
            R[i] = R[j] @ of.turns[e].T
            t[i] = t[j] - R[i] @ of.steps[e]
        known |= {i, j}
    return R, t


def judge_mahalanobis(rng: np.random.Generator, found: Findings) -> None:
    """`--mahalanobis`: bounds hold for all of the rotational information."""
    of = draw(rng)
    about = str(rng.choice(["tangent", "quaternion"])) if of.d == 3 else "tangent"
    with found.refusals("mahalanobis"):
        instance = of.read(mahalanobis=True, rotation_information=about)
        shares = np.ones(of.information.shape[-1])
        shares[of.d :] = 0.5 if about == "quaternion" else 1.0  # half the angle
        scaled = replace(of, information=of.information * shares[:, None] * shares)
        clipped = any("lowered" in notice for notice in instance.notices)
        cost = Cost(scaled, "mahalanobis")
        answer = solve(instance, cost="chordal")
        x = poses_of(answer.estimate)
        own = Quadratic(instance.graph).cost(answer.estimate)
        true = cost.value(x)
        slack = SAME * true + 4.0 * cost.rounding(x)
        found.require(own <= true + slack, f"terms {own!r} above those of the information {true!r}")
        if not clipped:
            found.require(own >= true - slack, f"terms {own!r}, not {true!r}, and nothing is said")
        claim = Claim.of("solve", answer.certificate, x)
        if not clipped:
            judge(found, cost, [claim])
            return
        # What is certified is a lowered cost.
        found.said[f"clipped: {claim.verdict}"] += 1
        best, _ = cost.best([x, (cost.of.R, cost.of.t)])
        found.require(claim.lower <= best + slack, f"clipped: bound {claim.lower!r} above {best!r}")
