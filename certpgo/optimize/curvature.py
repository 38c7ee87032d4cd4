"""Directions of negative curvature at stationary points of the relaxation."""

from __future__ import annotations

import numpy as np

from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.eigen import krylov_schur
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import Reduced

#: Shifts that make the certificate matrix definite, over the mean weight of a node.
GROWTH = 4.0
SHIFTS = tuple(1e-9 * GROWTH**k for k in range(18))
#: Relative accuracy of the eigenvector, which is only a direction.
ACCURACY = 0.05
#: Relative accuracy of displayed eigenvalues.
PICTURED = 1e-3
#: Number of inverse iterations.
INVERSE_ITERATIONS = 2
#: Negative eigenvalues above minus this, over the largest weight of a node, may be rounding.
RESOLUTION = 16.0 * float(np.finfo(float).eps)


def resolution(problem: Quadratic) -> float:
    """The size of negative eigenvalues of the certificate matrix that may be rounding."""
    return RESOLUTION * float(problem.curvature.max())


def negative_curvature(problem: Quadratic, point: Point) -> tuple[float, FloatArray]:
    """The smallest eigenvalue of the certificate matrix, and its eigenvector as rows (n, d).

    Translations are eliminated. The value is a Rayleigh quotient, hence an upper bound: if it is
    negative, its vector escapes from a local minimum at the next rank; else it proves nothing.

    Raises
    ------
    NumericalError
        A factorization failed, or the eigenvalue did not converge.
    """
    S, mean = _reduced(problem, problem.multipliers(point))
    # One vector more than the gauge's null vectors, which come next, so that it is not missed.
    start = np.random.default_rng(0).standard_normal((S.shape[0], problem.d + 1))
    for accuracy in (ACCURACY, PICTURED):
        v = krylov_schur(S, S.solve, 1, shift=S.shift, tol=accuracy, start=start).vectors
        # Components of large eigenvalues hardly matter in the inverse, but spoil the quotient.
        for _ in range(INVERSE_ITERATIONS):
            v = S.solve(v)
            v /= np.linalg.norm(v)
        value = float((v * (S @ v)).sum()) - S.shift
        # If a shift failed, there is an eigenvalue below minus that, but for rounding.
        if S.shift == SHIFTS[0] * mean or value < -0.5 * S.shift / GROWTH:
            break
    direction = np.zeros((problem.n, problem.d))
    direction[problem.poses] = v.reshape(-1, problem.d)
    return value, direction


def smallest_eigenvalues(problem: Quadratic, multipliers: FloatArray, k: int) -> FloatArray:
    """The k smallest eigenvalues of the certificate matrix, ascending, for display; not a proof.

    Translations are eliminated. At a stationary point, d eigenvalues (the gauge's) are zero.

    Parameters
    ----------
    multipliers : (n, d, d) Lam, as in a certificate

    Raises
    ------
    NumericalError
        A factorization failed, or the eigenvalues did not converge.
    """
    S, _ = _reduced(problem, multipliers)
    return krylov_schur(S, S.solve, min(k, S.shape[0]), shift=S.shift, tol=PICTURED).values


def _reduced(problem: Quadratic, multipliers: FloatArray) -> tuple[Reduced, float]:
    """The certificate matrix, translations eliminated, shifted until it is definite; the unit."""
    mean = float(problem.curvature[problem.poses].mean())
    matrix = problem.certificate_matrix(multipliers)
    return Reduced(problem, matrix, tuple(mean * shift for shift in SHIFTS)), mean
