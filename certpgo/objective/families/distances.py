"""Measured distances, of cost w (d - |v|)^2.

In s = |v|^2, which is linear in the Gram matrix, that is w (d^2 - 2 d s^(1/2) + s). As it is convex
in s, its tangents are minorants: for any tau < w

    w (d - s^(1/2))^2 >= tau s - w d^2 tau / (w - tau),

with equality where tau = w (1 - d / s^(1/2)), of either sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from certpgo.graph.observations import Observations
from certpgo.graph.ranges import Ranges
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, U
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import Term

#: Least weight of the tangents between two nodes, over that of their distances: any weight below a
#: distance's is a minorant's.
FAINT = 1e-10
#: Lengths below this share of the measured ones have no direction.
SHORTEST = 1e-12


@dataclass(frozen=True, eq=False)
class Distances(Term):
    """Squared errors of distances."""

    ranges: Ranges
    takes: ClassVar[type[Observations]] = Ranges
    plural: ClassVar[str] = "distances"
    lifts: ClassVar[bool] = True
    in_metres: ClassVar[bool] = True

    @property
    def edges(self) -> IntArray:
        """(k, 2) the nodes of each distance."""
        return self.ranges.edges

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them: w d^2."""
        w, none = self.ranges.weights, np.zeros(self.ranges.num_edges)
        with np.errstate(over="ignore"):  # refused where W is asked for
            squares = self.ranges.distances**2
        return Scale(none, w, squares, none > 0.0)

    @property
    def weights(self) -> FloatArray:
        """(k, 1, 1) weights of the residuals."""
        return self.ranges.weights[:, None, None]

    @property
    def sizes(self) -> FloatArray:
        """(k,) the distances, metres."""
        return self.ranges.distances

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, 1) errors of the lengths, metres."""
        return np.asarray((np.linalg.norm(v, axis=1) - self.ranges.distances)[:, None])

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `Term.linearized`."""
        direction = v / self._apart(v)[:, None]
        turned = np.zeros((len(v), 1, so.tangent_dim(v.shape[1])))
        return self.residuals(v, Q), direction[:, None], turned

    def curved(self, v: FloatArray) -> FloatArray:
        """(k, d, d) w (1 - d / |v|) (I - u u^T) for the direction u of v."""
        length = self._apart(v)
        u = v / length[:, None]
        across = np.eye(v.shape[1]) - u[:, :, None] * u[:, None, :]
        return (self.ranges.weights * (1.0 - self.ranges.distances / length))[
            :, None, None
        ] * across

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(k,) balls that contain the costs of all of these v."""
        off = v.dot(v).sqrt() - self.ranges.distances
        return off * off * self.ranges.weights

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at v, up to rounding."""
        tau, constants = self.tangent_weights(self._apart(v))
        none, N = np.zeros_like(v), np.zeros((*v.shape, v.shape[1]))
        return Minorants(tau, none, none, N, constants)

    def _apart(self, v: FloatArray) -> FloatArray:
        """(k,) lengths, not below the least with a direction."""
        least = np.maximum(SHORTEST * self.ranges.distances, np.finfo(float).tiny)
        return np.asarray(np.maximum(np.linalg.norm(v, axis=1), least))

    @cached_property
    def _pairs(self) -> IntArray:
        """(k,) which pair of nodes each distance is between."""
        pairs = np.sort(self.edges, axis=1) @ np.array([self.ranges.num_nodes, 1])
        return np.unique(pairs, return_inverse=True)[1]

    def tangent_weights(
        self, lengths: FloatArray, more: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """(k,) weights tau of the tangents at positive lengths, and constants, rounded down.

        Parameters
        ----------
        more : added to the weights, over those of the distances
        """
        w, distance = self.ranges.weights, self.ranges.distances
        tau = w * (1.0 - distance / lengths + more)
        # Without weight, what only met distances hold would be free; and tau must stay below w.
        total, weight = (np.bincount(self._pairs, of)[self._pairs] for of in (tau, w))
        tau = np.where(np.abs(total) < FAINT * weight, tau + 2.0 * FAINT * w, tau)
        tau = np.minimum(tau, np.where(distance > 0.0, w * (1.0 - 2.0**-50), w))
        with np.errstate(all="ignore"):
            constants = np.where(distance > 0.0, -w * distance**2 * tau / (w - tau), 0.0)
        # Six operations, and the difference of stored numbers.
        constants -= 16.0 * U * np.abs(constants) + 2.0**-1000
        return tau, np.where(np.isfinite(constants), constants, -np.inf)
