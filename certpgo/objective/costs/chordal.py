"""F as a cost of edges, for graphs that measure what no quadratic form of the poses has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, sums
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.minorants import Minorants
from certpgo.objective.truncated import untruncated


@dataclass(frozen=True, eq=False)
class ChordalCost(EdgeCost):
    """kappa |Q - R~|_F^2 + tau |v - t~|^2, its own minorant."""

    name: ClassVar[str] = "chordal"
    takes_partial: ClassVar[bool] = True
    conjunction: ClassVar[str] = " and squared errors of"

    def __post_init__(self) -> None:
        if self.graph.has_couplings:
            lacks = "isotropic weights, not for matrix weights or directions alone"
            raise InputError(f"distances and other kinds of measurements are for {lacks}")

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
        graph, d = self.graph, self.graph.d
        return so.tangent_dim(d) * graph.measures_rotation, d * graph.measures_translation

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts: twice in the plane."""
        return np.full(self.graph.num_edges, 2 if self.graph.d == 2 else 1)

    @property
    def weights(self) -> FloatArray:
        """(m, d + d^2, d + d^2) weights tau and kappa."""
        d, graph = self.graph.d, self.graph
        both = np.stack([graph.tau, graph.kappa], axis=1)
        diagonal = np.repeat(both, [d, d * d], axis=1)
        return np.asarray(diagonal[:, :, None] * np.eye(d + d * d))

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, d + d^2) residuals v - t~, then Q - R~ by rows."""
        turned = (Q - self.graph.rotations).reshape(len(Q), -1)
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
        y, E = v - self.graph.translations, Q - self.measured
        turned = sums(E.reshaped(len(self.edges), -1).squared())
        return self.graph.tau * y.dot(y) + self.graph.kappa * turned

    def bend(self, v: FloatArray) -> FloatArray:
        """(m,) tau |v|^2."""
        return np.asarray(self.graph.tau * (v * v).sum(axis=1))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """The terms themselves, but for rounding."""
        return untruncated(self.graph)


COST = ChordalCost
