"""The best bounds near an estimate: from points where they are sharp, and from their relaxations.

`certpgo.certify.bound` bounds a cost from one point. Here are the points: those to more digits, of
parts between bridges, of measurements that are no stiffer than bounds need, and of higher rank.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from certpgo.certify.bound import bound_by
from certpgo.certify.bridge_blocks import Part, outside, sum_of_bounds
from certpgo.certify.certificate import Tier
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.stiff_edges import eased
from certpgo.errors import GraphError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.complex_relaxation import is_over_complex_numbers, over_complex_numbers
from certpgo.objective.minorants import Minorants
from certpgo.objective.objective import Surrogate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.descent import CLOSE, descend, polished, rested
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.staircase import Stair, climb
from certpgo.solve.rejection_bounds import bound_of_prices, with_most_prices
from certpgo.solve.relaxation import SOLVED, range_bound

#: Share of a graph's weight or length in bridges above which bounds by parts pay off.
MUCH = 0.1
#: Newton settings from the whole graph's point, which is nearly stationary in each part.
FEW_STEPS = NewtonSettings(max_iterations=20)
#: How often stiff measurements are left out of what is left.
SOFTENED = 3
#: Surrogates that are tried.
EXPANSIONS = 12
#: Share of the gap that another surrogate must be able to close.
WORTH = 0.1


def bound_near(
    normalized: NormalizedProblem[Any],
    point: Point,
    cost: float,
    *,
    sharp: bool = True,
    tight: bool = False,
    refine: bool = True,
) -> DualBound | None:
    """The bound by the multipliers of a converged point, at the tier.

    If it misses rtol F, also that without stiff measurements, and, if bridges are a large share of
    the graph, that by the parts between them.

    Parameters
    ----------
    point : an estimate; of any rank where the cost has a value there
    cost : that of the best estimate; it decides when the bound suffices
    sharp, tight : see `certpgo.certify.dual.dual_bound`
    refine : whether to improve the parts' points
    """
    problem = normalized.problem
    if len(problem.rejected):
        if not isinstance(point, Estimate):
            return None
        return bound_of_prices(normalized, point, cost, sharp=sharp, tight=tight)
    if problem.is_lifted:
        found = range_bound(normalized.eased.lifted_form, point, cost)
        if found is not None and normalized.tier is Tier.PROOF:
            found = _proven(normalized, found, None, point)
    else:
        found = _bound_at(normalized, point, cost, sharp=sharp, tight=tight)
    how = {"sharp": sharp, "tight": tight, "refine": refine}
    found = _softened(normalized, found, point, cost, **how)
    return _by_parts(normalized, found, point, cost, **how)


def raised(normalized: NormalizedProblem[Any], minimum: LocalMinimum) -> LocalMinimum:
    """The minimum with a better bound, if one takes more work than `bound_near` does."""
    problem, stop = normalized.problem, normalized.stop
    if len(problem.rejected):
        return with_most_prices(normalized, minimum)
    if problem.is_lifted:
        return minimum
    # The search climbs F over real numbers itself.
    climbed = problem.is_chordal and not problem.takes_scales
    if climbed and _tightest(normalized, problem) is problem:
        return minimum
    if problem.takes_scales and (normalized.tier is Tier.PROOF or normalized.is_sharp(minimum)):
        return minimum
    best: DualBound | None = None
    enough = minimum.cost - normalized.tolerance(minimum.cost)
    for found in reached(normalized, minimum.point, minimum.cost):
        if found.bound is not None and (best is None or found.bound.value > best.value):
            best = found.bound
        if stop.should_stop() or (best is not None and best.value >= enough):
            break
    if (best is None or best.value <= 0.0) and not stop.should_stop():
        best = lowered_bound(normalized, minimum.point) or best
    if best is not None and normalized.tier is Tier.PROOF:
        best = reproven(normalized, best)
    return minimum if best is None or best.value <= minimum.value else replace(minimum, bound=best)


def proven(normalized: NormalizedProblem[Any], minimum: LocalMinimum) -> DualBound | None:
    """The bound of a minimum at the proof tier, from that of the standard tier."""
    problem, found = normalized.problem, minimum.bound
    # Of bounds over complex numbers there are no proofs.
    again = found is not None and is_over_complex_numbers(found.form)
    if problem.is_chordal or len(problem.rejected) or again or problem.is_lifted:
        return bound_near(normalized, minimum.point, minimum.cost)
    return None if found is None else reproven(normalized, found)


def reproven(normalized: NormalizedProblem[Any], found: DualBound) -> DualBound | None:
    """A surrogate's bound of the standard tier at the proof tier; None if that fails."""
    if found.support is None:
        return None
    return _proven(normalized, found, found.support.minorants, found.support.point)


