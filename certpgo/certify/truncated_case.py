"""Certificates of rejections: bounds on the truncated cost by edges of negative weight.

A rejected measurement is an edge of negative weight, see `certpgo.objective.truncated`. Where the
certificate matrix S_K of the kept measurements minus all of these edges is positive semidefinite,
the estimate is optimal over all poses and over all choices of rejected measurements.

Where it is not, `certpgo.certify.resistances` has the weights that burden it least. Measurements
that are left out then are ambiguous: their residuals are not large against the uncertainty of the
estimate in their direction, and min(f, c) >= 0 is all that bounds their terms.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.chordal_case import Case
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.obstacle import LimitedBy
from certpgo.certify.proof import CLOSE, proven_surrogate
from certpgo.certify.resistances import Resistances, packed
from certpgo.certify.stiff_edges import eased
from certpgo.certify.surrogate_bound import bound_below
from certpgo.certify.surrogate_case import OwnCostCase
from certpgo.certify.tolerances import NEGLIGIBLE
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.truncated import FLATTEST
from certpgo.objective.truncated_problem import TruncatedProblem
from certpgo.optimize.monitor import Iteration, Monitor
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.solution import Solution, Status

#: Descents, each with the measurements that the last one takes back.
ROUNDS = 20
#: Share of the smallest price that a tolerated gap may be; a larger one says nothing about choices.
OF_PRICE = 0.01


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

    def tolerance(self, cost: float) -> float:
        """As of any cost, but never more than a small share of a price."""
        return min(super().tolerance(cost), self._most)

    def difference(self, cost: float) -> float:
        """As of any cost, but never more than a small share of a price."""
        return min(super().difference(cost), self._most)

    @cached_property
    def eased(self) -> TruncatedProblem:  # type: ignore[override]
        """The problem without stiff bridges, see `Case.eased`.

        Not its surrogate without them: minorants may be below zero, and lower weights would raise
        these, were it by rounding.
        """
        whole = eased(self.problem.whole, cycles=False)
        same = whole is self.problem.whole
        return self.problem if same else TruncatedProblem(whole, self.problem.prices)

    @property
    def _most(self) -> float:
        return OF_PRICE * float(self.problem.prices.min())

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate with the best translations for the measurements that count there."""
        return self._of(self.problem.counted(estimate)).completed(estimate)

    def _of(self, counted: BoolArray) -> Case:
        """The case of some measurements, without prices."""
        problem = self.problem.counting(counted)
        settings = self.unit, self.tier, self.rtol, self.atol, self.stop
        if isinstance(problem, InformationProblem):
            return OwnCostCase(problem, *settings)
        return Case(problem, *settings)

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Descents on F of the measurements that count, until these no longer change."""
        forward, counted = monitor or self.stop, self.problem.counted(start)
        for _ in range(ROUNDS):
            prices = float(self.problem.prices[~counted].sum())

            def truncated(iteration: Iteration, prices: float = prices) -> bool:
                return forward(replace(iteration, cost=iteration.cost + prices))

            found = self._of(counted).descent(start, truncated)
            before, start = counted, found.estimate
            counted = self.problem.counted(start)
            if (counted == before).all() or found.status is Status.INTERRUPTED:
                break
        return replace(found, cost=self.problem.cost(start))

    def _spectral_start(self) -> Estimate:
        """That of the kept measurements."""
        return self._of(~self.problem.is_rejected)._spectral_start()

    def short_descent(self, start: Estimate, settings: NewtonSettings) -> Estimate:
        """The end of a descent that begins near it."""
        return self.descent(start).estimate

    def at_rest(self, point: Estimate, W: FloatArray) -> Estimate:
        """Where minorants of weights W (k, b, b) balance, near a point, to more digits.

        Those of far measurements have no gradient. Not by descent on the surrogate: with negative
        weights it need not have a minimum.
        """
        counted = ~self.problem.is_rejected
        near = W.any(axis=(1, 2)) & ~self.problem.truncation(point).is_far
        counted[self.problem.rejected] = near
        case = self._of(counted)
        return case.completed(case.short_descent(point, CLOSE))

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
        point = self._beside_stiff(point)
        W = self.problem.truncation(point).plain()
        whole = self.bound_by(point, cost, W, sharp=sharp, tight=True)
        if whole is not None or tight:
            return whole
        alone = self.optimum_of_kept(point)
        return self.bound_by(alone, cost, np.zeros_like(W), sharp=sharp, tight=False)

    def raised(self, basin: LocalMinimum) -> LocalMinimum:
        """The basin with a bound by as many prices as can be proven at once.

        At the optimum of the kept measurements, of the rejected ones that cost more than their
        price there.
        """
        bound = basin.bound
        if not isinstance(bound, RejectionBound) or not len(bound.ambiguous):
            return basin
        point = self.optimum_of_kept(basin.point)
        at, found = self.problem.truncation(point), self.resistances(point)
        if found is None:
            return basin
        W, loads = packed(found, at, isotropic=self.tier is Tier.PROOF)
        better = None
        while better is None and W.any() and not self.stop.should_stop():
            better = self.bound_by(point, basin.cost, W, sharp=True, tight=True)
            used = W.any(axis=(1, 2))
            W[loads >= np.median(loads[used])] = 0.0  # rounding: the largest ones are left out
        return basin if better is None else replace(basin, bound=better)

    def optimum_of_kept(self, near: Estimate) -> Estimate:
        """The local optimum of the kept measurements near an estimate."""
        kept = ~self.problem.is_rejected
        if (self.problem.counted(near) == kept).all():
            return near
        case = self._of(kept)
        return self._beside_stiff(case.completed(case.descent(near).estimate))

    def _beside_stiff(self, point: Estimate) -> Estimate:
        """The point with translations to all digits beside stiff bridges, see `Case.bound`."""
        if self.eased is self.problem or self.tier is Tier.PROOF:
            return point
        return replace(self, problem=self.eased).completed(point)

    def resistances(self, point: Estimate) -> Resistances | None:
        """Those of the rejected measurements there; None if the kept ones have no bound there."""
        at = self.problem.truncation(point)
        below, _ = self.problem.surrogate(point, np.zeros_like(at.plain()))
        return Resistances.of(below, below.certificate_matrix(below.multipliers(point)), at)

    def bound_by(
        self, point: Estimate, cost: float, W: FloatArray, *, sharp: bool, tight: bool
    ) -> RejectionBound | None:
        """The bound with minorants of these weights (k, b, b)."""
        at = self.problem.truncation(point)
        below, constant = self.eased.surrogate_of(self.eased.minorants(point, W, at))
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
        if found is not None and self.tier is Tier.PROOF:
            rested, minorants = self.at_rest(point, W), self.problem.minorants(point, W, at)
            below, _ = self.problem.surrogate_of(minorants)
            found = proven_surrogate(below, minorants.constant, rested, found, at_rest=True)
        if found is None:
            return None
        left_out = ~W.any(axis=(1, 2)) & (at.costs > FLATTEST * at.prices)
        values = {of.name: getattr(found, of.name) for of in fields(found)}
        return RejectionBound(**values, ambiguous=self.problem.rejected[left_out])

    def certificate(
        self,
        estimate: Estimate,
        own: LocalMinimum,
        other: LocalMinimum | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate, whose gap ambiguous measurements may limit."""
        found = super().certificate(estimate, own, other, bounds)
        angle = float(self.problem.kept.residual_angles(estimate).max())
        found = replace(found, rejected=len(self.problem.rejected), max_residual_angle=angle)
        if found.tolerance > (most := self.unit * self._most) and not found.rounding:
            share, absolute = most / found.tolerance, NEGLIGIBLE * found.cost_upper / found.scale
            atol = min(found.atol, absolute)
            found = replace(found, rtol=share * found.rtol, atol=share * atol)
        best = other if other is not None and other.value > own.value else own
        unproven = found.verdict in (Verdict.BOUNDED, Verdict.UNDECIDED)
        if not unproven or not isinstance(best.bound, RejectionBound):
            return found
        ambiguous = tuple(best.bound.ambiguous.tolist())
        if not ambiguous:
            return found
        kind = LimitedBy.AMBIGUOUS
        return replace(found, obstacle=replace(found.obstacle, kind=kind, ambiguous=ambiguous))
