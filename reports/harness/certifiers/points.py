"""A point that certifiers are tested on, and how the truth about it is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from reports.harness.certifiers import oracle, search

#: Of the tolerance: a point this near the optimum is one that a certifier should not miss, and a
#: lower bound this near the best cost makes the optimum known.
MARGIN = 0.1


class Known(Enum):
    """How F* is known; ``OPEN`` when only an upper bound is."""

    CLOSED_FORM = "closed form"
    ORACLE = "interval oracle"
    SEARCH = "exhaustive search"
    OPEN = "open"


@dataclass(frozen=True)
class Truth:
    """What is known of a problem's optimum.

    Attributes
    ----------
    upper : the cost of an estimate in hand, rounded up by interval arithmetic
    lower : F* is at least this; minus infinity where that is open
    known : how the lower bound is known
    loose : whether the best multipliers in hand prove nothing: the relaxation is not tight
    """

    upper: float
    lower: float
    known: Known
    loose: bool = False


@dataclass(frozen=True, eq=False)
class ZooPoint:
    """A problem with a point to certify.

    Attributes
    ----------
    name : what it is called among its family
    problem : under F, or under the cost of another program
    point : the estimate; its matrices are not checked, so that it may be none
    """

    name: str
    problem: Quadratic | Sum
    point: Estimate
    truth: Truth

    @property
    def feasible(self) -> bool:
        """Whether the point's matrices are rotations, to the digits that a file may have."""
        return so.worst_defect(self.point.rotations)[1] <= so.DEFECT_TOLERANCE

    def tolerance(self, cost: float) -> float:
        """The gap up to which a point of this cost counts as optimal."""
        return RTOL * cost + ATOL * self.problem.scale

    def is_beaten(self, point: Estimate) -> bool:
        """Whether the estimate in hand is better than a feasible point by more than that."""
        low, high = oracle.cost(self.problem, point)
        return low - self.truth.upper > self.tolerance(high)

    def is_optimal(self, point: Estimate) -> bool:
        """Whether a feasible point is well within that of the optimum."""
        _, high = oracle.cost(self.problem, point)
        return high - self.truth.lower <= MARGIN * self.tolerance(high)


def stationary(problem: Quadratic | Sum, start: Estimate) -> Estimate:
    """Where descent from an estimate ends."""
    if isinstance(problem, Sum):
        if start.translations is None:
            start = problem.chordal.complete(start.rotations)
        return descend(problem, start, max_iterations=300).estimate
    point = newton(
        problem, problem.complete(start.rotations), NewtonSettings(max_iterations=300)
    ).estimate
    return problem.complete(point.rotations)


def truth_in_hand(problem: Quadratic | Sum, best: Estimate) -> Truth:
    """The truth where a point is all that is known."""
    return Truth(oracle.cost(problem, best)[1], -math.inf, Known.OPEN)


def truth_by_form(problem: Quadratic | Sum, best: Estimate, optimum: float) -> Truth:
    """The truth where F* is known in closed form and ``best`` attains it.

    The stored data are the form's but for rounding, of some 1e-15 of each term.
    """
    _, upper = oracle.cost(problem, best)
    slack = 1e-13 * optimum + 1e-14 * problem.scale
    return Truth(upper, max(0.0, optimum - slack), Known.CLOSED_FORM)


def truth_by_search(problem: Quadratic) -> tuple[Truth, Estimate] | None:
    """The truth by exhaustive search, and the optimum; None when the search is too long."""
    found = search.minimum(problem)
    if found is None:
        return None
    best = stationary(problem, found.best)
    proven = truth_by_oracle(problem, best)
    return Truth(proven.upper, found.lower, Known.SEARCH, proven.loose), best


def truth_by_oracle(problem: Quadratic, best: Estimate) -> Truth:
    """The truth as far as the interval oracle knows it, from the best point in hand."""
    _, upper = oracle.cost(problem, best)
    allowed = MARGIN * (RTOL * upper + ATOL * problem.scale)
    lower = oracle.lower_bound(problem, best, allowed)
    is_known = upper - lower <= allowed
    return Truth(upper, lower, Known.ORACLE if is_known else Known.OPEN, loose=not is_known)


def best_of(problem: Quadratic | Sum, starts: list[Estimate]) -> list[Estimate]:
    """The stationary points that descents from the starts end in, the best one first."""
    points = []
    for start in starts:
        try:
            points.append(stationary(problem, start))
        except NumericalError:
            continue
    return sorted(points, key=problem.cost)