def _proven(
    normalized: NormalizedProblem[Any], found: DualBound, minorants: Minorants | None, point: Point
) -> DualBound | None:
    """The bound by the tangents of all measurements at a point, of which some may be known."""
    from certpgo.certify.proof import proven_surrogate
    from certpgo.objective.tangents import quadratic_of, tangents_at

    minorants = tangents_at(normalized.problem, point, minorants)
    below = quadratic_of(normalized.problem, minorants)
    if isinstance(point, Estimate):
        point = rested(below, point)
    return proven_surrogate(below, minorants.constant[minorants.exist], point, found)


@dataclass(frozen=True)
class Reached:
    """A point of a surrogate's relaxation and its bound on the cost.

    Attributes
    ----------
    number : of the surrogate
    stair : what was climbed for it; None of an estimate
    """

    point: Point
    bound: DualBound | None
    number: int
    stair: Stair | None = None

    @property
    def solves(self) -> bool:
        """Whether the relaxation has no lower points, up to rounding."""
        bound = self.bound
        if bound is None:
            return False
        return bound.attained - bound.value <= SOLVED * abs(bound.attained)


def reached(normalized: NormalizedProblem[Any], start: Estimate, cost: float) -> Iterator[Reached]:
    """Points of surrogates' relaxations, and the bounds on the cost there.

    The first is the start, in the surrogate expanded there. Minima of rising rank follow, and then
    those of surrogates expanded in between: the largest bound by a surrogate is the minimum of a
    convex function of the poses' Gram matrix, which surrogates are tangent to. Frank and Wolfe's
    method (1956) finds it: between the last expansion and the last minimum lies the next expansion,
    where that function is lowest. Where the surrogate is the cost itself, there is no next one.

    Parameters
    ----------
    start : stationary for the cost
    cost : the cost there; it decides when a bound suffices
    """
    problem, number, point = normalized.eased, 0, cast("Point", start)
    ranks = problem.most_ranks if normalized.ranks is None else normalized.ranks
    below = _tight(normalized, start)
    if below is not None and below.minorants is None:
        yield from _minima(normalized, below, point, cost, 0, ranks)
        return
    v, Q = problem.relative(start)
    expanded = problem.cost(start)
    while below is not None and below.minorants is not None and number < EXPANSIONS:
        for found in _minima(normalized, below, point, cost, number, ranks):
            point = found.point
            yield found
        if normalized.stop.should_stop():
            return
        there = problem.relative(point)
        fall = expanded - (below.problem.cost(point) + below.constant)
        bend = problem.bend(there[0] - v, below.minorants.tau)
        gap = cost - expanded + fall
        if not (gap > normalized.tolerance(cost) and min(fall, bend) > WORTH * gap):
            return
        step = min(0.5 * fall / bend, 1.0)
        expanded -= step * (fall - step * bend)
        v, Q = v + step * (there[0] - v), Q + step * (there[1] - Q)
        below, number = _tight(normalized, v, Q), number + 1


def _minima(
    normalized: NormalizedProblem[Any],
    below: Surrogate,
    start: Point,
    cost: float,
    number: int,
    ranks: int,
) -> Iterator[Reached]:
    """A point, and minima of rising rank of a surrogate's relaxation, with their bounds."""
    problem, stop = below.problem, normalized.stop
    if start.rotations.shape[1] == problem.d:
        start = _settled(below, start)
        yield Reached(start, _of_point(normalized, below, start, cost), number)
    if not problem.climbs:
        return
    own = below.minorants is None
    monitor = stop if own else stop.of_minorant(below.constant)
    with suppress(NumericalError, np.linalg.LinAlgError):
        for end in climb(problem, start, problem.d + ranks, stop, monitor):
            if stop.should_stop():
                return
            bound = _of_point(normalized, below, end.point, cost)
            found = Reached(end.point, bound, number, end)
            yield found
            if found.solves:
                return


def lowered_bound(normalized: NormalizedProblem[Any], point: Estimate) -> DualBound | None:
    """The best bound on a cost that is nowhere above this one, at the end of descent on it.

    None if there is no such cost, or no bound.
    """
    problem = normalized.problem.relaxed()
    if problem is None:
        return None
    lower = replace(normalized, problem=problem)
    end = descend(problem, point, monitor=normalized.stop.of_minorant(0.0)).estimate
    bounds = [found.bound for found in reached(lower, end, lower.cost_upper(end)) if found.bound]
    best = max(bounds, key=lambda bound: bound.value, default=None)
    if best is None or best.support is None:
        return best
    return replace(best, support=replace(best.support, lowered=True))


def _expanded(problem: Any, at: Any, Q: FloatArray | None = None) -> Surrogate | None:
    """The surrogate at a point, or at v and Q; None if too few measurements have minorants."""
    try:
        return problem.surrogate(at) if Q is None else problem.expanded(at, Q)  # type: ignore[no-any-return]
    except (NumericalError, GraphError):  # GraphError: weights beyond their range
        return None


