"""Sizes of residuals, in NumPy."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective import operators


def residual_angles(graph: Graph, R: FloatArray) -> FloatArray:
    """(m,) angles between R_i R_ij and R_j, radians; 0 where no rotation is measured."""
    (i, j) = graph.edges.T
    angles = so.angle(np.swapaxes(R[j], 1, 2) @ R[i] @ graph.rotations)
    return np.where(graph.measures_rotation, angles, 0.0)


def residual_norms(graph: Graph, estimate: Estimate) -> tuple[FloatArray, FloatArray | None]:
    """(m,) norms of R_j - R_i R_ij, and those of t_j - t_i - R_i t_ij if there are translations."""
    E = operators.rotation_residuals(graph.rotations_alone, estimate.rotations)
    turned = np.sqrt(np.einsum("mab,mab->m", E, E))
    if not graph.has_positions or estimate.translations is None:
        return turned, None
    return turned, np.linalg.norm(operators.translation_residuals(graph, estimate), axis=1)
