"""Certificates in the cost of another program, by surrogates.

A surrogate is a pose graph whose cost F' plus a constant C is nowhere above the cost f, and equal
to it at its expansion point. So F' >= v implies f >= v + C; at a stationary point of f, whose
surrogate has a positive semidefinite certificate matrix there, that is f itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.case import Basin, Case
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.certify.proof import proven_surrogate
from certpgo.costs.descent import descend
from certpgo.costs.g2o import G2oCost
from certpgo.costs.problem import InformationProblem, Surrogate, surrogate
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.lift import Point
from certpgo.io.plural import counted
from certpgo.optimize.solution import Solution


def is_provable(problem: InformationProblem) -> bool:
    """Whether the checker knows the problem's cost."""
    return problem.edge_cost.name == G2oCost.name


@dataclass(frozen=True)
class OwnCostCase(Case):
    """A `Case` whose cost is that of another program; ``problem`` is an `InformationProblem`."""

    problem: InformationProblem  # type: ignore[assignment]

    @classmethod
    def of(  # type: ignore[override]
        cls, problem: InformationProblem, tier: Tier | str, rtol: float, atol: float
    ) -> Self:
        """Normalize a problem; see `Case.of`.

        Raises
        ------
        InputError
            Also the proof tier of a cost that has none, or information that is not positive
            definite.
        """
        problem.refuse_indefinite()
        return super().of(problem, tier, rtol, atol)  # type: ignore[arg-type]

    @staticmethod
    def refuse_unprovable(problem: InformationProblem) -> None:  # type: ignore[override]
        """Refuse a cost that the checker does not know.

        Raises
        ------
        InputError
            It is not that of g2o.
        """
        if not is_provable(problem):
            said = "proofs and their tier are for the chordal cost and g2o's, not for"
            raise InputError(f"{said} {problem.edge_cost.title}")

    @property
    def objective(self) -> str:
        """The cost that certificates are about."""
        return self.problem.edge_cost.title

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate itself: its best translations depend on the cost, and come by descent."""
        return estimate

    def descent(self, start: Estimate) -> Solution:
        """Local descent on the cost from an estimate."""
        return descend(self.problem, start)

    def bound(
        self,
        point: Point,
        cost: float,
        *,
        sharp: bool = True,
        tight: bool = False,
        refine: bool = True,
    ) -> DualBound | None:
        """The bound by the surrogate at a point, from the multipliers there; None without one.

        If it is of no use, the bound of a relaxed cost, at the end of descent on that.
        """
        if not isinstance(point, Estimate):
            return None
        found = self._bound_at(point, cost, sharp=sharp, tight=tight)
        if (found is not None and found.value > 0.0) or self.relaxed is None:
            return found
        return self.relaxed.basin(point, True).bound or found

    @cached_property
    def relaxed(self) -> OwnCostCase | None:
        """The case of a cost that is nowhere above this one; None if there is none."""
        cost = self.problem.edge_cost.relaxed()
        if cost is None or not cost.graph.is_definite.all():
            return None
        return replace(self, problem=self.problem.with_cost(cost))

    def _bound_at(
        self, point: Estimate, cost: float, *, sharp: bool, tight: bool
    ) -> DualBound | None:
        below = self.below(point)
        if below is None:
            return None
        settled = below.problem.settled(point)
        if self.tier is Tier.PROOF:
            found = dual_bound(below.problem, settled)
            return None if found is None else self._proven(below, point, found)
        enough = cost - self.tolerance(cost) - below.constant
        found = dual_bound(
            below.problem,
            settled,
            rounding=self.rigorous,
            enough=enough,
            sharp=sharp,
            tight=tight,
        )
        if found is None:
            return None
        value = math.nextafter(found.value + below.constant, -math.inf)
        return replace(found, value=value, expansion=point)

    def reproven(self, found: DualBound) -> DualBound | None:
        """A bound of the standard tier at the proof tier; None if that fails."""
        point = found.expansion
        below = None if point is None else self.below(point)
        proven = None if point is None or below is None else self._proven(below, point, found)
        if (proven is not None and proven.value > 0.0) or self.relaxed is None:
            return proven
        return self.relaxed.reproven(found) or proven

    def _proven(self, below: Surrogate, point: Estimate, found: DualBound) -> DualBound | None:
        constants = below.minorants.constant
        proven = proven_surrogate(below.problem, constants, point, found)
        return None if proven is None else replace(proven, expansion=point)

    def certificate(
        self,
        estimate: Estimate,
        own: Basin,
        other: Basin | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate; its reason names measurements without a minorant."""
        found = super().certificate(estimate, own, other, bounds)
        if found.verdict not in (Verdict.BOUNDED, Verdict.UNDECIDED):
            return found
        exist = self.problem.edge_cost.minorants(*self.problem.relative(own.point)).exist
        missing = np.flatnonzero(~exist)
        if not len(missing):
            return found
        i, j = self.problem.graph.edges[missing[0]]
        count = counted(len(missing), "measurement{s}")
        spoiled = f"{count} without a minorant there, such as edge ({i}, {j})"
        return replace(found, reason=f"{found.reason}; {spoiled}")

    def below(self, point: Estimate) -> Surrogate | None:
        """The surrogate at a point; None if too many measurements have no minorant there."""
        try:
            return surrogate(self.problem, point)
        except NumericalError:
            return None

    def cost_upper(self, estimate: Estimate) -> float:
        """The cost of the estimate, rounded up."""
        return self.problem.enclosure(estimate)[1]

    def sure(self, estimate: Estimate, cost: float) -> float:
        """A smaller cost is lower than the estimate's, at most ``cost``, despite rounding."""
        return self.problem.enclosure(estimate)[0] - self.difference(cost)
