"""How far an estimate can be from every optimum, in metres and degrees.

Let S = M - blkdiag(0, Lam) >= 0 prove the bound v, so that the cost of any point is at least
v + |X|_S^2, however far away. Two estimates, moved so that they agree at one pose, the reference,
differ by D, and |D|_S <= rho, the sum of the roots of their costs less v. For G the block of a node
j in A^-1, where A is S without the rows of the reference, its pose relative to that differs by u in
position and by an angle theta with

    |u|^2 <= rho^2 G_tt,      8 sin^2(theta / 2) <= rho^2 2 g1 g2 / (g1 + g2),

g1 >= g2 the two largest eigenvalues of G_RR. Neither estimate need be stationary. See
docs/how-to/how_far_can_i_be_off.md.

Rounding: A - C is factorized, with a diagonal C above what rounding may be off by. So A is at least
the product of the computed factors, exactly, and G at most its inverse's block; that is computed
with bounds on rounding, too, see `certpgo.linalg.selected_inverse`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np

from certpgo.certify.dual import AMPLE, CONFIRMATIONS, Attempts, DualBound
from certpgo.certify.tolerances import difference_up
from certpgo.errors import InputError, NumericalError, require
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.linalg.arrays import FloatArray, frozen_floats
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.rounding_bound import rounding_of_factor
from certpgo.linalg.selected_inverse import diagonal_blocks
from certpgo.objective.quadratic import Quadratic

#: What is taken off the diagonal, over what rounding was, and the least of it.
COVER, LEAST = 2.5, 2.0
#: Rounding of the last few operations.
UP = 1.0 + 64.0 * U


@dataclass(frozen=True, eq=False, repr=False)
class Region(Brief):
    """Where all optima are, seen from one pose: no further from the estimate than this.

    Poses are compared in the frame of the reference: by how far, and by which angle, a node is
    elsewhere relative to that. All numbers are proven, despite rounding.

    Attributes
    ----------
    reference : the pose whose frame it is
    metres : (n,) for each node; None of rotations alone
    degrees : (n,) for each node: 180 where nothing is known, 0 for points
    """

    reference: int
    metres: FloatArray | None
    degrees: FloatArray

    @property
    def node(self) -> int:
        """The node that may be furthest off."""
        return int(np.argmax(self.degrees if self.metres is None else self.metres))

    @property
    def largest(self) -> tuple[float | None, float]:
        """The largest distance of any node, metres, and the largest angle of any, degrees."""
        metres = None if self.metres is None else float(self.metres.max())
        return metres, float(self.degrees.max())


@dataclass(frozen=True, eq=False, repr=False)
class Regions(Brief):
    """What a bound says of where optima are, computed when it is asked for.

    Attributes
    ----------
    problem : with weights of order one
    bound : a proven one
    cost : upper bound on the cost of the estimate
    known : upper bound on the cost of the best estimate known
    point : an estimate near a minimum, to judge sizes by
    """

    problem: Any
    bound: DualBound
    cost: float
    known: float
    point: Estimate
    _found: dict[int, Region | None] = field(default_factory=dict)

    def around(self, reference: int | None = None) -> Region | None:
        """Where all optima are in the frame of a pose; None if that cannot be proven.

        Parameters
        ----------
        reference : by default the pose whose measurements weigh most

        Raises
        ------
        InputError
            There is no such pose.
        """
        if reference is not None:
            require(reference, Integral, "the number of a node")
        chosen = self.problem.chordal.anchor if reference is None else int(reference)
        if chosen not in self.problem.chordal.poses:
            raise InputError(f"node {chosen} is none of the poses")
        if chosen not in self._found:
            self._found[chosen] = self._computed(chosen)
        return self._found[chosen]

    @cached_property
    def rho(self) -> float:
        """Upper bound on the distance of the estimate from any optimum, in the seminorm of S."""
        own, least = (
            math.sqrt(max(difference_up(cost, self.bound.value), 0.0))
            for cost in (self.cost, min(self.known, self.cost))
        )
        return UP * (own + least)

    @cached_property
    def form(self) -> Quadratic:
        """The problem whose cost, plus a constant, is nowhere above."""
        support = self.bound.support
        below = self.problem if support is None else self.problem.surrogate_of(support.minorants)
        form: Quadratic = below if support is None else below.problem
        return form

    def _computed(self, reference: int) -> Region | None:
        if not math.isfinite(self.rho):
            return None
        try:
            G = _inverse_blocks(self.form, self.point, self.bound.multipliers, reference)
        except (NumericalError, np.linalg.LinAlgError):
            return None
        if G is None or not np.isfinite(G).all():
            return None
        G[reference] = 0.0
        d, square = self.form.d, UP * self.rho * self.rho
        metres = None
        if self.form.has_positions:
            metres = frozen_floats(UP * np.sqrt(square * G[:, 0, 0]))
        return Region(reference, metres, frozen_floats(_degrees(square, G[:, -d:, -d:])))


def _inverse_blocks(
    form: Quadratic, point: Estimate, multipliers: FloatArray, reference: int
) -> FloatArray | None:
    """(n, b, b) upper bounds on the blocks of A^-1; None if A is not definite beyond rounding."""
    attempts = Attempts(form, point, True, -math.inf, False)
    pin = attempts.rows_of(reference)
    demand = AMPLE * attempts.foretold(attempts.matrix(multipliers, np.zeros(0), pin), pin)
    for _ in range(CONFIRMATIONS):
        rounding = attempts.rounding_of(multipliers, demand, False, pin)
        if rounding is None:
            return None
        if (LEAST * rounding <= demand).all():
            factor = attempts.symbolic.factor(attempts.matrix(multipliers, demand, pin))
            if factor is None:
                return None
            L, rows = factor.lower()
            # The factor that is kept may round otherwise than the one before.
            sums, _ = rounding_of_factor(L, rows, attempts.weights)
            rounding = np.maximum(rounding, attempts.compensation(sums, multipliers, pin))
            if (rounding <= demand).all():
                layout = form.pattern.layout_of(form.matrix)
                return diagonal_blocks(L, rows, layout, above=True)
        demand = np.maximum(demand, COVER * rounding)
    return None


def _degrees(square: float, G: FloatArray) -> FloatArray:
    """(n,) angles for rho^2 and the blocks (n, d, d) of rotations."""
    values = np.linalg.eigvalsh(G)
    sizes = np.einsum("naa->n", G)
    first, second = (np.maximum(values[:, k], 0.0) + 64.0 * U * sizes for k in (-1, -2))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(sizes > 0.0, first * second / (first + second), 0.0)
    share = UP * 0.25 * square * mean  # of 8
    angles = 2.0 * np.arcsin(np.sqrt(np.minimum(share, 1.0)))
    return np.where(share < 1.0, UP * np.degrees(angles), 180.0)
