"""Minorants of truncated edge costs min(f, c): of a rejected measurement and its price.

For f = kappa |R_j - R_i R~|^2 + tau |t_j - t_i - R_i t~|^2, any weights beta_R, beta_t >= 0 and any
matrix Z and vector z, let p_R = |Z - R~|_F, p_t = |z - t~| and a || b = a b / (a + b). Then

    c' = (kappa || beta_R) p_R^2 + (tau || beta_t) p_t^2 <= c

implies, for all poses,

    c' - beta_R |R_j - R_i Z|^2 - beta_t |t_j - t_i - R_i z|^2 <= min(f, c).

For the left side is at most c', and with a = |R_j - R_i R~| the triangle inequality gives
|R_j - R_i Z| >= p_R - a, as R_i is orthogonal; kappa a^2 + beta (p - a)^2 >= (kappa || beta) p^2
for every a. The same holds for translations, and both together. So a rejected measurement is an
edge of negative weight.

Where it is rejected at an estimate, f > c there, Z and z are the estimate's own relative pose: the
edge has no residual and no gradient, and c' = c if the weights are large enough. Where f < c, they
lie further out by c / f, and both weights are f / (c - f) of the measurement's: cost and gradient
are those of f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph, PoseGraph
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, sums
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.edge_cost import Minorants

#: Weights over those of the measurement beyond which an edge has no minorant, as its cost is too
#: close to its price, and below which a cost under the price counts as zero.
STEEPEST, FLATTEST = 1e6, 1e-9
#: By which weights are raised, so that rounding does not lower the price that is reached.
RAISED = 1e-13


@dataclass(frozen=True, eq=False)
class Truncation:
    """Rejected measurements at the relative poses of an estimate.

    Attributes
    ----------
    graph : k measurements with isotropic weights
    prices : (k,) at which their costs are truncated, in units of F
    v : (k, d) R_i^T (t_j - t_i) of the estimate; zeros for rotations alone
    Q : (k, d, d) R_i^T R_j
    """

    graph: Graph
    prices: FloatArray
    v: FloatArray
    Q: FloatArray

    @property
    def measured(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(k, d) measured translations, (k, d, d) rotations, and (k, 2) weights kappa, tau."""
        rotation = self.graph.rotation
        if isinstance(self.graph, PoseGraph):
            weights = np.stack([rotation.kappa, self.graph.tau], axis=1)
            return self.graph.translations, rotation.rotations, weights
        weights = np.stack([rotation.kappa, np.zeros_like(rotation.kappa)], axis=1)
        return np.zeros_like(self.v), rotation.rotations, weights

    @property
    def costs(self) -> FloatArray:
        """(k, 2) terms of F, of rotations and translations."""
        t, R, weights = self.measured
        squares = ((self.Q - R) ** 2).sum(axis=(1, 2)), ((self.v - t) ** 2).sum(axis=1)
        return np.asarray(weights * np.stack(squares, axis=1))

    def ratios(self, loads: FloatArray | None = None) -> FloatArray:
        """(k, 2) weights beta over kappa and tau with which the prices are reached; or infinite.

        Parameters
        ----------
        loads : (k, 2) what a ratio of 1 costs the certificate, by rotations and translations, see
            `certpgo.certify.truncated_case`; the sum of ratios times loads is smallest. Ones by
            default
        """
        f, c = self.costs, self.prices
        total = f.sum(axis=1)
        if loads is None:
            loads = np.ones_like(f)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = (total - c) / np.sqrt(f * loads).sum(axis=1)
            both = np.sqrt(f / loads) / root[:, None] - 1.0
            alone = c[:, None] / (f - c[:, None])
            # Where one of the two is better left out, the other reaches the price alone.
            out = np.asarray(~(both > 0.0))
            single = out.any(axis=1, keepdims=True)
            far = np.where(single, np.where(out, 0.0, alone), both)
            near = total / (c - total)
        near = np.where(near < FLATTEST, 0.0, near)[:, None] * np.ones(2)
        ratios = (1.0 + RAISED) * np.where((total > c)[:, None], far, near)
        return np.where(np.isnan(ratios) | (self.measured[2] == 0.0), 0.0, ratios)

    def minorants(self, ratios: FloatArray) -> Minorants:
        """The minorants with weights of these ratios (k, 2); zero where one is too steep.

        Their constants are rounded down for exactly the other doubles.
        """
        t, R, weights = self.measured
        kept = np.where((ratios <= STEEPEST).all(axis=1, keepdims=True), ratios, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            out = np.maximum(self.prices / self.costs.sum(axis=1), 1.0)
        out = np.where(np.isfinite(out) & kept.any(axis=1), out, 1.0)
        beta = kept * weights
        z = t + out[:, None] * (self.v - t)
        N = -beta[:, :1, None] * (R + out[:, None, None] * (self.Q - R))
        constant = np.where(kept.any(axis=1), self._constants(beta, z, N), 0.0)
        return Minorants(-beta[:, 1], np.zeros_like(z), z, N, constant)

    def _constants(self, beta: FloatArray, z: FloatArray, N: FloatArray) -> FloatArray:
        """(k,) lower bounds on c' - beta_R (d + |Z|^2), where N = -beta_R Z."""
        t, R, weights = self.measured
        turned = beta[:, 0] > 0.0
        divisor = np.where(turned, beta[:, 0], 1.0)[:, None, None]
        Z = -Ball.exact(N) / Ball.exact(divisor)
        off = Z - Ball.within(R, rotation_defect(R))
        k, d = t.shape
        squares = (
            sums(off.reshaped(k, d * d).squared()),
            sums((Ball.exact(z) - t).squared()),
        )
        reached = Ball.exact(np.zeros(k))
        for which, square in enumerate(squares):
            w, b = weights[:, which], beta[:, which]
            counts = b > 0.0
            both = Ball.exact(np.where(counts, w, 1.0)), Ball.exact(np.where(counts, b, 0.0))
            reached = reached + both[0] * both[1] / (both[0] + both[1]) * square
        reached = Ball.exact(np.minimum(reached.lower, self.prices))
        spent = (sums(Z.reshaped(k, d * d).squared()) + float(d)) * np.where(
            turned, beta[:, 0], 0.0
        )
        return np.asarray((reached - spent).lower)


def untruncated(graph: Graph) -> Minorants:
    """Minorants of measurements with isotropic weights, which differ from their costs by rounding.

    kappa |Q - R|^2 = 2 d kappa - 2 kappa <R, Q>, where the coupling kappa R is a rounded one of the
    rotation R nearest to the stored matrix.
    """
    R, kappa = graph.rotation.rotations, graph.rotation.kappa
    m, d = len(R), graph.d
    N = kappa[:, None, None] * R
    off = Ball.exact(N) - Ball.within(R, rotation_defect(R)) * kappa[:, None, None]
    distance = sums(off.reshaped(m, d * d).squared()).sqrt().size
    constant = (
        2.0 * d * Ball.exact(kappa) - 2.0 * math.sqrt(d) * 1.001 * Ball.exact(distance)
    ).lower
    if isinstance(graph, PoseGraph):
        zeros = np.zeros_like(graph.translations)
        return Minorants(graph.tau, zeros, graph.translations, N, constant)
    zeros = np.zeros((m, d))
    return Minorants(np.zeros(m), zeros, zeros, N, constant)
