"""Lower bounds on any cost, by a pose graph whose cost plus a constant is nowhere above it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from certpgo.certify.dual import DualBound, dual_bound
from certpgo.graph.relaxed_point import Point
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.problem import Problem


def lower_bound(problem: Certifiable, point: Point) -> float:
    """A lower bound on the optimum of a problem's cost, from a point; 0 if there is none.

    It is the best possible if the point is an optimum of the cost's relaxation.

    Parameters
    ----------
    point : near-stationary, with translations optimal for its rotations; of any rank where the
        cost is that of poses and distances, else an estimate

    Raises
    ------
    NumericalError
        No pose graph below the cost is known there.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.certify.surrogate_bound import lower_bound
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> answer = certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph)
    >>> 0.99999 * answer.cost < lower_bound(answer.problem, answer.estimate) <= answer.cost
    True
    """
    below, constant = problem.surrogate(point)
    found = bound_below(below, constant, point)
    return 0.0 if found is None else max(found.value, 0.0)


def bound_below(below: Problem, constant: float, point: Point, **how: Any) -> DualBound | None:
    """`dual_bound` plus a constant, rounded down."""
    found = dual_bound(below, point, **how)
    if found is None or constant == 0.0:
        return found
    value = math.nextafter(found.value + constant, -math.inf)
    return replace(found, value=value, attained=found.attained + constant)
