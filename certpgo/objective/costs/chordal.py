"""F as a cost of edges, for graphs that measure what no quadratic form of the poses has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, sums
from certpgo.objective import residuals
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.minorants import Minorants
from certpgo.objective.truncated import terms_of_rotations, untruncated


@dataclass(frozen=True, eq=False)
class ChordalCost(EdgeCost):
    """tr((Q - R~) K (Q - R~)^T) + tau |v - t~|^2, its own minorant.

    K = kappa I; of general edges R~ and K are the polar factors of N, see `certpgo.Graph`.
    """

    name: ClassVar[str] = "chordal"
    provable: ClassVar[bool] = True
    takes_partial: ClassVar[bool] = True
    conjunction: ClassVar[str] = " and squared errors of"

    def __post_init__(self) -> None:
        """Kappa, tau and couplings are what it needs."""

    @property
    def title(self) -> str:
        """What it is."""
        return "F"

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them."""
        return Scale.of(self.graph)

    @property
    def is_definite(self) -> BoolArray:
        """(m,) which measurements have a cost that grows with all of their residuals: all."""
        return np.ones(self.graph.num_edges, dtype=bool)

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each edge measures of a rotation, and (m,) of a translation."""
        return residuals.numbers(self.graph)

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts: for kappa I, twice in the plane."""
        return residuals.double(self.graph)

    @property
    def weights(self) -> FloatArray:
        """(m, d + d^2, d + d^2) weights tau, and K for each row."""
        d, graph = self.graph.d, self.graph
        W = np.zeros((graph.num_edges, d + d * d, d + d * d))
        W[:, :d, :d] = graph.tau[:, None, None] * np.eye(d)
        W[:, d:, d:] = np.kron(np.eye(d), graph.polar[1])
        return W

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, d + d^2) residuals v - t~, then Q - R~ by rows."""
        turned = (Q - self.graph.polar[0]).reshape(len(Q), -1)
        return np.concatenate([v - self.graph.translations, turned], axis=1)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `Term.linearized`."""
        (m, d), q = v.shape, so.tangent_dim(v.shape[1])
        in_v, in_w = np.zeros((m, d + d * d, d)), np.zeros((m, d + d * d, q))
        in_v[:, :d] = np.eye(d)
        turned = Q[:, None] @ so.hat(np.eye(q))
        in_w[:, d:] = np.swapaxes(turned.reshape(m, q, d * d), 1, 2)
        return self.residuals(v, Q), in_v, in_w

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""
        y = v - self.graph.translations
        return self.graph.tau * y.dot(y) + self._turned(Q)

    def _turned(self, Q: Ball) -> Ball:
        """(m,) the terms of rotations."""
        m, graph = len(self.edges), self.graph
        if graph.couplings is None:
            return graph.kappa * sums((Q - self.measured).reshaped(m, -1).squared())
        # tr((Q - P) K (Q - P)^T) for stored P and K, and what rounding has made of N = P K.
        P, K = map(Ball.exact, graph.polar[:2])
        E, (N, most) = Q - P, terms_of_rotations(graph)
        off = sums((N - P @ K).reshaped(m, -1).squared()).sqrt().size
        traces = sums((P * (P @ K)).reshaped(m, -1)) + np.trace(K.mid, axis1=1, axis2=2)
        less = most - traces + Ball.within(np.zeros(m), 2.0 * 1.74 * off)
        whole: Ball = sums((E * (E @ K)).reshaped(m, -1)) + less
        return whole

    def bend(self, v: FloatArray) -> FloatArray:
        """(m,) tau |v|^2."""
        return np.asarray(self.graph.tau * (v * v).sum(axis=1))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """The terms themselves, but for rounding."""
        return untruncated(self.graph)


COST = ChordalCost
