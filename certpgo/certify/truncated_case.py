"""Certificates of rejections: bounds on the truncated cost by edges of negative weight.

A rejected measurement is an edge of negative weight, see `certpgo.objective.truncated`. Where the
certificate matrix S_K of the kept measurements minus all of these edges is positive semidefinite,
the estimate is optimal over all poses and over all choices of rejected measurements.

Where it is not, some measurements are ambiguous: their residuals are not large against the
uncertainty of the estimate in their direction. S_K >= beta B B^T, for the block column B of an
edge, if and only if beta times the largest eigenvalue of B^T S_K^+ B, an effective resistance, is
at most one. These loads, of rotations and translations of each edge, say how its weight is split
best, and which edges to leave at zero, where min(f, c) >= 0 bounds their terms.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.obstacle import LimitedBy
from certpgo.certify.resistances import loads_of, resistances
from certpgo.certify.surrogate_bound import bound_below
from certpgo.certify.tolerances import DESCENT, Case, LocalMinimum
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.truncated import FLATTEST, STEEPEST
from certpgo.objective.truncated_problem import TruncatedProblem
from certpgo.optimize.monitor import Iteration, Monitor
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution, Status

#: Descents, each with the measurements that the last one takes back.
ROUNDS = 20


@dataclass(frozen=True, eq=False, repr=False)
class RejectionBound(DualBound):
    """A bound on a truncated cost.

    Attributes
    ----------
    ambiguous : rejected measurements whose prices are not part of it, ascending
    """

    ambiguous: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))


@dataclass(frozen=True)
class TruncatedCase(Case):
    """A `Case` whose cost is truncated; ``problem`` is a `TruncatedProblem`."""

    problem: TruncatedProblem  # type: ignore[assignment]

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate with the best translations for the measurements that count there."""
        counted = self.problem.counted(estimate)
        return self.problem.counting(counted).complete(estimate.rotations)

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Descents on F of the measurements that count, until these no longer change."""
        forward, counted = monitor or self.stop, self.problem.counted(start)
        for _ in range(ROUNDS):
            prices = float(self.problem.prices[~counted].sum())

            def truncated(iteration: Iteration, prices: float = prices) -> bool:
                return forward(replace(iteration, cost=iteration.cost + prices))

            problem, watch = self.problem.counting(counted), self.stop.watch
            found = newton(problem, start, DESCENT, monitor=truncated, watch=watch)
            before, start = counted, found.estimate
            counted = self.problem.counted(start)
            if (counted == before).all() or found.status is Status.INTERRUPTED:
                break
        return replace(found, cost=self.problem.cost(start))

    def short_descent(self, start: Estimate, settings: NewtonSettings) -> Estimate:
        """The end of a descent that begins near it."""
        return self.descent(start).estimate

    def bound(
        self,
        point: Point,
        cost: float,
        *,
        sharp: bool = True,
        tight: bool = False,
        refine: bool = True,
    ) -> DualBound | None:
        """The bound with all prices, or else with none, which is that of the kept measurements."""
        if not isinstance(point, Estimate):
            return None
        ratios = self.problem.truncation(point).ratios()
        whole = self._bound_by(point, cost, ratios, sharp=sharp, tight=True)
        if whole is not None or tight:
            return whole
        alone = self._optimum_of_kept(point)
        return self._bound_by(alone, cost, np.zeros_like(ratios), sharp=sharp, tight=False)

    def raised(self, basin: LocalMinimum) -> LocalMinimum:
        """The basin with a bound by as many prices as can be proven, in the order of their loads.

        At the optimum of the kept measurements, by the rejected ones that cost more than their
        price there.
        """
        if not isinstance(basin.bound, RejectionBound) or not len(basin.bound.ambiguous):
            return basin
        point = self._optimum_of_kept(basin.point)
        loads = self._loads(point)
        if loads is None:
            return basin
        truncation = self.problem.truncation(point)
        ratios = truncation.ratios(loads)
        total = (ratios * loads).sum(axis=1)
        total[truncation.costs.sum(axis=1) <= truncation.prices] = np.inf
        order = np.argsort(total, kind="stable")[: int(np.isfinite(total).sum())]
        best, proven, failed = basin.bound, 0, len(order) + 1
        # Loads that add up to one at most are no risk.
        count = max(int(np.searchsorted(np.cumsum(total[order]), 1.0)), 1)
        while proven + 1 < failed and not self.stop.should_stop():
            chosen = np.zeros_like(ratios)
            chosen[order[:count]] = ratios[order[:count]]
            bound = self._bound_by(point, basin.cost, chosen, sharp=True, tight=True)
            if bound is None:
                failed = count
            else:
                proven, best = count, max(best, bound, key=lambda one: one.value)
            count = (proven + failed) // 2
        return replace(basin, bound=best)

    def _optimum_of_kept(self, near: Estimate) -> Estimate:
        kept = self.problem.kept
        if (self.problem.counted(near) != self.problem.is_rejected).all():
            return near
        return kept.complete(newton(kept, near, DESCENT, watch=self.stop.watch).estimate.rotations)

    def _loads(self, point: Estimate) -> FloatArray | None:
        """(k, 2) what ratios of one cost at a point; None if the kept ones have no bound there."""
        nothing = np.zeros((len(self.problem.rejected), 2))
        below, _ = self.problem.surrogate(point, nothing)
        S, at = below.certificate_matrix(below.multipliers(point)), self.problem.truncation(point)
        found = resistances(below, S, at)
        return None if found is None else loads_of(found, at)

    def _bound_by(
        self, point: Estimate, cost: float, ratios: FloatArray, *, sharp: bool, tight: bool
    ) -> RejectionBound | None:
        """The bound with minorants of these ratios (k, 2)."""
        below, constant = self.problem.surrogate(point, ratios)
        found = bound_below(
            below,
            constant,
            point,
            rounding=self.rigorous,
            enough=cost - self.difference(cost) - constant,
            sharp=sharp,
            tight=tight,
            floor=-constant,
        )
        if found is None:
            return None
        left_out = ((ratios == 0.0).all(axis=1) | (ratios > STEEPEST).any(axis=1)) & (
            self.problem.truncation(point).costs.sum(axis=1) > FLATTEST * self._prices
        )
        values = {of.name: getattr(found, of.name) for of in fields(found)}
        return RejectionBound(**values, ambiguous=self.problem.rejected[left_out])

    @property
    def _prices(self) -> FloatArray:
        return self.problem.prices[self.problem.is_rejected]

    def certificate(
        self,
        estimate: Estimate,
        own: LocalMinimum,
        other: LocalMinimum | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate, whose gap ambiguous measurements may limit."""
        found = super().certificate(estimate, own, other, bounds)
        found = replace(found, rejected=len(self.problem.rejected))
        best = other if other is not None and other.value > own.value else own
        unproven = found.verdict in (Verdict.BOUNDED, Verdict.UNDECIDED)
        if not unproven or not isinstance(best.bound, RejectionBound):
            return found
        ambiguous = tuple(best.bound.ambiguous.tolist())
        if not ambiguous:
            return found
        kind = LimitedBy.AMBIGUOUS
        return replace(found, obstacle=replace(found.obstacle, kind=kind, ambiguous=ambiguous))
