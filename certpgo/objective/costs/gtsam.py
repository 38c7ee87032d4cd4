"""GTSAM's cost: BetweenFactor<Pose2> and BetweenFactor<Pose3> with full information matrices.

The residual is the logarithm of measured^-1 between in SE(d), here ordered translation first:
(u, omega) with omega = Log E, E = R~^T Q, and

    u = V^-1 y = y - omega x y / 2 + c(theta) omega x (omega x y),    theta = |omega| <= pi,
    c(theta) = (1 - (theta/2) cot(theta/2)) / theta^2,

as of GTSAM 4.3 (other builds may use other charts). The cost e^T Omega e is twice GTSAM's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, crossed, joined, near_rotations
from certpgo.objective.angle_functions import (
    exponential,
    half_cotangent,
    half_cotangent_slopes,
    half_cotangents,
)
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.gtsam_plane import minorants_in_the_plane
from certpgo.objective.gtsam_space import minorants_in_space
from certpgo.objective.marginalized import blocks, is_isotropic, isotropic, lowered
from certpgo.objective.minorants import Minorants


@dataclass(frozen=True, eq=False)
class GtsamCost(EdgeCost):
    """Twice GTSAM's error of BetweenFactor<Pose2> or BetweenFactor<Pose3>.

    Examples
    --------
    One edge whose second pose is a centimetre and 0.1 radians from where it was measured:

    >>> import numpy as np
    >>> from certpgo import PoseGraph, RotationGraph
    >>> from certpgo.graph.information import Information
    >>> rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.ones(1))
    >>> graph = PoseGraph(rotation, np.zeros((1, 2)), np.ones(1))
    >>> stated = Information.of(np.diag([100.0, 100.0, 4.0])[None])
    >>> cost = GtsamCost(graph.with_information(stated))
    >>> Q = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])[None]
    >>> print(cost.costs(np.array([[0.01, 0.0]]), Q).round(6))  # 0.01^2 + 4 0.1^2 + 8e-6
    [0.050008]
    """

    name: ClassVar[str] = "gtsam"
    compiled_residual: ClassVar[str] = "logarithm"

    @property
    def turned_share(self) -> float:
        """The squared angle is at least 4 sin^2(a/2), of 8 sin^2(a/2); and |V^-1 y| >= |y|."""
        return 0.5

    @property
    def title(self) -> str:
        """The cost in the words of GTSAM's users."""
        kind = "Pose" if self.graph.has_positions else "Rot"
        return (
            f"twice GTSAM's error of BetweenFactor{kind}{self.graph.d} (full logarithm) "
            "with full information"
        )

    @cached_property
    def measured(self) -> Ball:
        """(m, d, d) the rotations nearest to the measured matrices, in wide balls."""
        return near_rotations(self.graph.rotations)

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, p) residuals: u in metres, then a rotation vector."""
        y, E = self.unexplained(v, Q)
        omega = so.log(E)
        u = _inverse_jacobians(omega, so.hat(omega)) @ y[:, :, None]
        return np.concatenate([u[:, :, 0], omega], axis=1)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `EdgeCost.linearized`.

        E moves to E exp(w), hence omega by the inverse right Jacobian, in space the transpose of
        V^-1, and u by the product rule.
        """
        y, E = self.unexplained(v, Q)
        omega = so.log(E)
        hat, (m, d), q = so.hat(omega), y.shape, omega.shape[1]
        left = _inverse_jacobians(omega, hat)
        right = np.swapaxes(left, 1, 2) if d == 3 else np.ones((m, 1, 1))
        in_v, in_w = np.zeros((m, d + q, d)), np.empty((m, d + q, q))
        in_v[:, :d] = left @ np.swapaxes(self.graph.rotations, 1, 2)
        in_w[:, :d] = _in_omega(omega, hat, y) @ right
        in_w[:, d:] = right
        u = (left @ y[:, :, None])[:, :, 0]
        return np.concatenate([u, omega], axis=1), in_v, in_w

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q).

        E is compared with the exponential of a computed logarithm. Rotations ||E - E'||_F apart are
        an angle phi = 2 arcsin(||E - E'||_F / 8^(1/2)) apart, and then so are their logarithms, by
        at most phi times the largest norm (theta/2) / sin(theta/2) of the logarithm's derivative,
        which is below 1.6 up to pi + 0.05. What passes pi is continued, and turned back by 2 pi.
        """
        back = self.measured.T
        y, E = back.apply(v - self.graph.translations), back @ Q
        log = so.log(so.project(E.nearest))
        apart = E - exponential(Ball.exact(log).widened)
        distance = np.sqrt(np.sum(apart.size**2, axis=(1, 2)).astype(np.float64))
        # 1.6 phi, as arcsin(t) <= 1.12 t for t <= 0.7.
        radius = np.where(distance <= 0.03, 1.27 * distance, np.inf)[:, None]
        omega = Ball.within(log, np.broadcast_to(radius, log.shape)).widened
        costs = self._costs(y, omega, np.arange(len(log)))
        beyond = np.linalg.norm(log, axis=1) + radius[:, 0] >= np.pi * (1.0 - 1e-14)
        if beyond.any():
            edges = np.flatnonzero(beyond)
            turned = omega[edges]
            length = turned.dot(turned).sqrt()[:, None]
            back = turned - Ball.within(2.0 * np.pi, 1e-15) * turned / length
            costs = _hulls(costs, self._costs(y[edges], back, edges), edges)
        return costs

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding."""
        minorants = minorants_in_the_plane if self.graph.d == 2 else minorants_in_space
        return minorants(self.graph, self.measured, *self.unexplained(v, Q))

    def relaxed(self) -> GtsamCost | None:
        """In space, without cross terms and with isotropic translations.

        Little of its rotational information has to pay for touching.
        """
        if self.graph.d == 2:
            return None
        T, P, _ = blocks(self.graph.information_matrices, 3)
        uneven = ~is_isotropic(T) | P.any(axis=(1, 2))
        return self.on(lowered(self.graph, uneven, lambda T, W: (isotropic(T), W)))

    def _costs(self, y: Ball, omega: Ball, edges: IntArray) -> Ball:
        hat = crossed(omega)
        turned = hat.apply(y)
        c, _ = half_cotangent(omega.dot(omega))
        e = joined(y - 0.5 * turned + c[:, None] * hat.apply(turned), omega)
        return e.dot(Ball.exact(self.graph.information_matrices[edges]).apply(e))


def _inverse_jacobians(omega: FloatArray, hat: FloatArray) -> FloatArray:
    """V^-1 (m, d, d)."""
    c = half_cotangents(np.einsum("ma,ma->m", omega, omega))
    return np.asarray(np.eye(hat.shape[-1]) - 0.5 * hat + c[:, None, None] * (hat @ hat))


def _in_omega(omega: FloatArray, hat: FloatArray, y: FloatArray) -> FloatArray:
    """(m, d, q) derivatives of V^-1 y in omega."""
    squares = np.einsum("ma,ma->m", omega, omega)
    c, slope = half_cotangents(squares), half_cotangent_slopes(squares)
    generators = so.hat(np.eye(omega.shape[1]))
    once, twice = (hat @ y[:, :, None])[:, :, 0], (hat @ hat @ y[:, :, None])[:, :, 0]
    of_y, of_once = (np.einsum("qab,mb->maq", generators, x) for x in (y, once))
    second = of_once + hat @ of_y
    outer = twice[:, :, None] * omega[:, None, :]
    return np.asarray(-0.5 * of_y + c[:, None, None] * second + 2.0 * slope[:, None, None] * outer)


def _hulls(balls: Ball, other: Ball, edges: IntArray) -> Ball:
    """Balls that contain those of other edges too."""
    mid, radius = balls.mid.copy(), balls.radius.copy()
    radius[edges] += np.abs(mid[edges] - other.mid) + other.radius
    radius[edges] *= 1.0 + 1e-14
    return Ball(mid, radius)


COST = GtsamCost
