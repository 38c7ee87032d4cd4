"""The judge: certify(problem, estimate) sees no solver, only the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

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
from certpgo.solution import Status

#: Steps that descent may take; what has not settled by then is no basin of its own.
MAX_STEPS = 200
#: Stationarity, radians, at which a stalled descent counts as settled.
SETTLED = 1e-6


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
        An estimate of another graph, tolerances that are negative or not finite, or weights beyond
        the range of doubles.
    """
    tier = _tier(tier)
    if not (0.0 <= rtol < math.inf and 0.0 <= atol < math.inf):
        raise InputError(f"tolerances must be finite and not negative: rtol={rtol}, atol={atol}")
    problem.check(estimate)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite costs are judged, not warned of
        unit = _unit(problem)
        case = _Case(problem.scaled(1.0 / unit), tier is not Tier.SCREEN, rtol, atol)
        return _in_units(unit, _judge(case, estimate, tier, refine))


@dataclass(frozen=True)
class _Case:
    """A problem with weights of order one, and how it is judged."""

    problem: Problem
    rigorous: bool
    rtol: float
    atol: float

    def tolerance(self, cost: float) -> float:
        """The gap up to which a point of this cost counts as optimal."""
        return self.rtol * cost + self.atol * self.problem.scale


@dataclass(frozen=True)
class _Basin:
    """Where descent ended, whether it settled there, and what its multipliers prove."""

    point: Estimate
    cost: float
    settled: bool
    bound: DualBound | None

    @property
    def value(self) -> float:
        """A lower bound on F*, which is never negative."""
        return max(self.bound.value, 0.0) if self.bound else 0.0


def _judge(case: _Case, estimate: Estimate, tier: Tier, refine: bool) -> Certificate:
    problem = case.problem
    cost = cost_upper(problem, estimate)
    tolerance = case.tolerance(cost)
    own = _basin(case, estimate, refine)
    best, other = own, None
    if refine and own.cost - own.value > case.tolerance(own.cost):
        other = _other_basin(case)
        if other.value > own.value:
            best = other
    gap = cost - best.value
    finite = math.isfinite(cost) and math.isfinite(tolerance)
    basin_is_global = case.rigorous and own.cost - best.value <= case.tolerance(own.cost)
    better = None
    if other is not None and own.settled and math.isfinite(other.cost):
        elsewhere = other.cost < own.cost - case.tolerance(own.cost)
        better = other if elsewhere and other.cost < cost - tolerance else None
    if finite and case.rigorous and gap <= tolerance:
        verdict = Verdict.CERTIFIED
    elif better is not None:
        verdict = Verdict.REFUTED
    elif finite and (best.value > 0.0 or basin_is_global):
        verdict = Verdict.BOUNDED
    else:
        verdict = Verdict.UNDECIDED
    return Certificate(
        verdict=verdict,
        tier=tier,
        cost=cost,
        lower_bound=best.value,
        gap=gap,
        rtol=case.rtol,
        atol=case.atol,
        scale=problem.scale,
        stationarity=problem.stationarity(estimate),
        max_residual_angle=float(problem.residual_angles(estimate).max()),
        multipliers=best.bound.multipliers if best.bound else None,
        shift=best.bound.shift if best.bound else 0.0,
        refined=own.point,
        refined_cost=own.cost,
        basin_is_global=basin_is_global,
        better=better.point if better else None,
        better_cost=better.cost if better else None,
        bounds=_bounds(problem, own.point),
        engine=factor.default_engine(),
        reason="",
    )


def _basin(case: _Case, start: Estimate, refine: bool) -> _Basin:
    # The best translations for the rotations are a descent step, and where the bound is taken:
    # elsewhere it is valid, but useless.
    problem = case.problem
    settled = True
    try:
        point = problem.complete(start.rotations)
        if refine:
            solution = newton(problem, point, max_iterations=MAX_STEPS)
            point = problem.complete(solution.estimate.rotations)
            settled = solution.status is Status.CONVERGED or (
                solution.status is Status.STALLED and problem.stationarity(point) < SETTLED
            )
        bound = dual_bound(problem, point, rounding=case.rigorous)
    except (NumericalError, np.linalg.LinAlgError):
        return _Basin(start, cost_upper(problem, start), False, None)
    return _Basin(point, cost_upper(problem, point), settled, bound)


def _other_basin(case: _Case) -> _Basin:
    try:
        start = spectral.spectral_start(case.problem)
    except (NumericalError, np.linalg.LinAlgError):
        n, d = case.problem.n, case.problem.d
        start = Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))
    return _basin(case, start, True)


def _bounds(problem: Problem, point: Estimate) -> Bounds | None:
    try:
        return bounds(problem.rotation, point)
    except (NumericalError, np.linalg.LinAlgError):
        return None


def _tier(tier: Tier | str) -> Tier:
    if isinstance(tier, Tier):
        return tier
    known = {t.value: t for t in Tier}
    if tier not in known:
        raise SpecError.unknown("tier", tier, known)
    return known[tier]


def _unit(problem: Problem) -> float:
    """The power of two nearest W: judging in it makes every verdict free of the weights' scale."""
    scale = problem.scale
    if not math.isfinite(scale) or scale <= 0.0:
        raise InputError(f"the weights add up to {scale}, beyond the range of doubles")
    return math.ldexp(1.0, max(-1000, min(1000, round(math.log2(scale)))))


def _in_units(unit: float, judged: Certificate) -> Certificate:
    """The certificate of the problem whose weights are ``unit`` times as large."""
    bounds_ = judged.bounds
    if bounds_ is not None:
        bounds_ = replace(bounds_, spectral=unit * bounds_.spectral, fiedler=unit * bounds_.fiedler)
    scaled = replace(
        judged,
        cost=unit * judged.cost,
        lower_bound=unit * judged.lower_bound,
        gap=unit * judged.gap,
        scale=unit * judged.scale,
        multipliers=None if judged.multipliers is None else unit * judged.multipliers,
        shift=unit * judged.shift,
        refined_cost=unit * judged.refined_cost,
        better_cost=None if judged.better_cost is None else unit * judged.better_cost,
        bounds=bounds_,
    )
    return replace(scaled, reason=_reason(scaled))


def _reason(c: Certificate) -> str:
    floor = f"no estimate of this graph has a cost below {c.lower_bound:.10g}"
    if c.tier is Tier.SCREEN:
        floor = f"not proven at this tier, but likely: {floor}"
    if not math.isfinite(c.cost):
        return "the cost of this estimate is beyond the range of doubles"
    if c.verdict is Verdict.CERTIFIED:
        return f"{floor}; yours, {c.cost:.10g}, is within {c.gap:.2g} of the best possible"
    if c.better_cost is not None:
        return (
            f"another estimate costs {c.better_cost:.10g}, yours {c.cost:.10g}, and descending "
            f"from yours only reaches {c.refined_cost:.10g}"
        )
    if c.verdict is Verdict.UNDECIDED:
        return "no useful lower bound was found: the convex relaxation proves nothing here"
    if c.basin_is_global:
        return (
            f"{floor}; descending from yours ({c.cost:.10g}) reaches {c.refined_cost:.10g}, "
            "which is the best possible: the right basin, not its lowest point"
        )
    return f"{floor}; yours, {c.cost:.10g}, may be up to {c.gap:.3g} above the best"
