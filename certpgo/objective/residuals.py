"""Sizes and numbers of residuals, in NumPy."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective import operators

#: Singular values of couplings, over the largest, below which a direction is not measured.
NONE = 1e-12


def residual_angles(graph: Graph, R: FloatArray) -> FloatArray:
    """(m,) angles between R_i R_ij and R_j, radians; 0 where no rotation is measured."""
    i, j = graph.edges.T
    angles = so.angle(np.swapaxes(R[j], 1, 2) @ R[i] @ graph.rotations)
    return np.where(graph.measures_rotation, angles, 0.0)


def residual_norms(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray | None]:
    """(m,) norms of R_j - R_i R_ij, and those of t_j - t_i - R_i t_ij if there are translations."""
    E = operators.rotation_residuals(graph, estimate.rotations)
    turned = np.sqrt(np.einsum("mab,mab->m", E, E))
    if not graph.has_positions or estimate.translations is None:
        return turned, None
    return turned, np.linalg.norm(operators.translation_residuals(graph, estimate), axis=1)


def numbers(graph: Graph) -> tuple[IntArray, IntArray]:
    """(m,) how many numbers each edge measures of a rotation, and of a translation."""
    # One direction, of rank 1, leaves turns about it; two leave none.
    ranks, d = _ranks(graph), graph.d
    turned = np.where(ranks == 1, d - 1, so.tangent_dim(d) * (ranks > 0))
    return turned, d * graph.measures_translation


def double(graph: Graph) -> IntArray:
    """(m,) how often the square of a turn counts: twice for kappa |E|^2 in the plane."""
    if graph.d == 3:
        return np.ones(graph.num_edges, dtype=np.intp)
    return np.maximum(_ranks(graph), 1)


def _ranks(graph: Graph) -> IntArray:
    """(m,) how many axes of the world the nodes see by each edge's rotation."""
    if graph.couplings is None:
        return graph.d * graph.measures_rotation
    return np.asarray(np.linalg.matrix_rank(graph.couplings, rtol=NONE))
