"""Where the measured residual stops being exact it says nothing, whatever it is given."""

from fractions import Fraction

import numpy as np
import pytest
from strategies import rng_of

from certpgo.linalg.arrays import CSC
from certpgo.linalg.residual import measured_residual


def exact_rows(A, L, w):
    """Row sums of |A - L L^T| w in rationals."""
    n = len(A)
    rows = []
    for i in range(n):
        left = (
            Fraction(A[i, j]) - sum(Fraction(L[i, k]) * Fraction(L[j, k]) for k in range(n))
            for j in range(n)
        )
        rows.append(sum(abs(x) * Fraction(y) for x, y in zip(left, w, strict=True)))
    return rows


@pytest.mark.parametrize("power", range(-2, 8))
def test_a_product_that_loses_its_last_bit_is_not_called_exact(power):
    """(2^k + 2^-24)^2 ends in 2^-48, which doubles do not hold from 2^5 on: its row weighs most."""
    x = 2.0**power + 2.0**-24
    A = np.array([[1.0, x * x], [x * x, 1.0]])
    L = np.array([[x, 0.0], [x, 0.25]])
    w = np.array([2.0**-200, 1.0])
    found = measured_residual(CSC(A), CSC(L), np.arange(2), w)
    exact = exact_rows(A, L, w)
    assert (found is None) == (power >= 2)
    if found is not None:
        assert all(Fraction(x) >= y for x, y in zip(found, exact, strict=True))
        assert found[0] <= 1.01 * float(exact[0]) + 1e-30


def test_rows_that_cancel_are_not_called_exact_either():
    """16 times 4 and 2^-48 less 16 times 4: no entry is large, nor is any column."""
    n = 32
    A, L = np.eye(n), 0.5 * np.eye(n)
    L[:2] = 2.0
    L[:2, 15] += 2.0**-24
    L[1, 16:] = -2.0
    A[0, 1] = A[1, 0] = 2.0**-22
    w = np.full(n, 2.0**-200)
    w[1] = 1.0
    assert exact_rows(A, L, w)[0] >= Fraction(1, 2**48)
    assert measured_residual(CSC(A), CSC(L), np.arange(n), w) is None


@pytest.mark.parametrize(("size", "passes"), [(1.0, True), (3.8, True), (3.95, False)])
def test_half_of_what_doubles_hold_is_used(size, passes):
    """Integers below 2^52 in units of 2^-48, that is sums below 16."""
    found = measured_residual(CSC(np.eye(2)), CSC(size * np.eye(2)), np.arange(2), np.ones(2))
    assert (found is not None) == passes


@pytest.mark.parametrize("seed", range(20))
def test_any_factor_of_anything_is_measured_or_refused(seed):
    rng, n = rng_of(seed), 6
    A = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-1, 2)
    A = A + A.T
    np.fill_diagonal(A, rng.uniform(0.3, 3.0, n))
    L = np.tril(rng.standard_normal((n, n))) * 10.0 ** rng.uniform(-1, 1)
    w = 10.0 ** rng.uniform(-40, 0, n)
    found = measured_residual(CSC(A), CSC(L), np.arange(n), w)
    large = np.abs(A).max() + (L**2).sum(axis=1).max()
    assert found is not None or large > 4.0
    if found is not None:
        assert all(Fraction(x) >= y for x, y in zip(found, exact_rows(A, L, w), strict=True))


@pytest.mark.parametrize("sign", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("seed", range(6))
def test_where_hardly_anything_is_left_the_rounding_of_the_rest_is_bounded(seed, sign):
    """Orthogonal rows: their entry of A is tiny, and so is what the nearest double leaves of it."""
    rng, n = rng_of(seed), 6
    L = np.linalg.qr(rng.standard_normal((n, n)))[0] @ np.diag(rng.uniform(0.8, 1.2, n))
    if sign:  # what is below 2^-24 all of one sign, in every second row
        whole = np.floor(L[1::2] * 2.0**24) / 2.0**24
        L[1::2] = whole + sign * 2.0**-24 * rng.uniform(0.1, 0.4, whole.shape)
    A = np.array(
        [
            [float(sum(Fraction(x) * Fraction(y) for x, y in zip(a, b, strict=True))) for b in L]
            for a in L
        ]
    )
    for k in range(n):
        w = np.full(n, 2.0**-200)
        w[k] = 1.0
        found, exact = measured_residual(CSC(A), CSC(L), np.arange(n), w), exact_rows(A, L, w)
        for x, y in zip(found, exact, strict=True):
            assert y <= Fraction(x) <= Fraction(101, 100) * y + Fraction(1, 2**70)


def test_a_diagonal_that_is_not_positive_is_refused():
    for value in (0.0, -1.0):
        A = np.diag([1.0, value])
        assert measured_residual(CSC(A), CSC(np.eye(2)), np.arange(2), np.ones(2)) is None
