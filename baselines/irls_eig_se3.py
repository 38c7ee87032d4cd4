"""IRLS EIG-SE(3): EIG-SE(3) with iteratively reweighted measurements.

Arrigoni, Rossi and Fusiello, "Spectral synchronization of multiple views in SE(3)" (SIAM J. Imaging
Sciences 9, 2016); Moreira 2020, section 2.3 and Table 5.4. Weights are those of Cauchy's function,
w = 1 / (1 + (r / (2.385 s))^2), r = ||M_ij - M_i M_j^-1||_F the residual of an edge and
s = 1.4826 MAD(r) their scale. As in the authors' code the identities M_ii weigh as much as the best
edge. On sparse graphs, smaller weights reduce the graph Laplacian's eigenvalues until they displace
those of the rotations, see `_eig_se3`, and the iterations fail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

from ._blocks import poses_of
from ._eig_se3 import leading_eigenvectors

#: Cauchy's constant, 95 % efficient for normal residuals, and their standard deviation over MAD.
CAUCHY, CONSISTENT = 2.385, 1.4826


@dataclass(frozen=True)
class IrlsEigSE3(Iterative):
    """Robust EIG-SE(3) on poses, EIG-SO(3) on rotations alone; d = 2 and 3.

    The graph's own weights are not used; initially all edges have equal weights.

    Attributes
    ----------
    tolerance : relative change of the weights at which to stop
    max_iterations : stop anyway
    tol : relative accuracy of the eigenvectors
    """

    tolerance: float = 1e-3
    max_iterations: int = 30
    tol: float = 1e-9

    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses or rotations; the trace shows the change of the weights."""
        watch = Stopwatch()
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        w, change = np.ones(problem.rotation.graph.num_edges), math.inf
        while True:
            with watch.phase("eigen"):
                column = leading_eigenvectors(problem, w, float(w.max()), tol=self.tol)
            with watch.phase("reweight"):
                estimate = poses_of(column, problem)
                before, w = w, cauchy_weights(residual_norms(problem, estimate))
                change = float(np.linalg.norm(w - before) / np.linalg.norm(before))
            cost = problem.cost(estimate)
            if not progress.advance(cost, change, change):
                break
        return progress.solution(estimate, cost, note="equal edge weights before reweighting")


def residual_norms(problem: Quadratic, estimate: Estimate) -> FloatArray:
    """(m,) ||M_ij - M_i M_j^-1||_F, from R_j - R_i R_ij and t_j - t_i - R_i t_ij."""
    rotation = problem.rotation.residuals(estimate.rotations)
    squares = np.einsum("mab,mab->m", rotation, rotation)
    if problem.has_positions:
        translation = problem.translation_residuals(estimate)
        squares = squares + np.einsum("ma,ma->m", translation, translation)
    return np.sqrt(squares)


def cauchy_weights(residuals: FloatArray) -> FloatArray:
    """(m,) weights in (0, 1] of residuals (m,); ones where the residuals have no spread."""
    scale = CONSISTENT * float(np.median(np.abs(residuals - np.median(residuals))))
    if scale == 0.0:
        return np.ones_like(residuals)
    return np.asarray(1.0 / (1.0 + (residuals / (CAUCHY * scale)) ** 2))


SOLVER = IrlsEigSE3
