"""Certificates in the cost of another program, by surrogates.

A surrogate is a pose graph whose cost F' plus a constant C is nowhere above the cost f, and equal
to it at its expansion point. So F' >= v implies f >= v + C; at a stationary point of f, whose
surrogate has a positive semidefinite certificate matrix there, that is f itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, cast

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.chordal_case import Case
from certpgo.certify.dual import DualBound, Support
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.proof import proven_surrogate
from certpgo.certify.range_case import FAINTER, RangedCase
from certpgo.certify.staircase_bound import climb
from certpgo.certify.stiff_edges import eased
from certpgo.certify.surrogate_bound import bound_below
from certpgo.errors import GraphError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.information_problem import (
    InformationProblem,
    surrogate_at,
    surrogate_of,
)
from certpgo.objective.range_problem import RangeProblem
from certpgo.objective.surrogate import Surrogate
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.range_saddles import climb as climb_distances
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.solution import Solution

#: Ranks that a point is lifted by for a bound, and surrogates that are tried.
RANKS, EXPANSIONS = 3, 6
#: Stationarity at which a short descent ends; the cost is then exact to rounding.
STATIONARY = 1e-8
#: Share of the gap that another surrogate must be able to close.
WORTH = 0.1


@dataclass(frozen=True)
class Reached:
    """A point of a surrogate's relaxation, its bound on the cost, and the surrogate's number."""

    point: Point
    bound: DualBound | None
    number: int


@dataclass(frozen=True)
class OwnCostCase(Case):
    """A `Case` whose cost is that of another program; ``problem`` is an `InformationProblem`."""

    problem: InformationProblem  # type: ignore[assignment]
    #: Ranks above d that points for better bounds reach.
    ranks: int = RANKS

    @cached_property
    def eased(self) -> InformationProblem:  # type: ignore[override]
        """The problem without stiff bridges, see `Case.eased`."""
        return eased(self.problem, cycles=False)

    @classmethod
    def of(
        cls,
        problem: Any,
        tier: Tier | str,
        rtol: float,
        atol: float,
        monitor: Monitor = silent,
    ) -> Self:
        """Normalize a problem; see `Case.of`.

        Raises
        ------
        InputError
            Also the proof tier of a cost that has none, or information that is not positive
            definite.
        """
        problem.refuse_indefinite()
        return super().of(problem, tier, rtol, atol, monitor)

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate itself: its best translations depend on the cost, and come by descent."""
        return estimate

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Local descent on the cost from an estimate."""
        return descend(self.problem, start, monitor=monitor or self.stop, watch=self.stop.watch)

    def _spectral_start(self) -> Estimate:
        """That of the same measurements under F; with distances, near its relaxation."""
        if self.problem.measured.ranges is None:
            return super()._spectral_start()
        try:
            isotropic = self.problem.isotropic
        except GraphError:  # what F has no terms for joins some nodes
            return super()._spectral_start()
        case = RangedCase(
            cast("RangeProblem", isotropic),
            self.unit,
            Tier.STANDARD,
            self.rtol,
            self.atol,
            self.stop,
        )
        found = case.elsewhere()
        return super()._spectral_start() if found is None else found.point

    def short_descent(self, start: Estimate, settings: NewtonSettings) -> Estimate:
        """The end of a descent that begins near it."""
        return descend(self.problem, start, tolerance=STATIONARY).estimate

    def bound(
        self,
        point: Point,
        cost: float,
        *,
        sharp: bool = True,
        tight: bool = False,
        refine: bool = True,
    ) -> DualBound | None:
        """The bound by the surrogate expanded at the point; None without one."""
        if not isinstance(point, Estimate):
            return None
        found = next(self.reached(point, cost, sharp=sharp, tight=tight), None)
        bound = None if found is None else found.bound
        if bound is not None and self.tier is Tier.PROOF:
            bound = self.reproven(bound)
        return self.or_softened(bound, point, cost, sharp=sharp, tight=tight, refine=refine)

    def raised(self, basin: LocalMinimum) -> LocalMinimum:
        """The basin with the best bound by surrogates, see `reached`, or else `lowered_bound`."""
        best: DualBound | None = None
        enough = basin.cost - self.tolerance(basin.cost)
        for found in self.reached(basin.point, basin.cost):
            if found.bound is not None and (best is None or found.bound.value > best.value):
                best = found.bound
            if self.stop.should_stop() or (best is not None and best.value >= enough):
                break
        if (best is None or best.value <= 0.0) and not self.stop.should_stop():
            best = self.lowered_bound(basin.point) or best
        if best is not None and self.tier is Tier.PROOF:
            best = self.reproven(best)
        return basin if best is None or best.value <= basin.value else replace(basin, bound=best)

    def lowered_bound(self, point: Estimate) -> DualBound | None:
        """The best bound on a cost that is nowhere above this one, at the end of descent on it.

        None if there is no such cost, or no bound.
        """
        cost = self.problem.edge_cost.relaxed()
        if cost is None or not cost.graph.is_definite.all():
            return None
        case = replace(self, problem=self.problem.with_cost(cost))
        end = descend(case.problem, point, monitor=self.stop.of_minorant(0.0)).estimate
        reached = case.reached(end, case.cost_upper(end))
        bounds = [found.bound for found in reached if found.bound is not None]
        best = max(bounds, key=lambda bound: bound.value, default=None)
        if best is None or best.support is None:
            return best
        return replace(best, support=replace(best.support, lowered=True))

    def proven(self, basin: LocalMinimum) -> DualBound | None:
        """The bound of a basin at the proof tier, from that of the standard tier."""
        return None if basin.bound is None else self.reproven(basin.bound)

    def reproven(self, found: DualBound) -> DualBound | None:
        """A bound of the standard tier at the proof tier; None if that fails."""
        if found.support is None:
            return None
        minorants = found.support.minorants
        point, constants = found.support.point, minorants.constant[minorants.exist]
        below, _ = surrogate_of(self.problem, minorants).at(point)
        return proven_surrogate(below, constants, point, found)

    def reached(
        self, start: Estimate, cost: float, *, sharp: bool = True, tight: bool = False
    ) -> Iterator[Reached]:
        """Points of surrogates' relaxations, and the bounds on the cost there.

        The first is the start, in the surrogate expanded there. Minima of rising rank follow, and
        then those of surrogates expanded in between: the largest bound by a surrogate is the
        minimum of a convex function of the poses' Gram matrix, which surrogates are tangent to.
        Frank and Wolfe's method (1956) finds it: between the last expansion and the last minimum
        lies the next expansion, where that function is lowest.

        Parameters
        ----------
        start : stationary for the cost
        cost : the cost there; it decides when a bound suffices
        sharp, tight : see `certpgo.certify.dual.dual_bound`
        """
        v, Q = self.eased.relative(start)
        point: Point = start
        expanded = self.eased.cost(start)
        for number in range(EXPANSIONS):
            below = self.below(v, Q)
            if below is None:
                return
            minima = self._minima(below, start=point)
            for point in minima:
                bound = self._bound_at(below, point, cost, sharp=sharp, tight=tight)
                if bound is not None:
                    bound = replace(bound, support=Support(below.minorants, point))
                yield Reached(point, bound, number)
            if self.stop.should_stop():
                return
            there = self.eased.relative(point)
            fall = expanded - (below.problem.cost(point) + below.constant)
            bend = self.eased.bend(there[0] - v, below.minorants.tau)
            gap = cost - expanded + fall
            if not (gap > self.tolerance(cost) and min(fall, bend) > WORTH * gap):
                return
            step = min(0.5 * fall / bend, 1.0)
            expanded -= step * (fall - step * bend)
            v, Q = v + step * (there[0] - v), Q + step * (there[1] - Q)

    def _minima(self, below: Surrogate, start: Point) -> Iterator[Point]:
        """A point, and minima of rising rank of the surrogate's relaxation."""
        problem, highest = below.problem, self.problem.d + self.ranks
        monitor = self.stop.of_minorant(below.constant)
        if isinstance(problem, RangeProblem):
            yield start
            yield from (end.point for end, _ in climb_distances(problem, start, highest, self.stop))
        elif problem.eliminates:
            settled = problem.with_optimal_translations(start)
            yield from climb(problem, settled, highest, monitor)
        else:
            yield start

    def _bound_at(
        self, below: Surrogate, point: Point, cost: float, *, sharp: bool, tight: bool
    ) -> DualBound | None:
        """The bound by a surrogate at a point; of distances, by fainter tangents too."""
        for more in FAINTER if self.problem.measured.ranges else (0.0,):
            problem, constant = below.at(point, more)
            found = bound_below(
                problem,
                constant,
                point,
                rounding=self.rigorous,
                enough=cost - self.difference(cost) - constant,
                sharp=sharp,
                tight=tight,
                floor=-constant if self.problem.measured.blocks else 0.0,
            )
            if found is not None:
                return found
        return None

    def certificate(
        self,
        estimate: Estimate,
        own: LocalMinimum,
        other: LocalMinimum | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate, whose gap measurements without a minorant may limit."""
        found = super().certificate(estimate, own, other, bounds)
        unproven = found.verdict in (Verdict.BOUNDED, Verdict.UNDECIDED)
        if not unproven or self.stop.cut is not None:
            return found
        try:
            minorants = self.eased.edge_cost.minorants(*self.eased.relative(own.point))
        except np.linalg.LinAlgError:
            return found
        missing = np.flatnonzero(~minorants.exist)
        if not len(missing):
            return found
        i, j = self.problem.graph.edges[missing[0]].tolist()
        obstacle = Obstacle(LimitedBy.NO_MINORANT, missing=len(missing), edge=(i, j))
        return replace(found, obstacle=obstacle)

    def below(self, v: FloatArray, Q: FloatArray) -> Surrogate | None:
        """The surrogate expanded there; None if too many measurements have no minorant."""
        try:
            return surrogate_at(self.eased, v, Q)
        except (NumericalError, GraphError):  # GraphError: weights beyond their range
            return None
