"""The judge: certify(problem, estimate) sees no solver, only the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from certpgo import spectral
from certpgo.certify.bounds import Bounds, bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.certify.rounding import cost_upper
from certpgo.errors import InputError, NumericalError, SpecError
from certpgo.estimate import Estimate
from certpgo.linalg import factor
from certpgo.newton import newton
from certpgo.problem import Problem


@dataclass(frozen=True)
class _Basin:
    """Where descent ended, and what its multipliers prove."""

    point: Estimate
    cost: float
    bound: DualBound | None

    @property
    def value(self) -> float:
        return self.bound.value if self.bound else -math.inf


def certify(
    problem: Problem,
    estimate: Estimate,
    *,
    tier: Tier | str = Tier.STANDARD,
    rtol: float = 1e-5,
    atol: float = 1e-12,
    refine: bool = True,
) -> Certificate:
    """Judge an estimate against the best possible one.

    The lower bound belongs to the problem, not to the estimate: a copy is refined to a stationary
    point, the bound is taken from there (and, failing that, from a spectral start), and the
    estimate as given is judged against it.

    Parameters
    ----------
    tier : ``"standard"``, or ``"screen"``, which never yields CERTIFIED
    rtol, atol : CERTIFIED means gap <= rtol F + atol W
    refine : False takes the bound from the estimate's own multipliers, and tries nothing else

    Raises
    ------
    InputError
        An estimate of another graph, or tolerances that are negative or not finite.
    """
    tier = _tier(tier)
    if not (0.0 <= rtol < math.inf and 0.0 <= atol < math.inf):
        raise InputError(f"tolerances must be finite and not negative: rtol={rtol}, atol={atol}")
    problem.check(estimate)
    cost = cost_upper(problem, estimate)
    tolerance = rtol * cost + atol * problem.scale
    rigorous = tier is not Tier.SCREEN

    own = _basin(problem, estimate, refine, rigorous)
    best, other = own, None
    basin_is_global = own.cost - own.value <= tolerance
    if refine and not basin_is_global:
        other = _other_basin(problem, rigorous)
        if other is not None and other.value > own.value:
            best = other
    better = other if other is not None and other.cost < own.cost - tolerance else None
    gap = cost - best.value
    if gap <= tolerance and rigorous:
        verdict = Verdict.CERTIFIED
    elif better is not None:
        verdict = Verdict.REFUTED
    else:
        verdict = Verdict.BOUNDED if best.value > 0.0 else Verdict.UNDECIDED
    return Certificate(
        verdict=verdict,
        tier=tier,
        cost=cost,
        lower_bound=best.value,
        gap=gap,
        rtol=rtol,
        atol=atol,
        scale=problem.scale,
        stationarity=problem.stationarity(estimate),
        max_residual_angle=float(problem.residual_angles(estimate).max()),
        multipliers=best.bound.multipliers if best.bound else None,
        shift=best.bound.shift if best.bound else 0.0,
        refined=own.point,
        refined_cost=own.cost,
        basin_is_global=basin_is_global and rigorous,
        better=better.point if better else None,
        better_cost=better.cost if better else None,
        bounds=_bounds(problem, own.point),
        engine=factor.default_engine(),
        reason=_reason(verdict, cost, best, own, better, basin_is_global),
    )


def _tier(tier: Tier | str) -> Tier:
    if isinstance(tier, Tier):
        return tier
    known = {t.value: t for t in Tier}
    if tier not in known:
        raise SpecError.unknown("tier", tier, known)
    return known[tier]


def _basin(problem: Problem, start: Estimate, refine: bool, rigorous: bool) -> _Basin:
    point = newton(problem, start).estimate if refine else start
    # The bound is taken at the best translations; elsewhere it is valid, but useless.
    point = problem.complete(point.rotations)
    return _Basin(point, cost_upper(problem, point), dual_bound(problem, point, rounding=rigorous))


def _other_basin(problem: Problem, rigorous: bool) -> _Basin | None:
    try:
        pairs = spectral.smallest_eigenpairs(problem.rotation)
    except NumericalError:
        return None
    start = problem.complete(spectral.round_to_rotations(pairs.vectors, problem.d))
    return _basin(problem, start, True, rigorous)


def _bounds(problem: Problem, point: Estimate) -> Bounds | None:
    try:
        return bounds(problem.rotation, point)
    except NumericalError:
        return None


def _reason(
    verdict: Verdict,
    cost: float,
    best: _Basin,
    own: _Basin,
    better: _Basin | None,
    basin_is_global: bool,
) -> str:
    floor = f"no estimate of this graph has a cost below {best.value:.10g}"
    if verdict is Verdict.CERTIFIED:
        return (
            f"{floor}; yours, {cost:.10g}, is within {cost - best.value:.2g} of the best possible"
        )
    if better is not None:
        return (
            f"another estimate costs {better.cost:.10g}, yours {cost:.10g}, and descending from "
            f"yours only reaches {own.cost:.10g}"
        )
    if verdict is Verdict.UNDECIDED:
        return "no useful lower bound was found: the convex relaxation proves nothing here"
    if basin_is_global:
        return (
            f"{floor}; descending from yours ({cost:.10g}) reaches {own.cost:.10g}, "
            "which is the best possible: the right basin, not its lowest point"
        )
    return f"{floor}; yours, {cost:.10g}, may be up to {cost - best.value:.3g} above the best"
