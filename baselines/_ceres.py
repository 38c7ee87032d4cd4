"""Residuals of Ceres' pose-graph examples, as cost functions in Python.

pyceres binds none of them. Of an edge they are R_i^T (t_j - t_i) - t_ij = R_ij y, then in the plane
the angle, in space twice the vector part of q_ij q_j^* q_i, which is -2 R_ij b, with y and b as in
`_chi_squared`; unlike there, with its real part at least zero, so that it is of the rotations.
Information about y and b is carried over, so that the cost is half of chi^2.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.g2o_space import quaternions as with_w_first

from ._programs import CERES


def roots(graph: Graph, information: FloatArray) -> FloatArray:
    """(m, p, p) matrices A with |A e|^2 = chi^2 for residuals e of the examples."""
    d = graph.d
    stated = np.diagonal(information, axis1=1, axis2=2) != 0.0
    unit = np.where(stated, 0.0, 1.0)[:, :, None] * np.eye(information.shape[1])
    A = np.swapaxes(np.linalg.cholesky(information + unit), 1, 2) - unit
    back = np.swapaxes(graph.rotations, 1, 2)
    A[:, :, :d] = A[:, :, :d] @ back
    if d == 3:
        A[:, :, 3:] = -0.5 * A[:, :, 3:] @ back
    return A


def cost_functions(graph: Graph, information: FloatArray) -> list[Any]:
    """A cost function for each edge, of the parameter blocks of its poses."""
    A, t = roots(graph, information), graph.translations
    if graph.d == 2:
        kind, measured = _in_the_plane(), so.log(graph.rotations)[:, 0].tolist()
    else:
        kind = _in_space()
        q = quaternions(graph.rotations)
        measured = np.einsum("kce,mc,efa,fb->mkab", PRODUCT, q, PRODUCT, CONJUGATE)
    return [kind(*one) for one in zip(A, t, measured, strict=True)]


def quaternions(R: FloatArray) -> FloatArray:
    """(n, 4) unit quaternions x y z w of rotations in space."""
    return np.roll(with_w_first(R), -1, axis=1)


def rotations(q: FloatArray) -> FloatArray:
    """(n, 3, 3) rotations of unit quaternions x y z w."""
    return np.einsum("klab,na,nb->nlk", ROTATED, q, q)


def _product() -> FloatArray:
    """(4, 4, 4) P with (p q)_k = P_kab p_a q_b."""
    P = np.zeros((4, 4, 4))
    P[3] = np.diag([-1.0, -1.0, -1.0, 1.0])
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        P[k, i, j], P[k, j, i], P[k, 3, k], P[k, k, 3] = 1.0, -1.0, 1.0, 1.0
    return P


def _rotated() -> FloatArray:
    """(3, 3, 4, 4) symmetric forms: entry (k, l) of R(q)^T is q^T of these q."""
    forms = np.einsum("lce,cak,eb->klab", PRODUCT[:3], PRODUCT[:, :, :3], CONJUGATE)
    return 0.5 * (forms + np.swapaxes(forms, 2, 3))


PRODUCT, CONJUGATE = _product(), np.diag([-1.0, -1.0, -1.0, 1.0])
ROTATED = _rotated()


@cache
def _in_the_plane() -> Any:
    """The class of cost functions of two blocks (x, y, angle)."""

    class InThePlane(CERES.library().CostFunction):  # type: ignore[misc]
        def __init__(self, A: FloatArray, t: FloatArray, turned: float) -> None:
            super().__init__()
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([3, 3])
            self.A, self.t, self.turned = A, t.tolist(), turned

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            (xi, yi, ai), (xj, yj, aj) = parameters[0].tolist(), parameters[1].tolist()
            c, s, x, y = math.cos(ai), math.sin(ai), xj - xi, yj - yi
            u, v = c * x + s * y, c * y - s * x
            turn = math.remainder(aj - ai - self.turned, 2.0 * math.pi)
            residuals[:] = self.A @ [u - self.t[0], v - self.t[1], turn]
            if jacobians is not None:
                of_i = [[-c, -s, v], [s, -c, -u], [0.0, 0.0, -1.0]]
                of_j = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]
                for out, of_block in zip(jacobians, (of_i, of_j), strict=True):
                    if out is not None:
                        out[:] = (self.A @ of_block).ravel()
            return True

    return InThePlane


@cache
def _in_space() -> Any:
    """The class of cost functions of four blocks: position and quaternion of each pose."""

    class InSpace(CERES.library().CostFunction):  # type: ignore[misc]
        def __init__(self, A: FloatArray, t: FloatArray, turned: FloatArray) -> None:
            super().__init__()
            self.set_num_residuals(6)
            self.set_parameter_block_sizes([3, 4, 3, 4])
            self.A, self.t, self.turned = A, t, 2.0 * turned

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            ti, qi, tj, qj = parameters
            half, moved, turn = ROTATED @ qi, tj - ti, self.turned @ qj
            *vector, real = turn @ qi
            back, A = half @ qi, self.A[:, :3]
            B = self.A[:, 3:] if real >= 0.0 else -self.A[:, 3:]
            residuals[:] = A @ (back @ moved - self.t) + B @ vector
            if jacobians is not None:
                of_tj = A @ back
                of_qi = A @ (2.0 * moved @ half) + B @ turn[:3]
                blocks = (-of_tj, of_qi, of_tj, B @ (qi @ self.turned[:3]))
                for out, of_block in zip(jacobians, blocks, strict=True):
                    if out is not None:
                        out[:] = of_block.ravel()
            return True

    return InSpace
