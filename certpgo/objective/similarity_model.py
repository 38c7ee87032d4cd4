"""The quadratic model of F over similarities."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Self

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.relaxed_point import Lift, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.factor import Factor
from certpgo.objective import operators
from certpgo.objective.quadratic_model import ROUNDING, largest_step

#: Damping that fixes the gauge, and the least after a step that fails, relative to the diagonal.
GAUGE, DAMPING = 1e-12, 1e-4


class SimilarityModel:
    """F near a point of rank r, a `QuadraticModel` over translations, turns and log-scales.

    Parameters
    ----------
    problem : a `certpgo.objective.similarity_problem.SimilarityProblem`
    """

    def __init__(self, problem: Any, point: Lift) -> None:
        self.problem, self.point = problem, problem.blocks(point)
        self.rank = self.point.rotations.shape[1]
        self.layout = problem.layout(self.rank)
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
        return ROUNDING * self.cost

    @cached_property
    def euclidean(self) -> FloatArray:
        """Half the Euclidean gradient, (n, r, d + 1)."""
        return np.asarray(self.problem.gradient(self.point))

    @property
    def _poses(self) -> int:
        return len(self.problem.held)

    @cached_property
    def _basis(self) -> FloatArray:
        """(n, q + 1, r, d) tangents: turns by a radian, then growth by a factor of e."""
        A, free = self.point.rotations, self.problem.graph.free
        s = self.problem.sizes_of(A)
        turns = math.sqrt(2.0) * so.tangent_basis(A / s[:, None, None])
        growth = np.where(free[:, None, None], A, 0.0)
        return np.concatenate([s[:, None, None, None] * turns, growth[:, None]], axis=1)

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of F."""
        G = self.euclidean
        if self.problem.in_mean_unit:  # of F over the mean square of the scales
            G = G.copy()
            pull = np.where(self.problem.graph.free, self.cost / (self.problem.d * self._poses), 0)
            G[:, :, 1:] -= pull[:, None, None] * self.point.rotations
        turn = np.einsum("nqrd,nrd->nq", self._basis, G[:, :, 1:])
        return np.asarray(self.layout.pack(np.concatenate([G[:, :, 0], turn], axis=1)))

    def _hessian(self, measured: Graph, multipliers: FloatArray) -> CSC:
        problem = self.problem
        diagonal, upper = operators.lifted_hessian(measured, self._basis, multipliers)
        known = ~problem.graph.free
        diagonal[known, -1, -1] = 1.0 + np.abs(diagonal[known, self.rank, self.rank])
        return problem.pattern.assemble(diagonal, upper, self.rank)

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of F/2."""
        return self._hessian(self.problem.form, np.zeros((self.problem.n,) + (self.problem.d,) * 2))

    @cached_property
    def hessian(self) -> CSC:
        """The Riemannian Hessian of F/2."""
        Lam = self.problem.multipliers_at(self.point, self.euclidean)
        return self._hessian(self.problem.form, Lam)

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the diagonal, positive, and one number for each position."""
        size, r = self.layout.unpack(np.abs(H.diagonal())), self.rank
        largest = np.repeat([size[:, :r].max(), size[:, r:].max()], [r, size.shape[1] - r])
        size[:, :r] = size[:, :r].mean(axis=1, keepdims=True)
        return np.asarray(self.layout.pack(np.maximum(size, 1e-12 * largest)))

    def raised(self, damping: float) -> float:
        """The damping after a failed step."""
        return max(10.0 * damping, DAMPING)

    def stationarity(self, scale: FloatArray) -> float:
        """The largest gradient over ``scale``, radians and shares of scales and lengths."""
        unpack, graph = self.layout.unpack, self.problem.graph
        steps = operators.steps(self.problem.form, self.point)
        moved = float(graph.tau @ np.einsum("ma,ma->m", steps, steps)) / float(graph.tau.sum())
        length = math.sqrt(moved) or 1.0
        return largest_step(unpack(self.gradient), unpack(scale), self.rank, length)

    def factor(self, A: CSC) -> Factor | None:
        """The factor of a matrix with the same pattern."""
        factor: Factor | None = self.problem.symbolic(A).factor(A)
        return factor

    def moved(self, x: FloatArray) -> Self:
        """The model after a step x (N,): the nearest admissible blocks, scales by exponentials."""
        step, r, problem = self.layout.unpack(x), self.rank, self.problem
        with np.errstate(all="ignore"):  # a step beyond all reason has no finite cost
            A, t = self.point.rotations, translations_of(self.point) + step[:, :r]
            s = problem.sizes_of(A)
            turn = np.einsum("nq,nqrd->nrd", step[:, r:-1], self._basis[:, :-1])
            Q = so.orthonormal((A + turn) / s[:, None, None])
            growth = np.where(problem.graph.free, np.clip(step[:, -1], -3.0, 3.0), 0.0)
            grown = np.where(problem.graph.free, s * np.exp(growth), 1.0)
            return type(self)(problem, Lift(grown[:, None, None] * Q, t))
