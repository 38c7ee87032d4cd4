"""A normalized problem, its basins, and the verdict on an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from certpgo import checker
from certpgo.certify.bounds import Bounds
from certpgo.certify.bridge_blocks import Part, outside, parts, sum_of_bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict, tier_called
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.proof import CLOSE, exact_cost, exact_graph, proven_bound
from certpgo.certify.stiff_edges import eased
from certpgo.certify.tolerances import (
    AT_REST,
    FLOOR,
    SETTLED,
    allowed,
    difference_up,
    refuse_tolerances,
    refuse_unprovable,
)
from certpgo.certify.units import in_units, unit_of
from certpgo.errors import GraphError, InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.objective.exact_fit import fits_exactly
from certpgo.objective.problem import Problem
from certpgo.optimize import spectral
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import Stop
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution, Status

#: Share of a graph's weight or length in bridges above which bounds by parts pay off.
MUCH = 0.1
#: Descent to a basin; a point that has not converged by then is not a basin of its own.
DESCENT = NewtonSettings(max_iterations=200)


@dataclass(frozen=True)
class Case:
    """A problem with weights of order one, and the settings of its certificates.

    Attributes
    ----------
    problem : the problem with its weights divided by ``unit``
    unit : the power of two nearest W; it makes verdicts independent of the weights' scale
    stop : the monitor of all descents; where it requests a stop, bounds are left out
    """

    problem: Problem
    unit: float
    tier: Tier
    rtol: float
    atol: float
    stop: Stop = field(default_factory=Stop)

    @classmethod
    def of(
        cls, problem: Any, tier: Tier | str, rtol: float, atol: float, monitor: Monitor = silent
    ) -> Self:
        """Normalize a problem.

        Raises
        ------
        InputError
            Tolerances that are negative or not finite, weights beyond the range of doubles, or the
            proof tier for edges with couplings or arms.
        SpecError
            An unknown tier.
        """
        tier = tier_called(tier)
        refuse_tolerances(rtol, atol)
        if tier is Tier.PROOF:
            refuse_unprovable(problem)
        unit = unit_of(problem)
        try:
            scaled = problem.scaled(1.0 / unit)
        except GraphError as error:
            raise InputError(f"too uneven weights: divided by {unit:.2g}, {error}") from None
        return cls(scaled, unit, tier, rtol, atol, Stop(monitor, unit, problem.title))

    @property
    def rigorous(self) -> bool:
        """Whether rounding is bounded."""
        return self.tier is not Tier.SCREEN

    def tolerance(self, cost: float) -> float:
        """The gap up to which a point of this cost counts as optimal."""
        return allowed(cost, self.rtol, self.atol * self.problem.scale)

    def difference(self, cost: float) -> float:
        """The smallest decrease in cost that is not rounding."""
        return allowed(cost, self.rtol, FLOOR * self.atol * self.problem.scale)

    def fits(self, estimate: Estimate) -> bool:
        """Whether it meets all measurements: then its cost is rounding, and it is optimal."""
        return fits_exactly(self.problem, estimate)

    def is_closed(self, basin: LocalMinimum) -> bool:
        """Whether the gap is closed."""
        return basin.cost - basin.value <= self.tolerance(basin.cost) or self.fits(basin.point)

    def is_sharp(self, basin: LocalMinimum) -> bool:
        """Whether no distinguishably better point exists."""
        return basin.cost - basin.value <= self.difference(basin.cost) or self.fits(basin.point)

    def basin(
        self,
        start: Estimate,
        refine: bool,
        known: LocalMinimum | None = None,
        monitor: Monitor | None = None,
        *,
        may_rest: bool = False,
    ) -> LocalMinimum:
        """The end of descent from an estimate, or the estimate with its best translations.

        The bound of a ``known`` basin is reused if it is good enough. Where a ``monitor`` of the
        descent stops it, no bound is computed. One that ``may_rest`` does not descend from a
        stationary point that its own multipliers prove optimal.
        """
        settled = True
        try:
            point = self.completed(start)
            if may_rest and (found := self._at_rest(point)) is not None:
                return found
            if refine:
                solution = self.descent(point, monitor)
                point = self.completed(solution.estimate)
                settled = solution.status is Status.CONVERGED or (
                    solution.status is Status.STALLED and self.problem.stationarity(point) < SETTLED
                )
            end, cost = self._lowest(point, start)
            if self.stop.should_stop() or (refine and solution.status is Status.INTERRUPTED):
                return LocalMinimum(end, cost, settled, None, refine)
            if known is not None and known.value >= cost - self.tolerance(cost):
                return LocalMinimum(end, cost, settled, known.bound, refine)
            bound = self.bound(point, cost, refine=refine)
        except (NumericalError, np.linalg.LinAlgError):
            return LocalMinimum(start, self.cost_upper(start), False, None, refine)
        return LocalMinimum(end, cost, settled, bound, refine)

    def _lowest(self, end: Estimate, start: Estimate) -> tuple[Estimate, float]:
        """The end of a descent, or its start if rounding under large weights has raised the cost.

        With the cost, rounded up.
        """
        cost, problem = self.cost_upper(end), self.problem
        if problem.cost(start) < problem.cost(end) - self.difference(cost):
            given = self.cost_upper(start)
            if given < cost:
                return start, given
        return end, cost

    def _at_rest(self, point: Estimate) -> LocalMinimum | None:
        """The basin of a stationary point that its own multipliers prove optimal, else None."""
        try:
            if self.stop.should_stop() or not self.problem.stationarity(point) <= SETTLED:
                return None
            cost = self.cost_upper(point)
            found = LocalMinimum(point, cost, True, self.bound(point, cost))
        except (NumericalError, np.linalg.LinAlgError):
            return None
        proven = cost - found.value <= AT_REST * self.difference(cost)
        return found if proven or self.fits(point) else None

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate at which a bound is computed: with its best translations.

        Elsewhere the bound is valid, but useless.
        """
        return self.problem.complete(estimate.rotations)

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Local descent from an estimate."""
        monitor = monitor or self.stop
        return newton(self.problem, start, DESCENT, monitor=monitor, watch=self.stop.watch)

    def short_descent(self, start: Estimate, settings: NewtonSettings) -> Estimate:
        """The end of a descent that begins near it."""
        return newton(self.problem, start, settings).estimate

    def elsewhere(self) -> LocalMinimum | None:
        """The basin reached without an estimate, from eigenvectors; None if there is none."""
        return self.basin(self._spectral_start(), True)

    def _spectral_start(self) -> Estimate:
        chordal = self.problem.chordal
        try:
            start = spectral.spectral_start(chordal)
            if self.problem.is_chordal:
                return start
            return newton(
                chordal, start, DESCENT, monitor=lambda _: self.stop.stop_requested
            ).estimate
        except (NumericalError, np.linalg.LinAlgError):
            n, d = chordal.n, chordal.d
            return Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))

    def bound(
        self,
        point: Point,
        cost: float,
        *,
        sharp: bool = True,
        tight: bool = False,
        refine: bool = True,
    ) -> DualBound | None:
        """The bound by the multipliers of a converged point, at this tier.

        If it misses rtol F and bridges are a large share of the graph, also the bound by the parts
        between them.

        Parameters
        ----------
        point : point of any rank; at the proof tier only an estimate has a bound
        cost : F there or at a better point; it decides when the bound suffices
        sharp, tight : see `dual_bound`
        refine : whether to improve the parts' points
        """
        is_stiff = self.eased is not self.problem
        here = self.eased.with_optimal_translations(point) if is_stiff else point
        whole = self._bound(self.eased, here, cost, sharp=sharp, tight=tight)
        whole = self.or_softened(whole, point, cost, sharp=sharp, tight=tight, refine=refine)
        value = whole.value if whole else 0.0
        if value >= cost - self.rtol * cost or not self.parts:
            return whole
        if value > 0.0 and outside(self.problem, self.parts) < MUCH:
            return whole

        def bound_of(part: Part) -> DualBound | None:
            here = part.point(point, refine=refine)
            cost = part.problem.cost(here)
            return self._bound(part.problem, here, cost, sharp=sharp, tight=tight)

        summed = sum_of_bounds(self.problem, self.parts, bound_of)
        return summed if summed is not None and summed.value > value else whole

    def _bound(
        self, problem: Problem, point: Point, cost: float, *, sharp: bool, tight: bool
    ) -> DualBound | None:
        if self.tier is Tier.PROOF:
            if not isinstance(point, Estimate):  # a proof contains rotations, of rank d
                return None
            bound = dual_bound(problem, point)
            if bound is None:
                return None
            exact = self._exact if problem is self.problem else exact_graph(problem)
            return proven_bound(problem, exact, point, bound)
        enough = cost - self.difference(cost)
        return dual_bound(
            problem, point, rounding=self.rigorous, enough=enough, sharp=sharp, tight=tight
        )

    def raised(self, basin: LocalMinimum) -> LocalMinimum:
        """The basin, with a better bound if one takes more work than `bound` does."""
        return basin

    def proven(self, basin: LocalMinimum) -> DualBound | None:
        """The bound of a basin at this tier, which is the proof tier."""
        return self.bound(basin.point, basin.cost)

    @cached_property
    def eased(self) -> Problem:
        """The problem without stiff bridges, whose cost is nowhere above this one."""
        return eased(self.problem, cycles=False)

    def or_softened(
        self, found: DualBound | None, point: Point, cost: float, **how: bool
    ) -> DualBound | None:
        """A bound, or a better one without stiff measurements, if it misses rtol F."""
        if not isinstance(point, Estimate) or (found and found.value >= cost - self.rtol * cost):
            return found
        soft = eased(self.eased)
        if soft is self.eased:
            return found
        case = replace(self, problem=soft)
        near = case.completed(case.short_descent(point, CLOSE))
        bound = case.bound(near, cost, **how)
        other = case.raised(LocalMinimum(near, case.cost_upper(near), True, bound)).bound
        return other if other and (found is None or other.value > found.value) else found

    @cached_property
    def parts(self) -> list[Part]:
        """The parts between bridges; see `certpgo.certify.bridge_blocks`."""
        return parts(self.problem)

    def cost_upper(self, estimate: Estimate) -> float:
        """The cost of the estimate, rounded up: F in exact arithmetic at the proof tier."""
        if self.tier is Tier.PROOF and self.problem.is_chordal:
            return exact_cost(self.problem, self._exact, estimate)
        return self.problem.enclosure(estimate)[1]

    def sure(self, estimate: Estimate, cost: float) -> float:
        """A smaller cost is lower than the estimate's, at most ``cost``, despite rounding."""
        return self.problem.enclosure(estimate)[0] - self.difference(cost)

    @cached_property
    def _exact(self) -> checker.Graph:
        """The measurements in the checker's representation."""
        return exact_graph(self.problem)

    def certificate(
        self,
        estimate: Estimate,
        own: LocalMinimum,
        other: LocalMinimum | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate, given its own basin and possibly another."""
        problem = self.problem
        cost = own.cost if own.is_at(estimate) else self.cost_upper(estimate)
        tolerance = self.tolerance(cost)
        best = other if other is not None and other.value > own.value else own
        gap = difference_up(cost, best.value)
        finite = math.isfinite(cost) and math.isfinite(tolerance)

        def rounding(point: Estimate, cost: float) -> float:
            """The cost, if that is rounding and no bound comes near it."""
            open_gap = cost - best.value > self.tolerance(cost)
            return cost if open_gap and self.fits(point) else 0.0

        def optimal(point: Estimate, cost: float) -> bool:
            closed = cost - best.value <= self.tolerance(cost)
            return self.rigorous and (closed or rounding(point, cost) > 0.0)

        exact, own_exact = rounding(estimate, cost), rounding(own.point, own.cost)
        basin_is_global = optimal(own.point, own.cost)
        better, elsewhere, zero = None, False, max(exact, own_exact)
        # Costs of exact fits are rounding: none is better than another.
        lower = other is not None and other.cost < min(own.cost, self.sure(estimate, cost))
        if other is not None and lower and not zero:
            better, zero = other, rounding(other.point, other.cost)
            # A descent that was given up while the optimum was known does not reach it.
            proven = optimal(other.point, other.cost)
            ended = own.settled or (proven and own.descended and self.stop.cut is None)
            elsewhere = ended and other.cost < self.sure(own.point, own.cost)
        if elsewhere:
            verdict = Verdict.REFUTED
        elif finite and self.rigorous and (gap <= tolerance or exact > 0.0):
            verdict = Verdict.CERTIFIED
        elif finite and (best.value > 0.0 or basin_is_global):
            verdict = Verdict.BOUNDED
        else:
            verdict = Verdict.UNDECIDED
        closed = basin_is_global or verdict in (Verdict.CERTIFIED, Verdict.REFUTED)
        limit = self._limit(closed, best.bound, min(own.cost, cost))
        judged = Certificate(
            verdict=verdict,
            tier=self.tier,
            cost_computed=problem.cost(estimate),
            cost_upper=cost,
            lower_bound=best.value,
            gap=gap,
            rtol=self.rtol,
            atol=self.atol,
            scale=problem.scale,
            rounding=zero,
            stationarity=problem.stationarity(estimate),
            max_residual_angle=float(problem.residual_angles(estimate).max()),
            multipliers=best.bound.multipliers if best.bound else None,
            shift=best.bound.shift if best.bound else 0.0,
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
            support=best.bound.support if best.bound else None,
            obstacle=Obstacle(limit, stopped=self.stop.cut),
        )
        return in_units(self.unit, judged)

    def _limit(self, closed: bool, bound: DualBound | None, cost: float) -> LimitedBy:
        """What keeps the gap open, unless it is closed, as far as the bound of one point tells."""
        if closed:
            return LimitedBy.TIGHT
        if self.stop.cut is not None:
            return LimitedBy.STOPPED
        return LimitedBy.ROUNDING if self.loses_to_rounding(bound, cost) else LimitedBy.LOOSE

    def loses_to_rounding(self, bound: DualBound | None, cost: float) -> bool:
        """Whether rounding alone keeps a bound from a cost: its point is no lower than that."""
        if bound is None or bound.loose:
            return False
        return cost - bound.attained <= self.tolerance(cost)
