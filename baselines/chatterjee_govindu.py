"""Chatterjee and Govindu's robust rotation averaging: L1RA, then IRLS with the l_1/2 loss.

"Efficient and robust large-scale rotation averaging" (ICCV 2013), "Robust relative rotation
averaging" (PAMI 2018). For world-frame tangents R_i <- exp(delta_i) R_i an edge's residual
b = log(R_i R_ij R_j^T) vanishes to first order if delta_j - delta_i = b: A delta = b with A the
incidence matrix, one column per axis. L1RA iterates delta = argmin sum |A delta - b|, entrywise,
here by the alternating direction method of multipliers (Boyd et al. 2011, section 6.1), whose
linear systems share one factor, of the graph Laplacian A^T A. Then IRLS iterates least squares with
the weights of the loss |b|^(1/2), w = |b|^(-3/2). The papers' scale of 5 degrees does not affect
this loss. As in the authors' code weights are at most 1e8, and the first step has unit weights: the
tree's edges initially fit exactly, and their weights would prevent any change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.errors import NumericalError, SpecError
from certpgo.graph import Estimate
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.factor import Factor
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

#: The largest weight of an edge, for well-conditioned least squares.
HEAVIEST = 1e8


@dataclass(frozen=True)
class ChatterjeeGovindu(Iterative):
    """L1-IRLS on rotations, d = 2 and 3; local, initialized by a breadth-first tree.

    The graph's own weights are not used.

    Attributes
    ----------
    l1_iterations : maximal number of L1RA iterations; with 0 IRLS starts from the tree
    inner_iterations : of the method of multipliers in each of them
    tolerance : mean rotation of a node at which L1RA and IRLS stop, radians
    max_iterations : of IRLS
    """

    l1_iterations: int = 10
    inner_iterations: int = 50
    tolerance: float = 1e-3
    max_iterations: int = 250

    poses: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.l1_iterations < 0 or self.inner_iterations < 1:
            raise SpecError("l1_iterations must not be negative, inner_iterations at least 1")

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations of the problem; translations, if any, are ignored."""
        watch, rotation = Stopwatch(), problem.rotation
        rotation.require_joined()
        if initial is not None:
            problem.check(initial)
        with watch.phase("start"):
            R = (initial or tree_initialization(rotation.graph)).rotations
        with watch.phase("l1"):
            R = self._l1ra(rotation, R)
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        w, moved = np.ones(rotation.graph.num_edges), math.inf
        while progress.advance(rotation.cost(Estimate.trusted(R)), moved, moved):
            with watch.phase("irls"):
                b = logarithms(rotation, R)
                delta = laplacian_factor(rotation, w).solve(divergence(rotation, w[:, None] * b))
                R = so.exp(delta) @ R
                w = half_weights(np.linalg.norm(logarithms(rotation, R), axis=1))
                moved = mean_turn(delta)
        estimate = Estimate(so.project(R))
        note = "equal edge weights before reweighting"
        return progress.solution(estimate, rotation.cost(estimate), note=note)

    def _l1ra(self, problem: Quadratic, R: FloatArray) -> FloatArray:
        """Rotations after successive linearized l1 regressions."""
        factor = laplacian_factor(problem, np.ones(problem.graph.num_edges))
        for _ in range(self.l1_iterations):
            b = logarithms(problem, R)
            delta = l1_regression(problem, factor, b, self.inner_iterations)
            R = so.exp(delta) @ R
            if mean_turn(delta) <= self.tolerance:
                break
        return R


def logarithms(problem: Quadratic, R: FloatArray) -> FloatArray:
    """(m, p) world-frame tangents log(R_i R_ij R_j^T), radians."""
    i, j = problem.graph.edges.T
    return so.log(R[i] @ problem.graph.rotations @ np.swapaxes(R[j], 1, 2))


def divergence(problem: Quadratic, flow: FloatArray) -> FloatArray:
    """(n, p) A^T flow of edge vectors (m, p), with the first node fixed."""
    i, j = problem.graph.edges.T
    total = scatter_sum(j, flow, problem.n) - scatter_sum(i, flow, problem.n)
    total[0] = 0.0
    return total


def laplacian_factor(problem: Quadratic, weights: FloatArray) -> Factor:
    """The factor of A^T diag(weights) A, with the first node fixed."""
    factor = problem.grounded_factor(operators.laplacian(problem.pattern, weights))
    if factor is None:
        raise NumericalError("the graph Laplacian could not be factorized")
    return factor


def l1_regression(problem: Quadratic, factor: Factor, b: FloatArray, iterations: int) -> FloatArray:
    """(n, p) delta near argmin sum |A delta - b|, the first zero.

    Parameters
    ----------
    factor : of A^T A
    b : (m, p)
    iterations : of the method of multipliers; its threshold is the median entry of b
    """
    i, j = problem.graph.edges.T
    threshold = float(np.median(np.abs(b)))
    z, u = np.zeros_like(b), np.zeros_like(b)
    delta = np.zeros((problem.n, b.shape[1]))
    for _ in range(iterations):
        delta = factor.solve(divergence(problem, b + z - u))
        r = delta[j] - delta[i] - b + u
        z = np.sign(r) * np.maximum(np.abs(r) - threshold, 0.0)
        u = r - z
    return delta


def half_weights(angles: FloatArray) -> FloatArray:
    """(m,) weights |b|^(-3/2) of the loss |b|^(1/2), at most `HEAVIEST`."""
    return np.asarray(np.maximum(angles, HEAVIEST ** (-2.0 / 3.0)) ** -1.5)


def mean_turn(delta: FloatArray) -> float:
    """Mean angle of tangents (n, p), radians."""
    return float(np.linalg.norm(delta, axis=1).mean())


SOLVER = ChatterjeeGovindu
