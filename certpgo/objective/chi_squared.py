"""Quantiles of the terms of F under the noise that the weights state."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from scipy import special

from certpgo.graph.information import unmeasured
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.problem import Problem

#: Share of clean graphs in which a correct measurement may be flagged.
FALSE_ALARMS = 0.01


def flagged_from(problem: Problem | InformationProblem) -> float:
    """The quantile that few clean graphs have a correct measurement beyond: 1 - 0.01 / m."""
    return 1.0 - FALSE_ALARMS / problem.graph.num_edges


def quantiles(problem: Problem | InformationProblem, probability: float) -> FloatArray:
    """(m,) quantiles of an inlier's r_e^2, if the weights state its noise.

    A rotation contributes the square of a normal variable per axis, twice that in 2D, where
    kappa |E|^2 is 2 kappa times the squared angle and kappa the angle's information; a translation
    contributes d squares. The sum is approximated by a multiple of a chi-square variable of the
    same mean and variance (Welch and Satterthwaite), exactly except for poses in 2D. The costs of
    other programs are chi^2 itself.
    """
    if isinstance(problem, InformationProblem):
        numbers = (~unmeasured(problem.edge_cost.weights)).sum(axis=1)
        return np.asarray(2.0 * special.gammaincinv(0.5 * numbers, probability))
    turned, moved = measured(problem)
    kinds = itertools.product((False, True), repeat=2)
    of_kinds = np.array([_quantile(problem.d, *kind, probability) for kind in kinds])
    return np.asarray(of_kinds[2 * turned + moved])


@lru_cache
def _quantile(d: int, turned: bool, moved: bool, probability: float) -> float:
    """That of a measurement of a rotation, a translation, or both."""
    axes = so.tangent_dim(d) * [2.0 if d == 2 else 1.0] if turned else []
    terms = np.array(axes + d * [1.0] if moved else axes)
    if not len(terms):
        return 0.0
    unit = float((terms**2).sum() / terms.sum())
    half = 0.5 * float(terms.sum()) / unit  # of the degrees of freedom
    return unit * 2.0 * float(special.gammaincinv(half, probability))


def measured(problem: Problem) -> tuple[BoolArray, BoolArray]:
    """(m,) which edges measure a rotation, and which a translation."""
    return problem.graph.measures_rotation, problem.graph.measures_translation
