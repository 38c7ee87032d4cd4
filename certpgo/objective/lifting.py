"""What points of the relaxation rise into: more real dimensions, or complex ones in the plane.

In the plane a rotation is a unit complex number z, and R m = z m. A relaxation has unit vectors z
of C^k and positions in C^k; in real terms, for J the quarter turn of every complex coordinate,
blocks [u, Ju] of St(2k, 2). As J R m = R J m,

    F = tr(E M E^T)  for  E_i = [t_i, J t_i, u_i, J u_i],

with half the weight on either position: M has two rows for each. Since all points of this
relaxation are points of the one over St(r, 2), its minimum is never lower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.graph.relaxed_point import Lift
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import BlockPattern, scatter_sum
from certpgo.objective import operators
from certpgo.objective.manifolds import POSE, Manifold

#: A quarter turn of the plane.
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Lifting:
    """How poses and positions continue above d dimensions.

    Attributes
    ----------
    dimensions : by which points of the relaxation rise
    pose : the manifold of the poses' blocks
    data_matrix : (pattern, form, its sums at nodes) -> M, (N, N)
    position_rows : (n, r) -> (n, p, r), what translations are in the p rows of positions in M
    frames : (r, d) orthonormal basis of a subspace -> frames of it, one of each handedness
    rising : (n, b) rows of the certificate matrix -> the move into new dimensions along them
    """

    dimensions: int
    pose: Manifold
    data_matrix: Callable[[BlockPattern, Any, operators.NodeSums], CSC]
    position_rows: Callable[[FloatArray], FloatArray]
    frames: Callable[[FloatArray], tuple[FloatArray, ...]]
    rising: Callable[[FloatArray, int], Lift]


def quarter_turn(x: FloatArray) -> FloatArray:
    """J x for vectors (..., 2k): i times each complex coordinate."""
    pairs = x.reshape(*x.shape[:-1], -1, 2)
    return np.stack([-pairs[..., 1], pairs[..., 0]], axis=-1).reshape(x.shape)


def _of_each_handedness(basis: FloatArray) -> tuple[FloatArray, ...]:
    return basis, basis * np.r_[-1.0, np.ones(basis.shape[1] - 1)]


def _rows(t: FloatArray) -> FloatArray:
    return t[:, None]


def _rising_row(rows: FloatArray, d: int) -> Lift:
    """Rows are the first coordinates of [t, R] in one dimension."""
    return Lift(rows[:, None, -d:], rows[:, :1])


def _data_matrix_of_pairs(pattern: BlockPattern, graph: Any, sums: operators.NodeSums) -> CSC:
    """M, (N, N), with four rows for poses and two for points."""
    n, (i, j), half = graph.num_nodes, graph.edges.T, 0.5 * graph.tau
    of_positions, columns = np.eye(2), np.swapaxes(_pairs(graph.translations), 1, 2)
    lever = half[:, None, None] * columns
    first = scatter_sum(i, lever, n)
    second = scatter_sum(i, half * (graph.translations**2).sum(axis=1), n)
    degrees = operators.degrees(graph.edges, half, n)
    upper = np.zeros((graph.num_edges, 4, 4))
    upper[:, :2, :2] = -half[:, None, None] * of_positions
    upper[:, 2:, :2] = -lever
    upper[:, 2:, 2:] = -_turning(graph.coupled)
    if graph.arms is not None:
        arms = _pairs(graph.arms)
        first += scatter_sum(j, half[:, None, None] * np.swapaxes(arms, 1, 2), n)
        second += scatter_sum(j, half * (graph.arms**2).sum(axis=1), n)
        upper[:, :2, 2:] = -half[:, None, None] * arms
        upper[:, 2:, 2:] -= lever @ arms
    diagonal = np.zeros((n, 4, 4))
    diagonal[:, :2, :2] = degrees[:, None, None] * of_positions
    diagonal[:, 2:, :2] = first
    diagonal[:, :2, 2:] = np.swapaxes(first, 1, 2)
    diagonal[:, 2:, 2:] = _turning(operators.spread(graph)) + second[:, None, None] * of_positions
    return pattern.assemble(diagonal, upper, 2)


def _pairs(t: FloatArray) -> FloatArray:
    """(n, 2, r) t and Jt."""
    return np.stack([t, quarter_turn(t)], axis=1)


def _turning(A: FloatArray) -> FloatArray:
    """(n, 2, 2) the part of matrices that commutes with J: of rotations, all that costs."""
    return np.asarray(0.5 * (A + J @ A @ J.T))


def _complex_multipliers(Lam: FloatArray) -> FloatArray:
    """(n, 2, 2) multiples of the identity: a unit complex vector has one constraint."""
    half = 0.5 * np.trace(Lam, axis1=1, axis2=2)
    return np.asarray(half[:, None, None] * np.eye(2))


def _complex_tangents(Y: FloatArray) -> FloatArray:
    """(n, q, r, 2) orthonormal [v, Jv] / sqrt(2), for v orthogonal to u."""
    u = Y[:, :, :1]
    v = np.swapaxes(np.linalg.qr(u, mode="complete")[0][:, :, 1:], 1, 2)
    return np.asarray(np.stack([v, quarter_turn(v)], axis=3) / np.sqrt(2.0))


def _complex_dim(r: int, d: int) -> int:
    return r - 1


def _of_complex_line(basis: FloatArray) -> tuple[FloatArray, ...]:
    """The frame [b, Jb] of the complex line of the first vector b of a basis."""
    first = basis[:, 0]
    return (np.stack([first, quarter_turn(first)], axis=1),)


def _rising_line(rows: FloatArray, d: int) -> Lift:
    """Rows are the first coordinates of [t, Jt, u, Ju] in one complex dimension."""
    conjugate = np.array([1.0, -1.0])
    t, u = conjugate * rows[:, :2], conjugate * rows[:, 2:]
    return Lift(np.stack([u, quarter_turn(u)], axis=2), t)


#: The dimensions of space and more, each by itself.
REAL = Lifting(
    1,
    POSE,
    operators.data_matrix,
    _rows,
    _of_each_handedness,
    _rising_row,
)
#: In the plane: lifted rotations stay proper.
COMPLEX = Lifting(
    2,
    Manifold(
        "poses over complex numbers",
        _complex_tangents,
        _complex_dim,
        POSE.nearest,
        POSE.rounded,
        _complex_multipliers,
        POSE.admissible,
        POSE.proven,
    ),
    _data_matrix_of_pairs,
    _pairs,
    _of_complex_line,
    _rising_line,
)