def _tight(normalized: NormalizedProblem[Any], *at: Any) -> Surrogate | None:
    """The surrogate at a point, or at v and Q, with its tightest relaxation; None without one."""
    below = _expanded(normalized.eased, *at)
    return below and replace(below, problem=_tightest(normalized, below.problem))


def _tightest(normalized: NormalizedProblem[Any], problem: Any) -> Any:
    """The problem with the tightest relaxation that is known: in the plane over complex numbers.

    Proofs are over real numbers, and costs of distances have chosen theirs.
    """
    if normalized.real or not problem.eliminates:
        return problem
    return over_complex_numbers(problem) or problem


def _settled(below: Surrogate, point: Point) -> Point:
    """The point with the best translations for a surrogate."""
    problem = below.problem
    return problem.with_optimal_translations(point) if problem.eliminates else point


def _of_point(
    normalized: NormalizedProblem[Any],
    below: Surrogate,
    point: Point,
    cost: float,
    *,
    sharp: bool = True,
    tight: bool = False,
) -> DualBound | None:
    """The bound of a point of a surrogate's relaxation at the standard tier, or screened."""
    return bound_by(
        below,
        point,
        rounding=normalized.rigorous,
        enough=cost - normalized.difference(cost),
        real=normalized.real,
        sharp=sharp,
        tight=tight,
    )


def _bound_at(
    normalized: NormalizedProblem[Any], point: Point, cost: float, *, sharp: bool, tight: bool
) -> DualBound | None:
    """The bound by the surrogate at the point, without stiff bridges, at the tier."""
    problem, easier = normalized.problem, normalized.eased
    if not (problem.is_chordal or isinstance(point, Estimate)):
        return None
    below = _expanded(easier, point)
    if below is None:
        return None
    if below.minorants is None:
        point = point if easier is problem else _settled(below, point)
        return _of_form(normalized, easier, point, cost, sharp=sharp, tight=tight)
    at = _settled(below, point)
    found = _of_point(normalized, below, at, cost, sharp=sharp, tight=tight)
    if found is None or normalized.tier is not Tier.PROOF:
        return found
    return reproven(normalized, found)


def _of_form(
    normalized: NormalizedProblem[Any],
    form: Quadratic,
    point: Point,
    cost: float,
    *,
    sharp: bool,
    tight: bool,
) -> DualBound | None:
    """The bound of a point on a quadratic objective, at the tier."""
    proof = normalized.tier is Tier.PROOF
    if proof and not isinstance(point, Estimate):  # a proof contains rotations, of rank d
        return None
    surrogate = form.surrogate(point)
    found = _of_point(normalized, surrogate, point, cost, sharp=sharp, tight=tight)
    if found is None or not proof:
        return found
    from certpgo.certify.proof import exact_graph, proven_bound, proven_surrogate

    if form.graph.has_couplings:
        constants = form.minorants(point).constant
        return proven_surrogate(form, constants, rested(form, cast("Estimate", point)), found)
    exact = normalized.exact if form is normalized.problem else exact_graph(form)
    return proven_bound(form, exact, rested(form, cast("Estimate", point)), found)


def _softened(
    normalized: NormalizedProblem[Any],
    found: DualBound | None,
    point: Point,
    cost: float,
    **how: bool,
) -> DualBound | None:
    """A bound, or a better one without stiff measurements, if it misses rtol F."""
    enough = cost - normalized.rtol * cost
    if not isinstance(point, Estimate) or (found and found.value >= enough):
        return found
    soft = eased(normalized.eased)
    if soft is normalized.eased or normalized.softened == SOFTENED:
        return found
    softer = replace(normalized, problem=soft, softened=normalized.softened + 1)
    near = soft.settled(polished(soft, point, CLOSE))
    bound = bound_near(softer, near, cost, **how)
    other = raised(softer, LocalMinimum(near, softer.cost_upper(near), True, bound)).bound
    return other if other and (found is None or other.value > found.value) else found


def _by_parts(
    normalized: NormalizedProblem[Any],
    found: DualBound | None,
    point: Point,
    cost: float,
    *,
    sharp: bool,
    tight: bool,
    refine: bool,
) -> DualBound | None:
    """A bound, or a better one by the parts between bridges, if it misses rtol F."""
    value = found.value if found else 0.0
    if value >= cost - normalized.rtol * cost or not (parts := normalized.parts):
        return found
    if value > 0.0 and outside(normalized.problem, parts) < MUCH:
        return found

    def bound_of(part: Part) -> DualBound | None:
        problem, here = part.problem, part.point(point)
        if refine and isinstance(here, Estimate):
            near = polished(problem, here, FEW_STEPS, near=True)
            here = problem.with_optimal_translations(near)
        return _of_form(normalized, problem, here, problem.cost(here), sharp=sharp, tight=tight)

    summed = sum_of_bounds(normalized.problem, parts, bound_of)
    return summed if summed is not None and summed.value > value else found
