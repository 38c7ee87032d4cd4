"""Weights over 100 decades within a graph, and all of a file's rotational information."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo import Estimate, certify, solve
from certpgo.objective.problem import problem_of
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import SAME, Claim, Findings, judge, poses_of
from reports.studies.bookkeeping.oracle import Cost, Poses


def judge_extremes(rng: np.random.Generator, found: Findings) -> None:
    """A true verdict, or a documented refusal."""
    of = draw(rng, full=0.0, distances=0.2)
    decades = float(rng.choice([20.0, 60.0, 100.0]))
    parts = np.repeat(10.0 ** rng.uniform(-decades / 2, decades / 2, (of.m, 2)), 2, axis=1)
    if rng.random() < 0.5:
        parts[:, 2:] = parts[:, :2]
    size, d = of.information.shape[-1], of.d
    factors = np.where(np.arange(size) < d, parts[:, :1], parts[:, -1:])
    information = of.information * factors[:, :, None]
    precisions = of.precisions * 10.0 ** rng.uniform(-decades / 2, decades / 2, len(of.pairs))
    of = replace(of, information=information, precisions=precisions)
    cost = Cost(of)
    with found.refusals("solve"):
        from_file = not len(of.pairs) and rng.random() < 0.3
        instance = of.read() if from_file else of.instance
        answer = solve(instance, cost="chordal", time_limit=5.0)
        starts = [_along(of), *([_along(of, by="tau")] if of.m else [])]
        claims = [Claim.of("solve", answer.certificate, answer.estimate)]
        judge(found, cost, claims, starts)
    if not len(of.pairs):
        with found.refusals("certify"):
            x = _along(of)
            estimate = Estimate(*x)
            tier = str(rng.choice(["standard", "proof"]))
            certificate = certify(problem_of(of.graph), estimate, tier=tier, time_limit=5.0)
            given = Claim.of(f"certify, {tier}", certificate, estimate)
            judge(found, cost, [given], [poses_of(certificate.best)])


def _along(of: Measurements, by: str = "kappa") -> Poses:
    """Poses composed along a tree of the heaviest measurements."""
    weight = getattr(of, by) if by == "tau" else np.where(of.turned, of.kappa, of.tau * 1e-300)
    R, t = np.tile(np.eye(of.d), (of.n, 1, 1)), np.zeros((of.n, of.d))
    known = {int(of.edges[0, 0])}
    while len(known) < of.n:
        reach = [e for e, (i, j) in enumerate(of.edges.tolist()) if (i in known) != (j in known)]
        e = max(reach, key=lambda e: (bool(of.turned[e]), weight[e]))
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
        scale = 0.25 if about == "quaternion" else 1.0
        shares = np.ones(of.information.shape[-1])
        shares[of.d :] = np.sqrt(scale)
        # Rows of positions alone keep tau.
        scaled = replace(of, information=of.information * shares[:, None] * shares)
        clipped = any("lowered" in notice or "clipped" in notice for notice in instance.notices)
        order = _as_read(of)
        cost = Cost(scaled.subset(order), "mahalanobis")
        answer = solve(instance, cost="chordal")
        x = poses_of(answer.estimate)
        own = problem_of(instance.graph).cost(answer.estimate)
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


def _as_read(of: Measurements) -> Array:
    """The order in which the reader puts measurements: poses, then sightings, then priors."""
    prior = of.world & (of.edges[:, 0] == of.n - 1)
    return np.lexsort((np.arange(of.m), of.points[of.edges[:, 1]], prior))
