"""Eigensolvers against dense algebra, clusters and multiplicities included."""

import numpy as np
import pytest
from scipy import sparse

from certpgo.errors import NumericalError
from certpgo.linalg.eigen import arpack, krylov_schur


def with_spectrum(values, seed=0):
    N = len(values)
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((N, N)))[0]
    A = sparse.csc_array((Q * values) @ Q.T)
    inverse = (Q / values) @ Q.T
    return A, lambda B: inverse @ B, Q


SPECTRA = {
    "spread": np.linspace(1.0, 100.0, 60),
    "cluster": np.r_[1.0, 1.0 + 1e-9, 1.0 + 2e-9, np.linspace(3.0, 9.0, 57)],
    "multiple": np.r_[0.5, 0.5, 0.5, 0.5, np.linspace(0.6, 9.0, 56)],
    "crowded": np.r_[np.linspace(1.0, 1.2, 30), np.linspace(2.0, 9.0, 30)],
}


@pytest.mark.parametrize("name", SPECTRA)
@pytest.mark.parametrize("k", [1, 3])
def test_smallest_pairs(name, k):
    A, solve, _ = with_spectrum(SPECTRA[name])
    pairs = krylov_schur(A, solve, k)
    np.testing.assert_allclose(pairs.values, np.sort(SPECTRA[name])[:k], rtol=1e-9, atol=0)
    assert np.all(pairs.residuals <= 1e-7)
    np.testing.assert_allclose(pairs.vectors.T @ pairs.vectors, np.eye(k), rtol=0, atol=1e-12)


def test_restarts_find_the_same_space():
    A, solve, Q = with_spectrum(SPECTRA["crowded"])
    pairs = krylov_schur(A, solve, 3, max_basis=15)
    overlap = np.linalg.svd(Q[:, :3].T @ pairs.vectors)[1]
    np.testing.assert_allclose(overlap, 1.0, rtol=0, atol=1e-7)


def test_shift_is_taken_off():
    values = np.r_[1e-3, 1.1e-3, 1.2e-3, np.linspace(3.0, 9.0, 57)]
    A, _, Q = with_spectrum(values)
    shifted = sparse.csc_array(A + sparse.eye_array(60) * 0.5)
    inverse = (Q / (values + 0.5)) @ Q.T
    pairs = krylov_schur(shifted, lambda B: inverse @ B, 3, shift=0.5)
    np.testing.assert_allclose(pairs.values, values[:3], rtol=0, atol=1e-13)


def test_arpack_agrees_where_eigenvalues_are_simple():
    A, solve, _ = with_spectrum(SPECTRA["spread"])
    ours, theirs = krylov_schur(A, solve, 3), arpack(A, solve, 3)
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-10, atol=0)
    assert theirs.solves > 0


def test_tiny_matrices_are_exhausted():
    A, solve, _ = with_spectrum(np.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(krylov_schur(A, solve, 3).values, [1, 2, 4], rtol=1e-12, atol=0)


def test_gives_up_in_words():
    A, solve, _ = with_spectrum(SPECTRA["crowded"])
    with pytest.raises(NumericalError, match="no 3 smallest eigenpairs within"):
        krylov_schur(A, solve, 3, max_solves=3)
