"""Matrices straight into the checker's factorization: what it may say of them, and when nothing."""

import numpy as np
import pytest
from strategies import rng_of

from certpgo import checker

BITS_OF_INPUT = 90


def blocks_of(A, b):
    """The blocks of a symmetric matrix of integers times 2^-BITS_OF_INPUT, all pairs stored."""
    n = len(A) // b
    A = np.array(A, dtype=object).reshape(n, b, n, b).swapaxes(1, 2)
    pairs = np.stack(np.triu_indices(n, 1), axis=1)
    parts = []
    for entries in (A[np.arange(n), np.arange(n)], A[pairs[:, 0], pairs[:, 1]]):
        parts.append(checker._parts(entries, np.full(entries.shape, -BITS_OF_INPUT)))
    high, low = zip(*parts, strict=True)
    return checker.Blocks(pairs, high, low, np.ones((n, b)), np.zeros((n, b), dtype=np.intp))


def gram(rng, N, rank):
    """N vectors of length about 1/2 in ``rank`` dimensions, and their products, exact integers."""
    X = rng.standard_normal((N, rank))
    X = (X / np.linalg.norm(X, axis=1)[:, None] * 2.0**29).round().astype(np.int64).astype(object)
    return X, (X @ X.T) << (BITS_OF_INPUT - 60)


def accepted(A, b, delta):
    order = rng_of(len(A)).permutation(len(A) // b)
    return checker.is_positive_semidefinite(blocks_of(A, b), order, np.full(len(A), delta))


@pytest.mark.parametrize("b", [2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_a_matrix_with_a_null_vector_passes_only_with_something_added(seed, b):
    """And never with anything taken off, however little: 2^-89 is seen as well as 2^-20."""
    rng, N = rng_of(seed), 6 * b
    _, A = gram(rng, N, N - 2)
    identity = np.eye(N, dtype=int).astype(object)
    for shift in (0, 1, 10, 30, 40, 50, 70):  # 2^-90 to 2^-20
        for delta in (0.0, 2.0**-50, 2.0 ** (shift - 91)):
            assert not accepted(A - (identity << shift), b, delta)
    for digits in (20, 30, 40, 45):
        assert accepted(A + (identity << (BITS_OF_INPUT - digits)), b, 2.0 ** (-digits - 1))


@pytest.mark.parametrize("share", [0.3, 0.9, 0.98, 1.02, 1.1, 4.0])
def test_sums_that_might_not_be_exact_prove_nothing(share, monkeypatch):
    """Integers below 2^53 are doubles: what a row adds up to in units of 4^-BITS may have 2^52."""
    diagonal, limit = 0.5, 2.0**52 / 4.0**checker.BITS
    size = np.sqrt(share * limit - diagonal)
    monkeypatch.setattr(np.linalg, "cholesky", lambda A: size * np.eye(A.shape[-1]) + 0.0 * A)
    monkeypatch.setattr(checker, "_refined", lambda H, G, delta, L, L1, inverse: L - L1)
    A = np.eye(4, dtype=int).astype(object) << (BITS_OF_INPUT - 1)
    found = checker.residual(blocks_of(A, 2), np.arange(2), np.zeros(4))
    assert (found is None) == (share > 1.0)
    # That much of a factor leaves a negative diagonal: nothing is proven either way.
    assert found is None or share < 0.5 or found.diagonal.max() < 0.0


def test_rows_that_got_too_little_get_more_and_others_do_not():
    """Half of the identity bears 0.3 off three rows, and not twice that; the last gets nothing."""
    A = np.eye(4, dtype=int).astype(object) << (BITS_OF_INPUT - 1)
    blocks, order, delta = blocks_of(A, 2), np.arange(2), np.array([0.3, 0.3, 0.3, 0.0])
    found = checker.residual(blocks, order, delta)
    assert (found.diagonal >= found.needed).tolist() == [True, True, True, False]
    assert checker.is_positive_semidefinite(blocks, order, delta)
    assert checker.residual(blocks, order, 2.0 * delta) is None
