"""Quadratic models of costs, which Levenberg and Marquardt's method descends on."""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.factor import LinearSolver

#: Relative decrease of a cost that is lost in rounding.
ROUNDING = 16 * np.finfo(float).eps


class CostAtPoint(Protocol):
    """A cost f at a point, and after steps from it; N is the number of coordinates of a step."""

    @property
    def point(self) -> Point:
        """The point."""

    @property
    def cost(self) -> float:
        """The cost f there."""

    @property
    def rounding(self) -> float:
        """A decrease of the cost that may be lost in rounding."""

    def moved(self, x: FloatArray) -> Self:
        """The same at the point after a step x (N,)."""


class QuadraticModel(CostAtPoint, Protocol):
    """The model f + 2 g x + x H x of a cost near a point."""

    @property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient g."""

    @property
    def gauge(self) -> FloatArray:
        """(N,) damping that is always there, since motions of the whole do not change f."""

    @property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix H, positive semidefinite."""

    @property
    def hessian(self) -> CSC:
        """The Riemannian Hessian H; the Gauss-Newton matrix where it is not known."""

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the curvature of each coordinate, in units of which steps are damped."""

    def raised(self, damping: float) -> float:
        """The damping after a step that failed with this one."""

    def stationarity(self, scale: FloatArray) -> float:
        """The largest entry of g over ``scale``: radians, and relative translations."""

    def factor(self, A: CSC) -> LinearSolver | None:
        """The factor of a matrix with the pattern of H; None if it is not positive definite."""


def largest_step(gradient: FloatArray, curvature: FloatArray, moves: int, length: float) -> float:
    """The largest quotient of gradient and curvature, in radians and shares of a length.

    Parameters
    ----------
    gradient, curvature : (n, b) of the nodes' translations, then of their rotations
    moves : number of coordinates of a translation
    length : unit of translations
    """
    unit = np.r_[np.full(moves, length), np.ones(gradient.shape[1] - moves)]
    with np.errstate(all="ignore"):
        size = np.abs(gradient) / (curvature * unit)
    return float(np.nan_to_num(size, nan=0.0).max())
