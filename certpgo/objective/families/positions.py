"""Measured positions: of points that poses see, and of poses in the world.

The residual is y = v - m in every program, for a measured m, in the frame of the first node. For
lam below the smallest eigenvalue of the information T and any b, y^T T y - lam |v - b|^2 is
smallest at y = -lam (T - lam)^-1 (b - m), so minorants lam |v - b|^2 + constant are those of
`certpgo.objective.marginalized` without rotations. Where T = t I, the cost is one itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.graph.information import unmeasured
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.marginalized import blocks, is_isotropic, remainder
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import EdgeTerm

#: Share of the smallest eigenvalue of T that a minorant keeps.
SHARE = 0.99


@dataclass(frozen=True, eq=False)
class Positions(EdgeTerm):
    """Squared errors of positions, weighed by their information.

    Attributes
    ----------
    graph : edges with kappa = 0, the rotational part of whose information is zero
    """

    plural: ClassVar[str] = "positions"

    @property
    def weights(self) -> FloatArray:
        """(k, d, d) their information T."""
        return self.informed(self.graph.information_matrices)

    def informed(self, information: FloatArray) -> FloatArray:
        """(k, d, d) the same of other information matrices."""
        return blocks(information, self.graph.d)[0]

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, d) residuals y, metres."""
        return v - self.graph.translations

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `Term.linearized`."""
        k, d = v.shape
        turned = np.zeros((k, d, so.tangent_dim(d)))
        return self.residuals(v, Q), np.tile(np.eye(d), (k, 1, 1)), turned

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(k,) balls that contain the costs of all of these v."""
        y = v - self.graph.translations
        return y.dot(Ball.exact(self.weights).apply(y))

    def bend(self, v: FloatArray) -> FloatArray:
        """(k,) v^T T v."""
        return np.asarray(np.einsum("ma,mab,mb->m", v, self.weights, v))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at v, up to rounding."""
        d, m, T = self.graph.d, self.graph.translations, self.weights
        even = is_isotropic(T)
        lam = np.where(even, T[:, 0, 0], SHARE * np.linalg.eigvalsh(T)[:, 0])
        partial = unmeasured(T).any(axis=1)
        lam = np.where(partial, 1.0, lam)
        y = v - m
        b = m + np.where(even[:, None], 0.0, y - (T @ y[:, :, None])[:, :, 0] / lam[:, None])
        # Positions are not measured in a turned frame, whatever rotation an edge holds.
        unturned = Ball.exact(np.tile(np.eye(d), (len(lam), 1, 1)))
        _, _, constant = remainder(self.graph, unturned, lam, b)
        found = np.where(np.isfinite(constant.radius) & ~partial, constant.lower, -np.inf)
        N = np.zeros_like(self.graph.rotations)
        return Minorants(lam, self.graph.own_arms, b, N, np.where(even & ~partial, 0.0, found))
