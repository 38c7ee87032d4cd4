"""The verdict on an estimate, given where descent from it ends, and perhaps a better minimum.

What keeps a gap open is an `Obstacle`. After a search, that of the search takes the place of what
is found here (``Plan.obstacle``), as it knows more; `certpgo.certify.wording` says either.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import Climbed, LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.regions import Regions
from certpgo.certify.tolerances import NEGLIGIBLE, gap_of
from certpgo.certify.units import in_units
from certpgo.graph import Estimate
from certpgo.optimize.solution import Status


def verdict(
    normalized: NormalizedProblem[Any],
    estimate: Estimate,
    own: LocalMinimum,
    other: LocalMinimum | None = None,
    bounds: Bounds | None = None,
) -> Certificate:
    """The certificate of an estimate, in the units of the graph.

    Parameters
    ----------
    own : where descent from the estimate ends
    other : another minimum
    """
    problem = normalized.problem
    cost = own.cost if own.is_at(estimate) else normalized.cost_upper(estimate)
    tolerance = normalized.tolerance(cost)
    best = other if other is not None and other.value > own.value else own
    gap = gap_of(cost, best.value, rigorous=normalized.rigorous)
    finite = math.isfinite(cost) and math.isfinite(tolerance)

    def rounding(point: Estimate, cost: float) -> float:
        """The cost, if that is rounding and no bound comes near it."""
        open_gap = cost - best.value > normalized.tolerance(cost)
        return cost if open_gap and normalized.fits(point) else 0.0

    def optimal(point: Estimate, cost: float) -> bool:
        closed = cost - best.value <= normalized.tolerance(cost)
        return normalized.rigorous and (closed or rounding(point, cost) > 0.0)

    exact, own_exact = rounding(estimate, cost), rounding(own.point, own.cost)
    basin_is_global = optimal(own.point, own.cost)
    better, elsewhere, zero = None, False, max(exact, own_exact)
    # Costs of exact fits are rounding: none is better than another.
    lower = other is not None and other.cost < min(own.cost, normalized.sure(estimate, cost))
    if other is not None and lower and not zero:
        better, zero = other, rounding(other.point, other.cost)
        # A descent that was given up while the optimum was known does not reach it.
        proven = optimal(other.point, other.cost)
        ended = own.settled or (proven and own.descended and normalized.stop.cut is None)
        elsewhere = ended and other.cost < normalized.sure(own.point, own.cost)
    if elsewhere:
        found = Verdict.REFUTED
    elif finite and normalized.rigorous and (gap <= tolerance or exact > 0.0):
        found = Verdict.CERTIFIED
    elif finite and (best.value > 0.0 or basin_is_global):
        found = Verdict.BOUNDED
    else:
        found = Verdict.UNDECIDED
    closed = basin_is_global or found in (Verdict.CERTIFIED, Verdict.REFUTED)
    limit = _limit(normalized, closed, best.bound, min(own.cost, cost))
    bound, rejected = best.bound, problem.rejected
    judged = Certificate(
        verdict=found,
        tier=normalized.tier,
        cost_computed=problem.cost(estimate),
        cost_upper=cost,
        lower_bound=best.value,
        gap=gap,
        rtol=normalized.rtol,
        atol=normalized.atol,
        scale=problem.scale,
        rounding=zero,
        stationarity=problem.stationarity(estimate),
        max_residual_angle=float(problem.kept.residual_angles(estimate).max()),
        multipliers=bound.multipliers if bound else None,
        shift=bound.shift if bound else 0.0,
        refined=own.point,
        refined_cost=own.cost,
        basin_is_global=basin_is_global,
        better=better.point if better else None,
        better_cost=better.cost if better else None,
        bounds=bounds,
        engine=problem.engine,
        objective=problem.title,
        descended=own.descended,
        settled=own.settled,
        support=bound.support if bound and not len(rejected) else None,
        obstacle=Obstacle(limit, stopped=normalized.stop.cut),
        rejected=len(rejected),
        regions=_regions(normalized, best.bound, estimate, cost, own, other) if finite else None,
    )
    if other is not None and other.climbed is not None:
        obstacle = of_relaxation(judged, other.climbed, normalized.stop.cut)
        judged = replace(judged, obstacle=obstacle)
    elif found in (Verdict.BOUNDED, Verdict.UNDECIDED):
        judged = replace(judged, obstacle=_of_measurements(normalized, judged, best))
    return in_units(normalized.unit, _capped(judged, problem.cap))


def _regions(
    normalized: NormalizedProblem[Any],
    bound: DualBound | None,
    estimate: Estimate,
    cost: float,
    own: LocalMinimum,
    other: LocalMinimum | None,
) -> Regions | None:
    """What a bound says of where estimates are, if there is a unit to say it in."""
    if bound is None or not normalized.rigorous or bound.form.kinds.in_mean_unit:
        return None
    problem, is_proof = normalized.problem, normalized.tier is Tier.PROOF
    known = [(one.point, one.cost) for one in (own, other) if one is not None]
    if is_proof:
        # Its costs are of the checker's numbers, the bound's matrix of those that are stored.
        cost = max(cost, problem.enclosure(estimate)[1])
        known = [(point, max(of, problem.enclosure(point)[1])) for point, of in known]
    best, least = min([(estimate, cost), *known], key=lambda one: one[1])
    chordal = problem.chordal
    anchor = chordal.root if problem.takes_scales else chordal.anchor
    centres = estimate, cost, best, least
    return Regions(bound, *centres, own.point, anchor, normalized.unit, is_proof)


def loses_to_rounding(
    normalized: NormalizedProblem[Any], bound: DualBound | None, cost: float
) -> bool:
    """Whether rounding alone keeps a bound from a cost: its point is no lower than that."""
    if bound is None or bound.loose:
        return False
    return cost - bound.attained <= normalized.tolerance(cost)


def of_relaxation(judged: Certificate, climbed: Climbed, cut: Status | None) -> Obstacle:
    """What keeps a gap open with distances: what their relaxation is worth, or the time."""
    if judged.verdict is not Verdict.BOUNDED or judged.basin_is_global:
        return judged.obstacle
    kind = LimitedBy.LOOSE if climbed.solved or cut is None else LimitedBy.STOPPED
    return Obstacle(kind, climbed.solved, climbed.rank, cut, of_distances=True)


def _limit(
    normalized: NormalizedProblem[Any], closed: bool, bound: DualBound | None, cost: float
) -> LimitedBy:
    """What keeps the gap open, unless it is closed, as far as the bound of one point tells."""
    if closed:
        return LimitedBy.TIGHT
    if normalized.stop.cut is not None:
        return LimitedBy.STOPPED
    at_bound = loses_to_rounding(normalized, bound, cost)
    return LimitedBy.ROUNDING if at_bound else LimitedBy.LOOSE


def _of_measurements(
    normalized: NormalizedProblem[Any], judged: Certificate, best: LocalMinimum
) -> Obstacle:
    """What keeps a gap open: single measurements, where these do."""
    problem = normalized.problem
    if best.bound is not None and len(ambiguous := best.bound.ambiguous):
        kind = LimitedBy.AMBIGUOUS
        return replace(judged.obstacle, kind=kind, ambiguous=tuple(ambiguous.tolist()))
    if normalized.stop.cut is not None:
        return judged.obstacle
    with suppress(np.linalg.LinAlgError):
        if len(missing := normalized.eased.without_minorants(judged.refined)):
            i, j = problem.graph.edges[missing[0]].tolist()
            return Obstacle(LimitedBy.NO_MINORANT, missing=len(missing), edge=(i, j))
    return judged.obstacle


def _capped(judged: Certificate, cap: float) -> Certificate:
    """With the tolerances that are meant where prices cap them."""
    if not judged.tolerance > cap or judged.rounding:
        return judged
    share, absolute = cap / judged.tolerance, NEGLIGIBLE * judged.cost_upper / judged.scale
    atol = min(judged.atol, absolute)
    return replace(judged, rtol=share * judged.rtol, atol=share * atol)
