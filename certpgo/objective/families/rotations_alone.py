"""Measured rotations without translations, in the cost of a program.

A minorant of the cost with any translational information is one of the rotation at y = 0, and
without its first term, which is not negative, everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import Term


@dataclass(frozen=True, eq=False)
class RotationsAlone(Term):
    """The rotational part of a program's cost.

    Attributes
    ----------
    cost : the cost, of edges with tau = 0, the translational part of whose information is zero
    """

    cost: EdgeCost

    @property
    def edges(self) -> IntArray:
        """(k, 2) the nodes of each edge."""
        return self.cost.edges

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them."""
        return self.cost.scale

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(k,) how many numbers each edge measures of a rotation, and (k,) zeros."""
        return self.cost.numbers

    @property
    def weights(self) -> FloatArray:
        """(k, r, r) weights of the residuals, zero for translations."""
        return self.cost.weights

    def informed(self, information: FloatArray) -> FloatArray:
        """(k, r, r) the same of other information matrices."""
        return self.cost.informed(information)

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, r) residuals, as of a relative pose."""
        return self.cost.residuals(v, Q)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `Term.linearized`."""
        return self.cost.linearized(v, Q)

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(k,) balls that contain the costs of all of these (v, Q)."""
        return self.cost.enclosures(v, Q)

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at Q, up to rounding."""
        graph = self.cost.graph
        d, information = graph.d, graph.information_matrices.copy()
        information[:, :d, :d] = np.eye(d)
        filled = replace(self.cost, graph=graph.with_information(information))
        found = filled.minorants(graph.translations, Q)
        nothing = ~found.N.any(axis=(1, 2))
        none = np.zeros_like(found.b)
        constant = np.where(nothing, -np.inf, found.constant)
        return replace(found, tau=none[:, 0], a=none, b=none, constant=constant)
