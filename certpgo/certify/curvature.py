"""Directions in which a stationary point of the relaxation is no minimum."""

from __future__ import annotations

import numpy as np

from certpgo.lift import Point
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.eigen import krylov_schur
from certpgo.problem import Problem
from certpgo.reduced import Reduced

#: Shifts that make the certificate matrix definite, over the mean weight of a node.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(18))
#: Relative accuracy of the eigenvector: a direction, no proof.
ACCURACY = 0.05
#: Inverse iterations that follow.
INVERSE_ITERATIONS = 2


def negative_curvature(problem: Problem, point: Point) -> tuple[float, FloatArray]:
    """The smallest eigenvalue of the certificate matrix, and its eigenvector as rows (n, d).

    Translations are eliminated. The value is a Rayleigh quotient, hence an upper bound: a negative
    one shows a direction that leaves a local minimum through a new dimension; one that is not
    shows nothing.

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    matrix = problem.certificate_matrix(problem.multipliers(point))
    mean = float(problem.curvature.mean())
    S = Reduced(problem, matrix, tuple(mean * shift for shift in SHIFTS))
    # The gauge's null vectors come next: one vector more than they are, and it is not missed.
    start = np.random.default_rng(0).standard_normal((S.shape[0], problem.d + 1))
    v = krylov_schur(S, S.solve, 1, shift=S.shift, tol=ACCURACY, start=start).vectors
    # What is left of large eigenvalues hardly shows in the inverse, but spoils the quotient.
    for _ in range(INVERSE_ITERATIONS):
        v = S.solve(v)
        v /= np.linalg.norm(v)
    value = float((v * (S @ v)).sum()) - S.shift
    return value, v.reshape(problem.n, problem.d)
