"""Rigorous bounds on F of a stored estimate, accounting for rounding.

The data are the rotations nearest to the stored matrices, and the stored translations and weights.
Valid for round-to-nearest IEEE 754 doubles.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.so import rotation_defect
from certpgo.objective.problem import PoseProblem, Problem

U = float(np.finfo(float).eps) / 2


def cost_upper(problem: Problem, estimate: Estimate) -> float:
    """An upper bound on F of the estimate, whose translations are taken as stored."""
    weights, sizes, errors = _residuals(problem, estimate)
    terms = weights * (sizes * (1.0 + 32.0 * U) + errors) ** 2
    return float(np.sum(terms) * (1.0 + _of_a_sum(terms)))


def cost_lower(problem: Problem, estimate: Estimate) -> float:
    """A lower bound on F of the estimate, also for quaternions rounded from its rotations."""
    weights, sizes, errors = _residuals(problem, estimate)
    terms = weights * np.maximum(sizes * (1.0 - 32.0 * U) - 2.0 * errors, 0.0) ** 2
    return float(np.sum(terms) * (1.0 - _of_a_sum(terms)))


def _residuals(problem: Problem, estimate: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, computed norms and their absolute errors, of rotations, then of translations."""
    graph = problem.rotation.graph
    E = problem.rotation.residuals(estimate.rotations)
    norm = np.sqrt(np.einsum("mab,mab->m", E, E))
    # R_j - R_i R_ij: three matrices near rotations, and a product of d terms.
    own, measured = rotation_defect(estimate.rotations), rotation_defect(graph.rotations)
    error = np.full(len(norm), 2.0 * own + measured + 32.0 * U)
    if not isinstance(problem, PoseProblem) or estimate.translations is None:
        return graph.kappa, norm, error
    r = np.linalg.norm(problem.translation_residuals(estimate), axis=1)
    # The rounding of t_j - t_i is relative to its size, at most r plus the lever.
    lever = np.linalg.norm(problem.graph.translations, axis=1)
    weights = np.concatenate([graph.kappa, problem.graph.tau])
    errors = np.concatenate([error, (own + 32.0 * U) * lever])
    return weights, np.concatenate([norm, r]), errors


def _of_a_sum(terms: FloatArray) -> float:
    # A few roundings within each term, and at most one per term in the sum, in any order.
    return (len(terms) + 16) * 2.0 * U
