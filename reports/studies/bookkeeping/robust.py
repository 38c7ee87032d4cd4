"""Robust answers, in batch and in sessions: what is proven is about the measurements kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo import RobustSession, Session, solve_robustly
from reports.studies.bookkeeping.drawing import Array, Measurements, draw, rotations
from reports.studies.bookkeeping.judging import SAME, Claim, Findings, judge, poses_of, standing
from reports.studies.bookkeeping.oracle import Cost
from reports.studies.bookkeeping.sessions import LIMIT, growing, of_known, part_of, poses_in


def judge_batch(rng: np.random.Generator, found: Findings) -> None:
    """`solve_robustly`: the certificate is about those kept, the cost about all."""
    of = with_outliers(rng, draw(rng, nodes=(4, 10), loops=1.5, noises=(1e-3, 0.05)))
    with found.refusals("robust"):
        posed = of.instance if rng.random() < 0.5 else of.graph
        answer = solve_robustly(posed, cost="chordal", time_limit=LIMIT)
        kept = np.ones(of.m, dtype=bool)
        kept[answer.solution.rejected] = False
        x = answer.estimate
        judge(found, Cost(of.subset(kept)), [Claim.of("kept", answer.certificate, x)])
        whole, own = Cost(of), Cost(of).value(poses_of(x))
        slack = SAME * own + 4.0 * whole.rounding(poses_of(x))
        found.require(abs(own - answer.cost) <= slack, f"F of all {answer.cost!r}, not {own!r}")


def judge_session(rng: np.random.Generator, found: Findings) -> None:
    """`RobustSession`: kept and rejected are all that came, each once."""
    of = with_outliers(rng, draw(rng, nodes=(4, 8), priors=0.0, noises=(1e-3, 0.05)))
    of = of.subset(growing(rng, of))
    cost = Cost(of, str(rng.choice(["chordal", "g2o", "gtsam"])))
    session = RobustSession(every=int(rng.integers(2, 12)), cost=cost.name, time_limit=LIMIT)
    fed: list[int] = []
    with found.refusals("robust session"):
        cuts = np.unique(rng.integers(1, of.m + 1, int(rng.integers(0, 5))))
        for part in np.split(np.arange(of.m), cuts[cuts < of.m]):
            session.add(part_of(rng, of, part))
            fed += part.tolist()
            _judge_standing(found, session, cost, fed, "robust on the way")
        session.settle() if rng.random() < 0.5 else session.refresh()
        _judge_standing(found, session, cost, fed, "robust session")


def judge_suspicion(rng: np.random.Generator, found: Findings) -> None:
    """What a session says of itself without the measurements that it suspects."""
    of = with_outliers(rng, draw(rng, nodes=(4, 8), priors=0.0, noises=(1e-3, 0.05)))
    of = of.subset(growing(rng, of))
    cost = Cost(of, str(rng.choice(["chordal", "g2o", "gtsam"])))
    session, every = Session(cost=cost.name, time_limit=LIMIT), np.arange(of.m)
    with found.refusals("suspicion"):
        session.add(part_of(rng, of, every))
        suspicion = session.suspicion()
        if suspicion is None:
            found.said["no suspicion"] += 1
            return
        rest = of.subset(np.delete(every, suspicion.edges))
        answer = suspicion.without
        x = answer.estimate.subset(_order(session, of))
        judge(found, Cost(rest, cost.name), [Claim.of("without", answer.certificate, x)])


def _order(session: Session, of: Measurements) -> Array:
    """The place of each node among those of a session."""
    places = {name: k for k, name in enumerate(session.nodes)}
    return np.array([places[k] for k in of.ids.tolist()])


def _judge_standing(
    found: Findings, session: RobustSession, of: Cost, fed: list[int], name: str
) -> None:
    kept, rejected = session.edges.tolist(), session.rejected.tolist()
    every = sorted([*kept, *rejected])
    found.require(every == list(range(len(fed))), f"{name}: measurements {every} of {len(fed)}")
    cost = of_known(of, fed)
    inside = replace(cost, of=cost.of.subset(np.array(kept)))
    s = session.standing
    claim = standing(name, s, poses_in(session, cost.of))
    found.require(claim.estimate is not None, f"{name}: other nodes than were given")
    judge(found, inside, [claim])


def with_outliers(rng: np.random.Generator, of: Measurements) -> Measurements:
    """Some measurements replaced by random ones."""
    wrong = np.flatnonzero(rng.random(of.m) < rng.choice([0.0, 0.1, 0.3]))
    turned, steps, q = of.turns.copy(), of.steps.copy(), of.d * (of.d - 1) // 2
    whole = wrong[of.turned[wrong]]
    turned[whole] = turned[whole] @ rotations(rng.uniform(-2.0, 2.0, (len(whole), q)), of.d)
    steps[wrong] += 3.0 * rng.standard_normal((len(wrong), of.d))
    return replace(of, turns=turned, steps=steps)
