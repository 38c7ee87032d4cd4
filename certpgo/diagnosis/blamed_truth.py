"""Truth that is to blame: it contradicts measurements that agree with one another."""

from __future__ import annotations

import numpy as np

from certpgo.diagnosis.examined import Examined, KnownTruth
from certpgo.diagnosis.finding import Finding
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown, counted
from certpgo.solve.fit import Fit

#: Measurements between true poses that are enough, and those that are named.
FEWEST, NAMED = 4, 4
#: Share of what these cost in the truth that they cost in the best estimate at most.
SHARE = 0.25
#: Strength: causes come first.
BLAMED = 0.5


def contradicting(examined: Examined, truth: KnownTruth) -> Finding | None:
    """That a truth is to blame, where chi^2 of the best estimate is as the noise says."""
    fit, problem, answer = examined.fit, examined.problem, examined.answer
    if fit is None or fit.is_unusually_large or truth.poses.keys.are_positions:
        return None
    if examined.instance.graph.has_positions and truth.poses.translations is None:
        return None
    examined.trying("truth contradicts")
    place = np.full(examined.instance.graph.num_nodes, -1)
    place[truth.nodes] = np.arange(len(truth.nodes))
    edges = problem.graph.edges
    known = (place[edges] >= 0).all(axis=1)
    if known.sum() < FEWEST:
        return None
    R, t, at = truth.poses.rotations, truth.poses.translations, np.maximum(place, 0)
    # Where nothing is known, any pose: its measurements are not counted.
    filled = Estimate.trusted(R[at], None if t is None else t[at])
    costs, best = problem.edge_costs(filled)[known], problem.edge_costs(answer.estimate)[known]
    turned, moved = (numbers[known] for numbers in problem.numbers)
    found = Fit(float((costs / problem.double[known]).sum()), int((turned + moved).sum()))
    given, least = float(costs.sum()), float(best.sum())
    if not (found.is_unusually_large and least < SHARE * given):
        return None
    rows = np.flatnonzero(known)[np.argsort(-costs, kind="stable")[:NAMED]]
    named = ", ".join(f"{i}-{j}" for i, j in examined.instance.pairs[rows].tolist())
    return Finding(
        "truth-contradicts",
        f"the truth contradicts the measurements, which agree with one another: in it "
        f"{counted(len(best), 'measurement{s}')} between its poses cost {cost_shown(given)}, in "
        f"the best estimate {cost_shown(least)}; most do {named}",
        "check that the truth is of this run, its ids or times, and its poses there",
        least,
        given,
        strength=BLAMED,
    )
