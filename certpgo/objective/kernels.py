"""Robust kernels: which, and from which residual on; and those of the edges of a graph."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.errors import InputError, SpecError, require
from certpgo.graph import Graph
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.kernel_profiles import FARTHEST, PROFILES, Profile

#: Scales whose squares, over weights too, are doubles.
SCALES = 1e-100, 1e100


@dataclass(frozen=True, eq=False)
class Kernel:
    """A robust kernel, and the residual from which on it counts less than its square.

    Attributes
    ----------
    name : ``"huber"``, ``"cauchy"``, ``"geman-mcclure"`` or ``"truncated"``
    scale : of residuals (m,), or of all: the square root of a measurement's cost, as GTSAM, g2o and
        Ceres have it; infinite where the cost is to stay as it is
    in_degrees : whether scales are angles of rotations instead, each the cost of a measurement that
        is off by that angle

    Raises
    ------
    SpecError
        No such kernel.
    InputError
        A scale that is not positive, or an angle beyond 180 degrees.

    Examples
    --------
    >>> from certpgo.objective.kernels import Kernel
    >>> print(Kernel.parse("huber:5deg"))
    Huber's kernel of 5 degrees
    """

    name: str
    scale: float | FloatArray
    in_degrees: bool = False

    def __post_init__(self) -> None:
        require(self.name, str, "the name of a kernel")
        if self.name not in PROFILES:
            raise SpecError.unknown("kernel", self.name, list(PROFILES))
        scale = np.asarray(self.scale, dtype=np.float64)
        if scale.ndim > 1 or not (scale > 0.0).all():
            raise InputError("the scale of a kernel must be positive, for all edges or for each")
        if not ((scale >= SCALES[0]) & (scale <= SCALES[1]) | np.isinf(scale)).all():
            said = f"from {SCALES[0]:g} to {SCALES[1]:g}, or infinite"
            raise InputError(f"the scale of a kernel is {said}: its square is beyond doubles")
        if self.in_degrees and not (scale <= 180.0).all():
            raise InputError("the scale of a kernel in degrees is at most 180")

    @staticmethod
    def parse(text: str) -> Kernel:
        """A kernel from ``NAME:SCALE``, where a scale that ends with deg is an angle.

        Raises
        ------
        SpecError
            No such kernel.
        InputError
            No scale, or no positive one.
        """
        name, _, scale = text.partition(":")
        if name not in PROFILES:
            raise SpecError.unknown("kernel", name, list(PROFILES))
        number = scale.removesuffix("deg")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            said = f"a positive number, or one of degrees such as {name}:5deg"
            raise InputError(f"the kernel {text!r} needs a scale: {name}:SCALE, {said}")
        return Kernel(name, value, number != scale)

    def __str__(self) -> str:
        if np.ndim(self.scale):
            return f"{PROFILES[self.name].called} of a scale for each edge"
        unit = " degrees" if self.in_degrees else ""
        joined = "of" if self.in_degrees else "of scale"
        return f"{PROFILES[self.name].called} {joined} {self.scale:g}{unit}"

    def squares(self, graph: Graph) -> FloatArray:
        """(m,) the costs of the edges from which on the kernel counts less; infinite for others.

        Edges that measure from a world, or assume something, keep their costs.

        Raises
        ------
        InputError
            There are more or fewer scales, or degrees where not only rotations are measured.
        """
        m = graph.num_edges
        scale = np.asarray(self.scale, dtype=np.float64)
        if scale.ndim and scale.shape != (m,):
            raise InputError(f"a kernel has one scale, or {m}: one for each edge")
        if self.in_degrees and graph.has_positions:
            said = "give it as a residual, the square root of a cost"
            raise InputError(f"the scale of a kernel is an angle for rotations alone: {said}")
        if self.in_degrees:
            found = FARTHEST * graph.kappa * np.sin(0.5 * np.radians(scale)) ** 2
        else:
            found = np.broadcast_to(scale**2, m)
        plain = np.zeros(m, dtype=bool)
        for of in (graph.absolute, graph.assumed):
            if of is not None:
                plain |= of
        return frozen_floats(np.where(plain, np.inf, found))


@dataclass(frozen=True, eq=False)
class AppliedKernel:
    """A kernel of the edges of a graph.

    Attributes
    ----------
    kernel : what was asked for
    squares : (m,) see `Kernel.squares`
    """

    kernel: Kernel
    squares: FloatArray

    @property
    def profile(self) -> Profile:
        """Its function."""
        return PROFILES[self.kernel.name]

    @property
    def idle(self) -> BoolArray:
        """(m,) the edges whose costs stay as they are."""
        return np.isinf(self.squares)

    def of(self, chosen: BoolArray | IntArray) -> AppliedKernel:
        """Of some of the edges."""
        return AppliedKernel(self.kernel, frozen_floats(self.squares[chosen]))

    def scaled(self, factor: float) -> AppliedKernel:
        """For costs times a factor."""
        return AppliedKernel(self.kernel, frozen_floats(factor * self.squares))

    def ratios(self, q: FloatArray) -> FloatArray:
        """(m,) costs over the squares, zero for idle edges."""
        return np.asarray(q / self.squares)

    def costs(self, q: FloatArray) -> FloatArray:
        """(m,) rho(q) of costs q."""
        idle = self.idle
        c = np.where(idle, 1.0, self.squares)
        return np.where(idle, q, c * self.profile.values(q / c))

    def slopes(self, q: FloatArray) -> FloatArray:
        """(m,) rho'(q)."""
        return np.where(self.idle, 1.0, self.profile.slopes(self.ratios(q)))

    def bends(self, q: FloatArray) -> FloatArray:
        """(m,) rho''(q)."""
        c = np.where(self.idle, 1.0, self.squares)
        return np.where(self.idle, 0.0, self.profile.bends(q / c) / c)

    def enclosures(self, q: Ball) -> Ball:
        """(m,) rho of all costs in balls."""
        idle = self.idle
        c = np.where(idle, 1.0, self.squares)
        found = self.profile.value_enclosures(q / c) * c
        return Ball(np.where(idle, q.mid, found.mid), np.where(idle, q.radius, found.radius))
