"""Bounds and certificates for graphs with similarities.

The lengths of blocks of unknown scale are not bounded, so a shift of their rows costs nobody knows
how much. What rounding demands of them, and of translations, is subtracted before the factorization
and compensated at the poses of known scale, as `certpgo.certify.multipliers` does for translations:

    S + diag(delta) >= 0,  delta > 0 only in rows of poses of known scale,

so F* >= sum tr(Lam_i) - sum delta over these. docs/concepts/similarities.md has the proof.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from certpgo.certify.certificate import Tier
from certpgo.certify.chordal_case import Case
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.similarity_descent import climb, descend, starts
from certpgo.optimize.solution import Solution

#: Shares of the multipliers that are given up where rounding has no other compensation: at points
#: of higher rank, whose kernel need not meet the poses of known scale.
SHARES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
#: Ranks above d that the relaxation is climbed to, and the relative gap between a point of it and
#: its bound below which it is solved.
MORE_RANKS, SOLVED = 7, 1e-6


@dataclass(frozen=True)
class SimilarCase(Case):
    """A `Case` over similarities."""

    problem: SimilarityProblem

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate with its best translations."""
        problem = self.problem
        if estimate.scales is None:
            estimate = problem.complete(estimate.rotations)
        return problem.with_optimal_translations(estimate)

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Local descent from an estimate."""
        return descend(self.problem, start, monitor=monitor or self.stop, watch=self.stop.watch)

    def short_descent(self, start: Estimate, settings: NewtonSettings) -> Estimate:
        """The end of a descent that begins near it."""
        return descend(self.problem, start, max_iterations=settings.max_iterations).estimate

    def bound(
        self,
        point: Point,
        cost: float,
        *,
        sharp: bool = True,
        tight: bool = False,
        refine: bool = True,
    ) -> DualBound | None:
        """The bound by the multipliers of a converged point of any rank."""
        if self.tier is Tier.PROOF:
            return self._bound(self.problem, point, cost, sharp=sharp, tight=tight)
        problem, here = self.problem, self.problem.blocks(point)
        enough = cost - self.difference(cost)
        for given_up in SHARES if here.rank > problem.d and not problem.in_mean_unit else (0.0,):
            found = dual_bound(
                problem,
                here,
                rounding=self.rigorous,
                enough=enough,
                sharp=sharp,
                tight=tight,
                given_up=given_up,
            )
            if found is not None:
                return found
        return None

    def raised(self, basin: LocalMinimum) -> LocalMinimum:
        """The basin, with the bound of the relaxation's minimum if that is better."""
        if self.tier is Tier.PROOF or self.is_sharp(basin):
            return basin
        problem = self.problem
        for point, cost, _ in climb(problem, basin.point, problem.d + MORE_RANKS, self.stop):
            found = self.bound(point, basin.cost)
            if found is not None and found.value > basin.value:
                basin = replace(basin, bound=found)
            if self.stop.should_stop() or basin.value >= (1.0 - SOLVED) * cost:
                break
        return basin

    def elsewhere(self) -> LocalMinimum | None:
        """The best of the basins that are reached without an estimate."""
        best: LocalMinimum | None = None
        for start in self._starts():
            found = self.basin(start, True)
            if best is None or found.cost < best.cost:
                best = found
            if self.is_sharp(best) or self.stop.should_stop():
                break
        return best

    def _starts(self) -> Iterator[Estimate]:
        with suppress(NumericalError, np.linalg.LinAlgError):
            for start in starts(self.problem):
                yield start.estimate
