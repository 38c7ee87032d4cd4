"""EIG-SE(3): poses or rotations from four, or b, eigenvectors of the block matrix at once.

Arrigoni, Rossi and Fusiello, "Spectral synchronization of multiple views in SE(3)" (SIAM J. Imaging
Sciences 9, 2016); Moreira 2020, section 2.3. The constraint M_C^-b M_C = n I of min ||(A x 1) o
(M_B - M_C M_C^-b)||_F is kept in a relaxed form, and the block column M_C is spanned by null
vectors of L = (Laplacian x 1) o M_B: see `_eig_se3`. Then it is brought to last lines [0 ... 0 1]
and projected, see `_blocks`.

Thesis eq. 2.19 takes singular vectors of L, left ones in its words and right ones by its eq. 2.20.
Its Table 5.7 does not: the printed digits of Sphere, -516589.2, are those of the leading
*eigenvectors* of (D + I)^-1 (A + I), which is what the default computes. There none of the four
is a rotation's: noise has lifted those eigenvalues of L above the smallest of the graph Laplacian,
which are eigenvalues of L too. That is how EIG-SE(3) fails on sparse graphs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.objective.problem import Problem
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

from ._blocks import poses_of
from ._eig_se3 import leading_eigenvectors, trailing_singular_vectors

Vectors = Literal["eigen", "singular"]
Weights = Literal["graph", "unit"]


@dataclass(frozen=True)
class EigSE3:
    """EIG-SE(3) on poses, EIG-SO(3) on rotations alone; d = 2 and 3.

    Attributes
    ----------
    vectors : ``"eigen"`` takes leading eigenvectors of the block matrix normalized by degrees,
        ``"singular"`` right singular vectors of L, whose singular values are the smallest
    weights : ``"unit"`` weighs every edge alike, as the papers do; ``"graph"`` takes kappa, for
        rotation and translation alike, as a block has one weight
    tol : relative accuracy of the vectors
    """

    vectors: Vectors = "eigen"
    weights: Weights = "unit"
    tol: float = 1e-9

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for what, value, known in (
            ("vectors", self.vectors, ("eigen", "singular")),
            ("weights", self.weights, ("graph", "unit")),
        ):
            if value not in known:
                raise SpecError.unknown(what, value, known)
        if not 0.0 < self.tol < 1.0:
            raise SpecError(f"tol must lie between 0 and 1, not {self.tol}")

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses or rotations of the problem.

        Raises
        ------
        NumericalError
            No factorization, or no convergence of the vectors.
        """
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
            note="edges weigh alike" if self.weights == "unit" else "edges weigh kappa",
        )


SOLVER = EigSE3
