"""Augmented Lagrangian multipliers for the completion of M_B in the l1 norm.

Jin et al. 2017 after Zheng et al., "Practical low-rank matrix approximation under robust L1-norm",
CVPR 2012; Moreira 2020, eq. 2.18. Theirs is

    minimise ||W o (Mtilde_B - M_B)||_1 + regularizer ||D||_*   such that   M_B = C D, C^T C = I

with the columns of C orthonormal, so that D has the singular values of M_B (the thesis' M_C has
C^T C = n I, and its norm is a constant then). In the augmented Lagrangian with multipliers Y

    ... + <Y, M_B - C D> + mu/2 ||M_B - C D||_F^2

Gauss-Seidel updates C, D, M_B in turn, each in closed form, then Y += mu (M_B - C D), mu *= growth.
At missing blocks the best M_B is C D and Y stays zero: only known blocks are stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from certpgo.errors import SpecError
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.progress import Progress

from ._completion import Completion, Known, LowRank, Start


@dataclass(frozen=True)
class AugmentedLagrangian(Completion):
    """RegL1-ALM with one sweep per iteration, sufficient according to Zheng et al.

    As the penalty always grows, it always converges, but rarely to the optimum.

    Attributes
    ----------
    tolerance : ||W o (M_B - C D)||_F over the norm of the known blocks, at which to stop
    max_iterations : stop anyway
    start : ``"measurements"``, with zeros for missing blocks, or ``"tree"``, which trusts outliers
    regularizer : weight of the nuclear norm
    penalty : initial mu
    growth : factor of mu per iteration
    """

    tolerance: float = 1e-7
    max_iterations: int = 1000
    start: Start = "measurements"
    regularizer: float = 1e-3
    penalty: float = 1e-2
    growth: float = 1.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.penalty > 0.0 and self.growth > 1.0 and self.regularizer >= 0.0):
            raise SpecError("penalty must be positive, growth above 1 and regularizer not negative")

    def complete(
        self, problem: Quadratic, known: Known, L: LowRank, progress: Progress
    ) -> FloatArray:
        """Minimise from the measured M_B, with L at missing blocks."""
        measured, product = known.blocks, known.at(L)
        M, Y, mu = measured, np.zeros_like(measured), self.penalty
        moved = 0.0
        while progress.advance(
            self.cost(measured - product, L), float(np.linalg.norm(M - product)) / known.size, moved
        ):
            before = product
            with progress.watch.phase("completion"):
                L = self.factors(known.matrix(M + Y / mu - product), L, mu)
                product = known.at(L)
                M = measured - shrunk(measured - product + Y / mu, 1.0 / mu)
                Y = Y + mu * (M - product)
                mu *= self.growth
            moved = float(np.linalg.norm(product - before))
        return L.C

    def cost(self, residuals: FloatArray, L: LowRank) -> float:
        """The objective at M_B = C D."""
        nuclear = float(np.linalg.svd(L.V, compute_uv=False).sum())
        return float(np.abs(residuals).sum()) + self.regularizer * nuclear

    def factors(self, change: sparse.bsr_array, L: LowRank, mu: float) -> LowRank:
        """C by Procrustes and D by shrinking singular values, for M_B + Y/mu = L + change."""
        left, _, right = np.linalg.svd(change @ L.V + L.C @ (L.V.T @ L.V), full_matrices=False)
        C = left @ right
        left, values, right = np.linalg.svd(change.T @ C + L.V @ (L.C.T @ C), full_matrices=False)
        return LowRank(C, left * shrunk(values, self.regularizer / mu) @ right)


def shrunk(X: FloatArray, threshold: float) -> FloatArray:
    """X after soft thresholding."""
    return np.asarray(X - np.clip(X, -threshold, threshold))


SOLVER = AugmentedLagrangian
