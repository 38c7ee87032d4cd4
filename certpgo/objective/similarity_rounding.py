"""Bounds on the rounding of costs and certificate matrices over similarities.

The data are the rotations nearest to the stored matrices, and the stored numbers.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.relaxed_point import Lift
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import BlockPattern, scatter_sum
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective import operators


def enclosure(
    graph: Graph, form: Graph, point: Lift, scales: FloatArray, own: float
) -> tuple[float, float]:
    """Lower and upper bounds on F of stored rotations, scales and translations.

    The lower bound also holds for quaternions rounded from the rotations.

    Parameters
    ----------
    form : the measurements as edges whose residuals are A_j - A_i s_ij R_ij
    point, scales : blocks A_i with the translations, and (n,) s_i
    own : how far the stored rotations are from SO(d)
    """
    s, (i, j) = scales, graph.edges.T
    measured = rotation_defect(graph.rotations)
    E = operators.rotation_residuals(form, point.rotations)
    r = operators.translation_residuals(form, point)
    sizes = np.concatenate([np.linalg.norm(E, axis=(1, 2)), np.linalg.norm(r, axis=1)])
    turned = (own + 32.0 * U) * s[j] + (own + measured + 32.0 * U) * graph.scales * s[i]
    # The rounding of t_j - t_i is relative to its size, at most r plus the lever.
    moved = (own + 32.0 * U) * s[i] * np.linalg.norm(graph.translations, axis=1)
    errors = np.concatenate([turned, moved])
    weights = np.concatenate([graph.kappa, graph.tau])
    low = weights * np.maximum(sizes * (1.0 - 32.0 * U) - 2.0 * errors, 0.0) ** 2
    high = weights * (sizes * (1.0 + 32.0 * U) + errors) ** 2
    # A few roundings within each term, and at most one per term in the sum, in any order.
    of_sum = (len(low) + 16) * 2.0 * U
    return float(low.sum() * (1.0 - of_sum)), float(high.sum() * (1.0 + of_sum))


def entry_errors(
    graph: Graph, pattern: BlockPattern, multipliers: FloatArray, w: FloatArray
) -> FloatArray:
    """(N,) row sums of the rounding in S's entries, weighted by w.

    An entry that sums k products is off by at most k + 8 units of rounding of the sum of their
    sizes, plus the distance of measured rotations from SO(d).
    """
    n, d, (i, j) = graph.num_nodes, graph.d, graph.edges.T
    kappa, tau, s = graph.kappa, graph.tau, graph.scales
    t = np.abs(graph.translations)
    diagonal = np.zeros((n, d + 1, d + 1))
    diagonal[:, 0, 0] = operators.degrees(graph.edges, tau, n)
    diagonal[:, 0, 1:] = diagonal[:, 1:, 0] = scatter_sum(i, tau[:, None] * t, n)
    second = scatter_sum(i, tau[:, None, None] * t[:, :, None] * t[:, None, :], n)
    turning = scatter_sum(i, kappa * s**2, n) + scatter_sum(j, kappa, n)
    diagonal[:, 1:, 1:] = second + turning[:, None, None] * np.eye(d) + np.abs(multipliers)
    upper = np.zeros((graph.num_edges, d + 1, d + 1))
    upper[:, 0, 0] = tau
    upper[:, 1:, 0] = tau[:, None] * t
    defect = rotation_defect(graph.rotations) / (8.0 * U)
    upper[:, 1:, 1:] = (kappa * s)[:, None, None] * (np.abs(graph.rotations) + defect)
    sums = np.bincount(graph.edges.ravel(), minlength=n) + 8.0
    A = pattern.assemble(diagonal, upper, 1)
    rows = np.tile(sums[:, None], (1, d + 1))
    return np.asarray(1.001 * U * pattern.layout_of(A).pack(rows) * (A @ w))
