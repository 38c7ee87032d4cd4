"""Quantiles of the terms of F under the noise that the weights state."""

from __future__ import annotations

import itertools

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
    axes = np.full(so.tangent_dim(problem.d), 2.0 if problem.d == 2 else 1.0)
    found = np.empty(len(turned))
    for whether in itertools.product((False, True), repeat=2):
        chosen = (turned == whether[0]) & (moved == whether[1])
        if chosen.any():
            terms = np.r_[axes[: len(axes) * whether[0]], np.ones(problem.d * whether[1])]
            unit = float((terms**2).sum() / terms.sum())
            half = 0.5 * float(terms.sum()) / unit  # of the degrees of freedom
            found[chosen] = unit * 2.0 * special.gammaincinv(half, probability)
    return found


def measured(problem: Problem) -> tuple[BoolArray, BoolArray]:
    """(m,) which edges measure a rotation, and which a translation."""
    return problem.graph.measures_rotation, problem.graph.measures_translation
