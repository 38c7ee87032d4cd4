"""Directions in which a stationary point of the relaxation is no minimum."""

from __future__ import annotations

import numpy as np

from certpgo.graph.lift import Point
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.eigen import krylov_schur
from certpgo.objective.problem import Problem
from certpgo.objective.reduced import Reduced

#: Shifts that make the certificate matrix definite, over the mean weight of a node.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(18))
#: Relative accuracy of the eigenvector: a direction, no proof.
ACCURACY = 0.05
#: Relative accuracy of eigenvalues that are shown.
PICTURED = 1e-3
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
    S = _reduced(problem, problem.multipliers(point))
    # The gauge's null vectors come next: one vector more than they are, and it is not missed.
    start = np.random.default_rng(0).standard_normal((S.shape[0], problem.d + 1))
    v = krylov_schur(S, S.solve, 1, shift=S.shift, tol=ACCURACY, start=start).vectors
    # What is left of large eigenvalues hardly shows in the inverse, but spoils the quotient.
    for _ in range(INVERSE_ITERATIONS):
        v = S.solve(v)
        v /= np.linalg.norm(v)
    value = float((v * (S @ v)).sum()) - S.shift
    return value, v.reshape(problem.n, problem.d)


def smallest_eigenvalues(problem: Problem, multipliers: FloatArray, k: int) -> FloatArray:
    """The k smallest eigenvalues of the certificate matrix, ascending, to be looked at; no proof.

    Translations are eliminated. At a stationary point d of them, the gauge's, are zero.

    Parameters
    ----------
    multipliers : (n, d, d) Lam, as a certificate holds them

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    S = _reduced(problem, multipliers)
    return krylov_schur(S, S.solve, min(k, S.shape[0]), shift=S.shift, tol=PICTURED).values


def _reduced(problem: Problem, multipliers: FloatArray) -> Reduced:
    """The certificate matrix, translations eliminated, shifted until it is definite."""
    mean = float(problem.curvature.mean())
    matrix = problem.certificate_matrix(multipliers)
    return Reduced(problem, matrix, tuple(mean * shift for shift in SHIFTS))
