"""Bounds and certificates for graphs with measured distances."""

from __future__ import annotations

import math

import numpy as np

from certpgo.certify import rounding
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.costs.ranges import RangeProblem
from certpgo.graph import Estimate
from certpgo.graph.lift import Point, translations_of
from certpgo.linalg.balls import U


def cost_upper(problem: RangeProblem, estimate: Estimate) -> float:
    """An upper bound on f of the estimate, whose translations are taken as stored."""
    i, j = problem.ranges.edges.T
    t, distances = translations_of(estimate), problem.ranges.distances
    length = np.linalg.norm(t[j] - t[i], axis=1)
    # The difference, d squares, their sum and the root, each relative to the length.
    error = 16.0 * U * (length + distances) + 2.0**-500
    terms = problem.ranges.weights * (np.abs(length - distances) + error) ** 2
    total = math.fsum(terms * (1.0 + 16.0 * U)) * (1.0 + 4.0 * U)
    return math.nextafter(rounding.cost_upper(problem.alone, estimate) + total, math.inf)


def range_bound(problem: RangeProblem, point: Point, cost: float) -> DualBound | None:
    """A lower bound on f* from a stationary point of the relaxation, of any rank.

    By the pose graph of tangents there, see `certpgo.costs.ranges`; None if it is not above zero.

    Parameters
    ----------
    cost : f of the best estimate; it decides how sharp is sharp enough
    """
    below, constant = problem.surrogate(point)
    enough = problem.cost(point) - constant - 1e-7 * cost
    found = dual_bound(below, point, enough=enough, floor=-constant)
    if found is None:
        return None
    value = math.nextafter(found.value + constant, -math.inf)
    if not value > 0.0:
        return None
    return DualBound(value, found.multipliers, found.shift, found.factorizations, found.nonzeros)
