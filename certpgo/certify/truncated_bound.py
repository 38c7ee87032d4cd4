"""Bounds on the truncated cost by edges of negative weight.

A rejected measurement is an edge of negative weight, see `certpgo.objective.truncated`. Where the
certificate matrix S_K of the kept measurements minus all of these edges is positive semidefinite,
the estimate is optimal over all poses and over all choices of rejected measurements.

Where it is not, `certpgo.certify.resistances` has the weights that burden it least. Measurements
that are left out then are ambiguous: their residuals are not large against the uncertainty of the
estimate in their direction, and min(f, c) >= 0 is all that bounds their terms.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from certpgo.certify.bound import bound_by
from certpgo.certify.dual import DualBound
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.resistances import Resistances
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated import FLATTEST
from certpgo.objective.truncated_cost import TruncatedCost

Truncated = NormalizedProblem[TruncatedCost]


def bound_with(
    normalized: Truncated,
    point: Estimate,
    cost: float,
    W: FloatArray,
    *,
    sharp: bool = True,
    tight: bool = True,
) -> DualBound | None:
    """The bound with minorants of weights W (k, b, b) of the rejected measurements.

    Parameters
    ----------
    cost : that of the best estimate; it decides when a bound suffices
    sharp, tight : see `certpgo.certify.dual.dual_bound`
    """
    problem = normalized.problem
    at = problem.truncation(point)
    minorants = normalized.eased.minorants(point, W, at)
    found = bound_by(
        normalized.eased.surrogate_of(minorants),
        point,
        rounding=normalized.rigorous,
        enough=cost - normalized.difference(cost),
        real=normalized.real,
        sharp=sharp,
        tight=tight,
    )
    if found is None:
        return None
    left_out = ~W.any(axis=(1, 2)) & (at.costs > FLATTEST * at.prices)
    return replace(found, ambiguous=problem.rejected[left_out])


def below_with(problem: TruncatedCost, point: Estimate, W: FloatArray) -> Quadratic:
    """The quadratic problem of minorants of weights W."""
    return cast("Quadratic", problem.surrogate(point, W).problem)


def resistances(problem: TruncatedCost, point: Estimate) -> Resistances | None:
    """Those of the rejected measurements there; None if the kept ones have no bound there."""
    at = problem.truncation(point)
    below = below_with(problem, point, np.zeros_like(at.plain()))
    return Resistances.of(below, below.certificate_matrix(below.multipliers(point)), at)
