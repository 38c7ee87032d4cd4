"""The quadratic model of F over blocks of any kind, and translations."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Self

import numpy as np

from certpgo.graph.relaxed_point import Lift, translations_of
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import diagonal_of
from certpgo.linalg.factor import Factor
from certpgo.objective import operators
from certpgo.objective.quadratic_model import ROUNDING, largest_step

#: Damping that fixes the gauge, and the least after a step that fails, relative to the diagonal.
GAUGE, DAMPING = 1e-12, 1e-4


class ManifoldModel:
    """F near a point of rank r, a `QuadraticModel` over translations, turns and log-scales.

    Parameters
    ----------
    problem : a `certpgo.objective.quadratic.Quadratic`, or what has its ``form`` and derivatives
        besides terms of its own
    """

    def __init__(self, problem: Any, point: Lift) -> None:
        self.problem, self.space, self.point = problem, problem.chordal, problem.blocks(point)
        self.rank = rank = self.point.rotations.shape[1]
        self.moves = rank * problem.chordal.has_positions  # coordinates of translations
        space = self.space
        rows = self.moves + space.kinds.tangent_dim(rank, space.d) + space.takes_scales
        self.layout = space.pattern.layout(rows, self.moves or None)
        self.cost = float(self.edge_costs.sum())

    @cached_property
    def edge_costs(self) -> FloatArray:
        """(m,) terms of the cost."""
        return np.asarray(self.problem.edge_costs(self.point))

    @cached_property
    def gauge(self) -> FloatArray:
        """(N,) a little everywhere, which holds motions of the whole."""
        return np.full(self.layout.size, GAUGE)

    @property
    def rounding(self) -> float:
        """A decrease of the cost that may be lost in rounding."""
        return ROUNDING * abs(self.cost)  # below zero with signed weights

    @cached_property
    def euclidean(self) -> FloatArray:
        """Half the Euclidean gradient, (n, r, d + 1); of rotations alone (n, r, d)."""
        return np.asarray(self.problem.gradient(self.point))

    @cached_property
    def multipliers(self) -> FloatArray:
        """(n, d, d) Lagrange multipliers."""
        G = self.euclidean[:, :, -self.space.d :]
        return np.asarray(self.space.constrained(G, self.point.rotations))

    @cached_property
    def _sizes(self) -> FloatArray:
        """(n,) scales of the blocks."""
        return np.asarray(self.space.sizes_of(self.point.rotations))

    @cached_property
    def _basis(self) -> FloatArray:
        """(n, q, r, d) tangents: turns by a radian, then growth by a factor of e."""
        A, s = self.point.rotations, self._sizes[:, None, None]
        turns = math.sqrt(2.0) * self.space.kinds.apply("tangents", A / s)
        if not self.space.takes_scales:
            return np.asarray(turns)
        growth = np.where(self.space.kinds.scaled[:, None, None], A, 0.0)
        return np.concatenate([s[:, None] * turns, growth[:, None]], axis=1)

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of F."""
        space, d = self.space, self.space.d
        G = self.euclidean[:, :, -d:]
        if space.kinds.in_mean_unit:  # of F over the mean square of the scales
            G, held = G.copy(), space.held
            G[held] -= self.cost / (d * len(held)) * self.point.rotations[held]
        parts = [np.einsum("nqrd,nrd->nq", self._basis, G)]
        if self.moves:
            parts.insert(0, self.euclidean[:, :, 0])
        return np.asarray(self.layout.pack(np.concatenate(parts, axis=1)))

    def _hessian(self, multipliers: FloatArray | None) -> CSC:
        diagonal, upper = self.problem.hessian_blocks(self.point, self._basis, multipliers)
        # Nodes with fewer tangents than others.
        node, k = np.nonzero(~self._basis.any(axis=(2, 3)))
        rows, first = self.moves + k, self.moves
        diagonal[node, rows, rows] = 1.0 + np.abs(diagonal[node, first, first])
        assembled: CSC = self.space.pattern.assemble(diagonal, upper, self.moves or None)
        return assembled

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of F/2."""
        return self._hessian(None)

    @cached_property
    def hessian(self) -> CSC:
        """The Riemannian Hessian of F/2."""
        return self._hessian(self.multipliers)

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the diagonal, positive, and one number for each position."""
        size, r = self.layout.unpack(np.abs(diagonal_of(H))), self.moves
        largest = np.full(size.shape[1], size[:, r:].max())
        if r:
            largest[:r] = size[:, :r].max()
            size[:, :r] = size[:, :r].mean(axis=1, keepdims=True)
        return np.asarray(self.layout.pack(np.maximum(size, 1e-12 * largest)))

    def raised(self, damping: float) -> float:
        """The damping after a failed step."""
        return max(10.0 * damping, DAMPING)

    def stationarity(self, scale: FloatArray) -> float:
        """The largest gradient over ``scale``, radians and shares of scales and lengths."""
        unpack, form, length = self.layout.unpack, self.problem.form, 1.0
        if self.moves:
            steps, tau = operators.steps(form, self.point), np.abs(form.tau)
            moved = float(tau @ np.einsum("ma,ma->m", steps, steps)) / float(tau.sum())
            length = math.sqrt(moved) or 1.0
        return largest_step(unpack(self.gradient), unpack(scale), self.moves, length)

    def factor(self, A: CSC) -> Factor | None:
        """The factor of a matrix with the same pattern."""
        factor: Factor | None = self.space.symbolic(A).factor(A)
        return factor

    def moved(self, x: FloatArray) -> Self:
        """The model after a step x (N,): the nearest admissible blocks, scales by exponentials."""
        step, r, space = self.layout.unpack(x), self.moves, self.space
        q = space.kinds.tangent_dim(self.rank, space.d)
        with np.errstate(all="ignore"):  # a step beyond all reason has no finite cost
            A = self.point.rotations
            t = translations_of(self.point) + step[:, :r] if r else None
            turn = np.einsum("nq,nqrd->nrd", step[:, r : r + q], self._basis[:, :q])
            Q = space.kinds.apply("nearest", (A + turn) / self._sizes[:, None, None])
            if not space.takes_scales:
                return type(self)(self.problem, Lift(Q, t))
            growth = np.where(space.kinds.scaled, np.clip(step[:, -1], -3.0, 3.0), 0.0)
            grown = self._sizes * np.exp(growth)
            return type(self)(self.problem, Lift(grown[:, None, None] * Q, t))
