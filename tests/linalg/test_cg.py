"""Conjugate gradients: against dense algebra, and honest about indefinite matrices."""

import numpy as np
import pytest

from certpgo.linalg.cg import End, conjugate_gradients


def spd(seed, n=30):
    B = np.random.default_rng(seed).standard_normal((n, n))
    return B @ B.T + n * np.eye(n)


@pytest.mark.parametrize("seed", range(5))
def test_solves_and_returns_the_residual(seed):
    A = spd(seed)
    b = np.random.default_rng(seed).standard_normal(30)
    solved = conjugate_gradients(
        A.__matmul__, b, lambda v: v / np.diag(A), tol=1e-12, max_iterations=100
    )
    assert solved.end is End.CONVERGED
    np.testing.assert_allclose(solved.x, np.linalg.solve(A, b), rtol=0, atol=1e-11)
    np.testing.assert_allclose(solved.residual, b - A @ solved.x, rtol=0, atol=1e-9)


def test_an_exact_preconditioner_takes_one_product():
    A = spd(1)
    solved = conjugate_gradients(
        A.__matmul__, np.ones(30), lambda v: np.linalg.solve(A, v), tol=1e-8, max_iterations=1
    )
    assert (solved.end, solved.products) == (End.CONVERGED, 1)
    np.testing.assert_allclose(A @ solved.x, 1.0, rtol=0, atol=1e-9)


def test_negative_curvature_and_the_limit():
    A = np.diag([1.0, 2.0, -1.0])
    solved = conjugate_gradients(A.__matmul__, np.ones(3), lambda v: v, tol=1e-8, max_iterations=10)
    assert solved.end is End.NEGATIVE_CURVATURE
    np.testing.assert_allclose(solved.residual, 1.0 - A @ solved.x)
    B = spd(2)
    solved = conjugate_gradients(
        B.__matmul__, np.ones(30), lambda v: v, tol=1e-12, max_iterations=2
    )
    assert (solved.end, solved.products) == (End.LIMIT, 2)


@pytest.mark.parametrize("radius", [1e-3, 0.05, 0.1])
def test_a_trust_region_is_reached_and_never_left(radius):
    weights = np.linspace(1.0, 3.0, 30)  # the region is an ellipsoid in the preconditioner's norm
    for A in (spd(3), np.diag(np.linspace(-1.0, 5.0, 30))):
        solved = conjugate_gradients(
            A.__matmul__,
            np.ones(30),
            lambda v: v / weights,
            tol=1e-10,
            max_iterations=100,
            radius=radius,
        )
        size = np.sqrt(solved.x @ (weights * solved.x))
        assert size == pytest.approx(radius, rel=1e-9)
        assert solved.end in (End.BOUNDARY, End.NEGATIVE_CURVATURE)
        np.testing.assert_allclose(solved.residual, 1.0 - A @ solved.x, rtol=0, atol=1e-9)


def test_a_wide_region_changes_nothing():
    A = spd(4)
    free, held = (
        conjugate_gradients(
            A.__matmul__, np.ones(30), lambda v: v, tol=1e-10, max_iterations=100, radius=radius
        )
        for radius in (np.inf, 10.0)
    )
    np.testing.assert_array_equal(free.x, held.x)


@pytest.mark.parametrize(("off", "solves"), [(1.0005, 1), (1.1, 2)])
def test_a_preconditioner_that_is_nearly_exact_is_trusted(off, solves):
    """A length of the first step within ``trust`` of 1 saves the solve that would confirm it."""
    A, asked = spd(5), []

    def precondition(v):
        asked.append(v)
        return np.linalg.solve(off * A, v)

    solved = conjugate_gradients(
        A.__matmul__, np.ones(30), precondition, tol=0.1, max_iterations=9, trust=0.01
    )
    assert (solved.end, solved.products, len(asked)) == (End.CONVERGED, 1, solves)
    np.testing.assert_allclose(A @ solved.x, 1.0, rtol=0, atol=1e-9)
