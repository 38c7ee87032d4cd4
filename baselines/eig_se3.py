"""EIG-SE(3): poses or rotations from b eigenvectors of the block matrix.

Arrigoni, Rossi and Fusiello, "Spectral synchronization of multiple views in SE(3)" (SIAM J. Imaging
Sciences 9, 2016); Moreira 2020, section 2.3. The constraint M_C^-b M_C = n I of min ||(A x 1) o
(M_B - M_C M_C^-b)||_F is relaxed, and the block column M_C is spanned by null vectors of
L = (Laplacian x 1) o M_B: see `_eig_se3`. Its last rows are then made [0 ... 0 1], and its blocks
projected, see `_blocks`.

Thesis eq. 2.19 uses singular vectors of L, left ones in its text and right ones in its eq. 2.20.
Its Table 5.7 does not: the printed digits of Sphere, -516589.2, belong to the leading
*eigenvectors* of (D + I)^-1 (A + I), the default here. There none of the four belongs to the
rotations: noise has increased their eigenvalues above the smallest ones of the graph Laplacian,
which are eigenvalues of L too. That is how EIG-SE(3) fails on sparse graphs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

from ._blocks import poses_of
from ._eig_se3 import leading_eigenvectors, trailing_singular_vectors

Vectors = Literal["eigen", "singular"]
Weights = Literal["graph", "unit"]


@dataclass(frozen=True)
class EigSE3(Settings):
    """EIG-SE(3) on poses, EIG-SO(3) on rotations alone; d = 2 and 3.

    Attributes
    ----------
    vectors : ``"eigen"`` for the leading eigenvectors of the block matrix normalized by degrees,
        ``"singular"`` for the right singular vectors of L with the smallest singular values
    weights : ``"unit"`` weighs every edge equally, as the papers do; ``"graph"`` uses kappa, also
        for translations, as a block has one weight
    tol : relative accuracy of the vectors
    """

    vectors: Vectors = "eigen"
    weights: Weights = "unit"
    tol: float = 1e-9

    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses or rotations of the problem."""
        watch = Stopwatch()
        kappa = problem.rotation.graph.kappa
        w = np.ones_like(kappa) if self.weights == "unit" else kappa
        with watch.phase("eigen"):
            if self.vectors == "eigen":
                column = leading_eigenvectors(problem, w, float(w.max()), tol=self.tol)
            else:
                column = trailing_singular_vectors(problem, w, tol=self.tol)
        with watch.phase("round"):
            estimate = poses_of(column, problem)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=Status.CLOSED_FORM,
            seconds=watch.seconds,
            note="equal edge weights" if self.weights == "unit" else "edge weights kappa",
        )


SOLVER = EigSE3
