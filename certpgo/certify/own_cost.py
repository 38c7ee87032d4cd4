"""Certificates in the cost of another program, by surrogates.

A surrogate is a pose graph whose cost F' plus a constant C is nowhere above the cost f, and equal
to it at its expansion point. So F' >= v implies f >= v + C; at a stationary point of f, whose
surrogate has a positive semidefinite certificate matrix there, that is f itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Self

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.case import Basin, Case
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.climb import climb
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.costs.descent import descend
from certpgo.costs.problem import InformationProblem, Surrogate, surrogate
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.lift import Point
from certpgo.io.plural import counted
from certpgo.optimize.solution import Solution

#: Ranks that a point is lifted by for a bound.
RANKS = 3


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
            Also the proof tier, or information matrices that are not positive definite.
        """
        problem.refuse_indefinite()
        if tier in (Tier.PROOF, Tier.PROOF.value):
            title = problem.edge_cost.title
            raise InputError(f"the proof tier is for the chordal cost, not for {title}")
        return super().of(problem, tier, rtol, atol)  # type: ignore[arg-type]

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
        """The best bound by the surrogate at a point; None without one.

        The first is that of the multipliers there. With ``refine``, if it does not suffice, those
        of the surrogate's minima of higher ranks follow; and if none is of use, the bound of a
        relaxed cost, at the end of descent on that.
        """
        if not isinstance(point, Estimate):
            return None
        best = None
        for found in self._bounds_at(point, cost, sharp, tight, RANKS if refine else 0):
            if best is None or found.value > best.value:
                best = found
            if best.value >= cost - self.tolerance(cost):
                break
        if (best is not None and best.value > 0.0) or self.relaxed is None:
            return best
        return self.relaxed.basin(point, True).bound or best

    @cached_property
    def relaxed(self) -> OwnCostCase | None:
        """The case of a cost that is nowhere above this one; None if there is none."""
        cost = self.problem.edge_cost.relaxed()
        if cost is None or not cost.graph.is_definite.all():
            return None
        return replace(self, problem=self.problem.with_cost(cost))

    def _bounds_at(
        self, point: Estimate, cost: float, sharp: bool, tight: bool, ranks: int
    ) -> Iterator[DualBound]:
        """Bounds by the surrogate at a point, from points of rising rank."""
        below = self.below(point)
        if below is None:
            return
        enough = cost - self.tolerance(cost) - below.constant
        start = below.problem.settled(point)
        points: Iterable[Point] = chain(
            [start], climb(below.problem, start, self.problem.d + ranks)
        )
        for here in points:
            found = dual_bound(
                below.problem,
                here,
                rounding=self.rigorous,
                enough=enough,
                sharp=sharp,
                tight=tight,
            )
            if found is not None:
                value = math.nextafter(found.value + below.constant, -math.inf)
                yield replace(found, value=value)

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
