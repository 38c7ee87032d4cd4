"""g2o's chi2: EdgeSE2 and EdgeSE3:QUAT with full information matrices.

The residual is y, then the angle of E in the plane, or the vector part b of its unit quaternion
(w, b), w >= 0, in space.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.graph.information import RotationAbout
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, arctan2, crossed, sums
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.g2o_plane import minorants_in_the_plane
from certpgo.objective.g2o_space import minorants_in_space, quaternions
from certpgo.objective.marginalized import blocks, is_isotropic, isotropic, lowered
from certpgo.objective.minorants import Minorants

#: Share of the sum of the two smaller eigenvalues of W to which the largest is clipped.
CLIPPED = 0.999
#: The largest may exceed what it is clipped to by this share, for rounding.
NEARLY = 1e-4


@dataclass(frozen=True, eq=False)
class G2oCost(EdgeCost):
    """g2o's chi2 of EdgeSE2 or EdgeSE3:QUAT.

    Examples
    --------
    One edge whose second pose is a centimetre and 0.1 radians from where it was measured:

    >>> import numpy as np
    >>> from certpgo import PoseGraph, RotationGraph
    >>> from certpgo.graph.information import Information
    >>> rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.ones(1))
    >>> graph = PoseGraph(rotation, np.zeros((1, 2)), np.ones(1))
    >>> stated = Information.of(np.diag([100.0, 100.0, 4.0])[None])
    >>> cost = G2oCost(graph.with_information(stated))
    >>> Q = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])[None]
    >>> print(cost.costs(np.array([[0.01, 0.0]]), Q).round(6))  # 100 0.01^2 + 4 0.1^2
    [0.05]
    """

    name: ClassVar[str] = "g2o"
    compiled_residual: ClassVar[str] = "quaternion"
    provable: ClassVar[bool] = True
    rotation_information: ClassVar[RotationAbout] = "quaternion"

    @property
    def turned_share(self) -> float:
        """a^2 >= 4 sin^2(a/2) in the plane, |b|^2 = sin^2(a/2) in space, of 8 sin^2(a/2)."""
        return 0.5 if self.graph.d == 2 else 0.125

    @property
    def title(self) -> str:
        """The cost in the words of g2o's users."""
        kind = "EdgeSE2" if self.graph.d == 2 else "EdgeSE3:QUAT"
        return f"g2o's chi2 of {kind} with full information"

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, p) residuals: y in metres, then an angle or the vector part of a quaternion."""
        y, E = self.unexplained(v, Q)
        turned = so.log(E) if self.graph.d == 2 else quaternions(E)[:, 1:]
        return np.concatenate([y, turned], axis=1)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `EdgeCost.linearized`."""
        y, E = self.unexplained(v, Q)
        m, d = y.shape
        p, q = d * (d + 1) // 2, so.tangent_dim(d)
        in_v, in_w = np.zeros((m, p, d)), np.zeros((m, p, q))
        in_v[:, :d] = np.swapaxes(self.graph.rotations, 1, 2)
        if d == 2:
            turned, in_w[:, d:] = so.log(E), 1.0
        else:
            quaternion = quaternions(E)
            turned = quaternion[:, 1:]
            in_w[:, d:] = 0.5 * (quaternion[:, :1, None] * np.eye(3) + so.hat(turned))
        return np.concatenate([y, turned], axis=1), in_v, in_w

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""
        measured, d = self.measured, self.graph.d
        y, E = measured.T.apply(v - self.graph.translations), measured.T @ Q
        T, P, W = blocks(self.graph.information_matrices, d)
        if d == 2:
            x = arctan2(E[:, 1, 0] - E[:, 0, 1], E[:, 0, 0] + E[:, 1, 1])[:, None]
            cross = 2.0 * y.dot(_times(P, x))
        else:
            x, sure = _vector_parts(E)
            cross = 2.0 * y.dot(_times(P, x))
            # With w near zero, the vector part may also be -x.
            cross = Ball(np.where(sure, cross.mid, 0.0), np.where(sure, cross.radius, cross.size))
        return y.dot(_times(T, y)) + cross + x.dot(_times(W, x))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding.

        None where the information is not positive definite; or, in the plane, where the slope in
        the angle is too large for what the translations leave of its information.
        """
        minorants = minorants_in_the_plane if self.graph.d == 2 else minorants_in_space
        # What is not finite is no minorant.
        with np.errstate(all="ignore"):
            return minorants(self.graph, self.measured, *self.unexplained(v, Q))

    def relaxed(self) -> G2oCost | None:
        """Without cross terms, and in space with the largest eigenvalue of W below the others' sum.

        It has minorants everywhere, each with a semidefinite K. If this is such a cost, with
        isotropic translations, whose minorants are the same everywhere.
        """
        T, P, W = blocks(self.graph.information_matrices, self.graph.d)
        flat = _unchanged if self.graph.d == 2 else _clipped
        spoiled = P.any(axis=(1, 2)) | (flat(W) != W).any(axis=(1, 2))
        if spoiled.any():
            return self.on(lowered(self.graph, spoiled, lambda T, W: (T, flat(W))))
        return self.on(lowered(self.graph, ~is_isotropic(T), lambda T, W: (isotropic(T), W)))


def _unchanged(W: FloatArray) -> FloatArray:
    return W


def _times(A: FloatArray, x: Ball) -> Ball:
    return Ball.exact(A).apply(x)


def _clipped(W: FloatArray) -> FloatArray:
    """Matrices (m, 3, 3) nowhere above W, their largest eigenvalue below the sum of the others."""
    values, vectors = np.linalg.eigh(W)
    # Below the second, that would be the largest.
    most = np.maximum(CLIPPED * (values[:, 0] + values[:, 1]), values[:, 1])
    excess = np.where(values[:, 2] > (1.0 + NEARLY) * most, values[:, 2] - most, 0.0)
    steepest = np.sqrt(excess)[:, None] * vectors[:, :, 2]
    return np.asarray(W - steepest[:, :, None] * steepest[:, None, :])


def _vector_parts(E: Ball) -> tuple[Ball, FloatArray]:
    """Vector parts b (m, 3) of unit quaternions of E, w >= 0, and where their sign is sure.

    For unit quaternions of rotations E and E', one of |q - q'| and |q + q'| is at most
    |E - E'| / 2 in the Frobenius norm.
    """
    q = quaternions(so.project(E.mid))
    exact = Ball.exact(q)
    w, b = exact[:, 0], exact[:, 1:]
    norm = sums(exact * exact)
    square = (w * w - sums(b * b))[:, None, None] * np.eye(3)
    there = square + 2.0 * (b[:, :, None] * b[:, None, :]) + 2.0 * w[:, None, None] * crossed(b)
    apart = (E * norm[:, None, None] - there).reshaped(-1, 9)
    distance = sums(apart * apart).sqrt().upper
    radius = 0.51 * distance + 2.0 * np.abs(norm.mid - 1.0) + 1e-15
    return Ball.within(q[:, 1:], radius[:, None]), np.asarray(q[:, 0] > radius)


COST = G2oCost
