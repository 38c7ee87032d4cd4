"""What an engine adds to the rounding of a Cholesky factorization, against rational arithmetic."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse
from strategies import rng_of

from certpgo.linalg import factor, superlu
from certpgo.linalg.arrays import CSC

U = Fraction(1, 2**53)
N = 9


def of_superlu(rng):
    """The factors of a matrix whose rows differ in size."""
    B = rng.standard_normal((N, N)) * (rng.random((N, N)) < 0.5)
    D = np.diag(10.0 ** rng.uniform(-2, 2, N))
    A = D @ (B @ B.T + np.eye(N)) @ D
    return factor.factorize(CSC(0.5 * (A + A.T)), engine="superlu")


def of_laplacian(rng):
    """The factors of a matrix without positive entries beside the diagonal."""
    A = -np.triu(rng.uniform(0.1, 1, (N, N)) * (rng.random((N, N)) < 0.5), 1)
    A = A + A.T
    return factor.factorize(CSC(A - np.diag(1.001 * A.sum(axis=1) - 0.1)), engine="superlu")


def of_nothing(rng):
    """Triangles that have nothing in common: of their difference no digit is lost."""
    L = np.tril(rng.standard_normal((N, N)), -1) + np.eye(N)
    upper = np.triu(rng.standard_normal((N, N)))
    upper[np.diag_indices(N)] = rng.uniform(1, 2, N)
    lu = SimpleNamespace(L=sparse.csc_array(L), U=sparse.csc_array(upper), perm_c=np.arange(N))
    return superlu.SuperLUFactor(lu, upper.diagonal(), np.arange(N), sparse.csc_array(L @ upper))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("made", [of_superlu, of_laplacian, of_nothing])
def test_excess_bounds_what_superlu_lost_of_the_symmetry(made, seed):
    """U is D L^T but for rounding: by so much, times |L|, L U is not the Cholesky product."""
    rng = rng_of(seed)
    F, w = made(rng), 10.0 ** rng.uniform(-6, 6, N)
    L, upper = (
        [[Fraction(float(x)) for x in row] for row in A.toarray()] for A in (F._lu.L, F._lu.U)
    )
    weights = [Fraction(float(x)) for x in w]
    lost, sizes = [], []
    for k in range(N):
        pairs = [(upper[k][j], upper[k][k] * L[j][k], weights[j]) for j in range(N)]
        lost.append(sum(abs(x - y) * v for x, y, v in pairs))
        sizes.append(sum((abs(x) + abs(y)) * v for x, y, v in pairs))
    F.lower()  # does not touch what the excess is of
    for row, found in zip(L, F.excess(w), strict=True):
        exact = sum(abs(x) * y for x, y in zip(row, lost, strict=True))
        rounding = U * sum(abs(x) * y for x, y in zip(row, sizes, strict=True))
        enough = (1 + 40 * U) * exact + 6 * rounding
        assert exact <= Fraction(float(found)) <= enough
