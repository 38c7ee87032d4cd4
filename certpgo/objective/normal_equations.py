"""The linearization of a program's cost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import diagonal_of
from certpgo.linalg.factor import LinearSolver
from certpgo.objective.quadratic_model import ROUNDING, largest_step

#: Damping after the first step that fails without any.
FIRST_DAMPING = 1e-6
#: Why sums of similarities have none.
NO_SCALES = "covariances are for poses of known scale, not for similarities"


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """A cost and its linearization at an estimate, a `QuadraticModel`.

    Attributes
    ----------
    problem : a `certpgo.objective.sum.Sum`
    cost : the cost there
    gradient : (N,) half its gradient
    """

    problem: Any
    point: Estimate
    cost: float
    gradient: FloatArray

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of half the cost."""
        problem = self.problem
        return problem.chordal.pattern.assemble(*problem.equations.second(self.point), problem.d)

    @property
    def hessian(self) -> CSC:
        """The Gauss-Newton matrix, with what is known of the residuals' second derivatives."""
        problem = self.problem
        if not problem.equations.has_more:
            return self.gauss_newton
        blocks = problem.equations.second(self.point, exact=True)
        return problem.chordal.pattern.assemble(*blocks, problem.d)

    @property
    def rounding(self) -> float:
        """A decrease of the cost that may be lost in rounding."""
        return ROUNDING * self.cost

    @property
    def gauge(self) -> FloatArray:
        """(N,) one for a pose that hardly moves, zero for the others."""
        return cast("FloatArray", self.problem.held)

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the diagonal of the matrix; one for what no term has."""
        size = diagonal_of(H)
        return np.where(size != 0.0, size, 1.0)

    def raised(self, damping: float) -> float:
        """The damping after a failed step: ten times as much, or the first."""
        return 10.0 * damping or FIRST_DAMPING

    def stationarity(self, scale: FloatArray) -> float:
        """The largest gradient over ``scale``, see `Sum.stationarity`."""
        unpack = self.problem.tangent_layout.unpack
        length = self.problem.length
        moves = self.problem.d if self.problem.has_positions else 0
        return largest_step(unpack(self.gradient), unpack(scale), moves, length)

    def factor(self, A: CSC) -> LinearSolver | None:
        """The factor of a matrix with the same pattern, in single precision where that suffices."""
        factor = self.problem.factors.factor(self.problem.symbolic(A), A)
        return cast("LinearSolver | None", factor)

    def moved(self, x: FloatArray) -> NormalEquations:
        """The normal equations after a step x (N,)."""
        there = moved(self.point, self.problem.tangent_layout.unpack(x))
        return cast("NormalEquations", self.problem.normal_equations(there))


def moved(point: Estimate, moves: FloatArray) -> Estimate:
    """The estimate after moves (n, p): of translations in the world's frame, then of rotations."""
    shifts, turns = np.split(moves, [moves.shape[1] - so.tangent_dim(point.d)], axis=1)
    turned = so.nearest_to_rounding(so.turned(point.rotations, turns))
    return Estimate.trusted(turned, translations_of(point) + shifts if shifts.size else None)
