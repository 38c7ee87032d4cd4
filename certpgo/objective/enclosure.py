"""Rigorous bounds on F of a stored estimate, accounting for rounding.

The data are the rotations nearest to the stored matrices, and the stored translations and weights.
Valid for round-to-nearest IEEE 754 doubles.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective import operators
from certpgo.objective.edge_sums import EdgeSums


def enclosure(graph: Graph, estimate: Estimate) -> tuple[float, float]:
    """Lower and upper bounds on F of the estimate, whose measurements need not connect the nodes.

    The lower bound also holds for quaternions rounded from the estimate's rotations.
    """
    if graph.is_general:
        terms, errors = _general(graph, estimate)
        cost = float(terms.sum())
        error = 1.001 * float(errors.sum() + _of_a_sum(terms) * np.abs(terms).sum())
        return max(cost - 2.0 * error, 0.0), cost + error
    low, high = _terms(graph, estimate)
    return (
        float(np.sum(low) * (1.0 - _of_a_sum(low))),
        float(np.sum(high) * (1.0 + _of_a_sum(high))),
    )


def edge_enclosures(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """(m,) lower and upper bounds on the edges' terms, for isotropic weights."""
    # At most two terms, each of few roundings.
    if graph.is_general:
        terms, errors = (
            of.reshape(-1, graph.num_edges).sum(axis=0) for of in _general(graph, estimate)
        )
        errors = 1.001 * (errors + 32.0 * U * np.abs(terms))
        return np.maximum(terms - 2.0 * errors, 0.0), terms + errors
    low, high = (of.reshape(-1, graph.num_edges) for of in _terms(graph, estimate))
    return low.sum(axis=0) * (1.0 - 32.0 * U), high.sum(axis=0) * (1.0 + 32.0 * U)


def _terms(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Bounds on the terms of rotations, then of translations, up to a few roundings."""
    weights, sizes, errors = _residuals(graph, estimate)
    least = np.maximum(sizes * (1.0 - 32.0 * U) - 2.0 * errors, 0.0)
    high = weights * (sizes * (1.0 + 32.0 * U) + errors) ** 2
    return weights * least**2, high


def _residuals(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, computed norms and their absolute errors, of rotations, then of translations."""
    norm, r = EdgeSums(graph).residuals(estimate)
    # R_j - R_i R_ij: three matrices near rotations, and a product of d terms.
    own, measured = rotation_defect(estimate.rotations), rotation_defect(graph.rotations)
    error = np.full(len(norm), 2.0 * own + measured + 32.0 * U)
    if not graph.has_positions or r is None:
        return graph.kappa, norm, error
    # The rounding of t_j - t_i is relative to its size, at most r plus the lever.
    lever = _levers(graph)
    weights = np.concatenate([graph.kappa, graph.tau])
    errors = np.concatenate([error, (own + 32.0 * U) * lever])
    return weights, np.concatenate([norm, r]), errors


def _general(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Terms of rotations, then of translations, of edges with couplings or arms; their errors.

    Up to few roundings of the terms.
    """
    _, K, _ = graph.polar
    nuclear = np.trace(K, axis1=1, axis2=2)
    own = rotation_defect(estimate.rotations)
    E = operators.rotation_residuals(graph, estimate.rotations)
    size = np.sqrt(np.einsum("mab,mab->m", E, E))
    # Residuals are off by `off`; the polar factors reproduce the couplings up to rounding.
    off = 2.0 * own + 64.0 * U
    errors = nuclear * (2.0 * off * size + off**2 + 64.0 * U)
    terms = np.einsum("mab,mab->m", E @ K, E)
    if graph.has_positions and estimate.translations is not None:
        r = np.linalg.norm(operators.translation_residuals(graph, estimate), axis=1)
        off = (own + 32.0 * U) * _levers(graph) + 32.0 * U * r
        terms = np.concatenate([terms, graph.tau * r**2])
        errors = np.concatenate([errors, graph.tau * off * (2.0 * r + off)])
    return terms, errors


def _levers(graph: Graph) -> FloatArray:
    """(m,) lengths of the levers from i to j and of the arms at j, together."""
    lever = np.linalg.norm(graph.translations, axis=1)
    arms = 0.0 if graph.arms is None else np.linalg.norm(graph.arms, axis=1)
    return np.asarray(lever + arms)


def _of_a_sum(terms: FloatArray) -> float:
    # A few roundings within each term, and at most one per term in the sum, in any order.
    return (len(terms) + 16) * 2.0 * U
