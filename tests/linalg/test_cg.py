"""Conjugate gradients: against dense algebra, and honest about indefinite matrices."""

import numpy as np
import pytest
from scipy import sparse

from certpgo.linalg.cg import conjugate_gradients


def spd(seed, n=30):
    B = np.random.default_rng(seed).standard_normal((n, n))
    return B @ B.T + n * np.eye(n)


@pytest.mark.parametrize("seed", range(5))
def test_solves_and_returns_the_residual(seed):
    A = spd(seed)
    b = np.random.default_rng(seed).standard_normal(30)
    x, r = conjugate_gradients(
        sparse.csc_array(A), b, lambda v: v / np.diag(A), tol=1e-12, max_iterations=100
    )
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=0, atol=1e-11)
    np.testing.assert_allclose(r, b - A @ x, rtol=0, atol=1e-9)


def test_an_exact_preconditioner_takes_one_product():
    A = spd(1)
    b = np.ones(30)
    x, _ = conjugate_gradients(
        sparse.csc_array(A), b, lambda v: np.linalg.solve(A, v), tol=1e-8, max_iterations=1
    )
    np.testing.assert_allclose(A @ x, 1.0, rtol=0, atol=1e-9)


def test_negative_curvature_and_the_limit_give_none():
    A = sparse.csc_array(np.diag([1.0, 2.0, -1.0]))
    assert conjugate_gradients(A, np.ones(3), lambda v: v, tol=1e-8, max_iterations=10) is None
    B = sparse.csc_array(spd(2))
    assert conjugate_gradients(B, np.ones(30), lambda v: v, tol=1e-12, max_iterations=2) is None
