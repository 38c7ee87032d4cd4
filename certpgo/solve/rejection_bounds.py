"""Bounds on a truncated cost, by as many prices of rejected measurements as can be proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo.certify.certificate import Tier
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.resistances import packed
from certpgo.certify.truncated_bound import Truncated, bound_with, resistances
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.descent import descend, rested


def bound_of_prices(
    normalized: Truncated, point: Estimate, cost: float, *, sharp: bool = True, tight: bool = False
) -> DualBound | None:
    """The bound with all prices, or else with none, which is that of the kept measurements."""
    point = beside_stiff(normalized, point)
    W = normalized.problem.truncation(point).plain()
    whole = _bound(normalized, point, cost, W, sharp=sharp, tight=True)
    if whole is not None or tight:
        return whole
    alone = optimum_of_kept(normalized, point)
    return _bound(normalized, alone, cost, np.zeros_like(W), sharp=sharp, tight=False)


def with_most_prices(normalized: Truncated, minimum: LocalMinimum) -> LocalMinimum:
    """The minimum with a bound by as many prices as can be proven at once.

    At the optimum of the kept measurements, of the rejected ones that cost more than their price
    there.
    """
    if minimum.bound is None or not len(minimum.bound.ambiguous):
        return minimum
    point = optimum_of_kept(normalized, minimum.point)
    at, found = normalized.problem.truncation(point), resistances(normalized.problem, point)
    if found is None:
        return minimum
    W, loads = packed(found, at, isotropic=normalized.tier is Tier.PROOF)
    better = None
    while better is None and W.any() and not normalized.stop.should_stop():
        better = _bound(normalized, point, minimum.cost, W, sharp=True, tight=True)
        used = W.any(axis=(1, 2))
        W[loads >= np.median(loads[used])] = 0.0  # rounding: the largest ones are left out
    return minimum if better is None else replace(minimum, bound=better)


def optimum_of_kept(normalized: Truncated, near: Estimate) -> Estimate:
    """The local optimum of the kept measurements near an estimate."""
    problem, kept = normalized.problem, normalized.problem.kept
    if (problem.counted(near) == ~problem.is_rejected).all():
        return near
    stop = normalized.stop
    end = descend(kept, near, monitor=stop, watch=stop.watch).estimate
    return beside_stiff(normalized, kept.settled(end))


def beside_stiff(normalized: Truncated, point: Estimate) -> Estimate:
    """The point with translations to all digits beside stiff bridges."""
    if normalized.eased is normalized.problem or normalized.tier is Tier.PROOF:
        return point
    return normalized.eased.settled(point)


def at_rest(problem: TruncatedCost, point: Estimate, W: FloatArray) -> Estimate:
    """Where minorants of weights W (k, b, b) balance, near a point, to more digits.

    Those of far measurements have no gradient. Not by descent on the surrogate: with negative
    weights it need not have a minimum.
    """
    counted = ~problem.is_rejected
    counted[problem.rejected] = W.any(axis=(1, 2)) & ~problem.truncation(point).is_far
    return rested(problem.counting(counted), point)


def _bound(
    normalized: Truncated,
    point: Estimate,
    cost: float,
    W: FloatArray,
    *,
    sharp: bool,
    tight: bool,
) -> DualBound | None:
    """The bound with minorants of weights W, at the tier."""
    problem = normalized.problem
    found = bound_with(normalized, point, cost, W, sharp=sharp, tight=tight)
    if found is None or found.support is None or normalized.tier is not Tier.PROOF:
        return found
    from certpgo.certify.proof import proven_surrogate

    minorants = found.support.minorants
    below = problem.surrogate_of(minorants).problem
    return proven_surrogate(below, minorants.constant, at_rest(problem, point, W), found)
