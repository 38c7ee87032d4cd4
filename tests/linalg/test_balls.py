"""Balls contain every exact result: rational arithmetic, and 80 digits for the elementary."""

import operator
from fractions import Fraction

import arbs
import numpy as np
import pytest
from flint import arb

from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import (
    FORMULAS,
    WIDE,
    Ball,
    arctan2,
    crossed,
    eliminated,
    is_positive_definite,
    joined,
    near_rotations,
    polynomial,
    split,
    sums,
)


@pytest.fixture(autouse=True)
def _precise():
    with arbs.precision():
        yield


@pytest.fixture(params=[False, True], ids=["double", "wide"])
def wide(request):
    return request.param


def balls(seed, shape, wide, *, exact=False):
    """Balls of all sizes, some of them single numbers."""
    rng = np.random.default_rng(seed)
    mid = 10.0 ** rng.uniform(-6, 6, shape) * rng.standard_normal(shape)
    radius = np.abs(mid) * 10.0 ** rng.uniform(-18, 0, shape) * (rng.random(shape) < 0.7)
    ball = Ball(mid, 0.0 * radius if exact else radius)
    return ball.widened if wide else ball


operators = {"+": operator.add, "*": operator.mul, "/": operator.truediv, "@": operator.matmul}


def rational(x):
    return Fraction(*(int(part) for part in x.as_integer_ratio()))


def ends(ball, index):
    """The least, middle and largest number of a ball."""
    mid, radius = rational(ball.mid[index]), rational(ball.radius[index])
    return mid - radius, mid, mid + radius


def holds(ball, index, value):
    low, _, high = ends(ball, index)
    return low <= value <= high


@pytest.mark.parametrize("name", ["add", "sub", "mul", "truediv"])
def test_arithmetic(name, wide, compiled_form):
    operation = getattr(operator, name)
    x, y = balls(1, 200, wide), balls(2, 200, False)
    found = operation(x, y)
    assert found.mid.dtype == (WIDE if wide else np.float64)
    for k in range(200):
        for a in ends(x, k):
            for b in ends(y, k):
                if name != "truediv" or ends(y, k)[0] * ends(y, k)[2] > 0:
                    assert holds(found, k, operation(a, b))
    for other in (2.5, y.mid):
        values = np.broadcast_to(other, 200)
        for one, two in ((operation(x, other), False), (operation(other, x), True)):
            for k in range(200):
                pair = (rational(x.mid[k]), rational(np.float64(values[k])))
                assert holds(one, k, operation(*(pair[::-1] if two else pair)))


needs_the_kernel = pytest.mark.skipif(not compiled.AVAILABLE, reason="without a C compiler")


@needs_the_kernel
@pytest.mark.parametrize("operation", "+*/")
@pytest.mark.parametrize("one", [(5, 3, 3), (5, 3, 1), (4, 5, 1, 3), (3,), ()], ids=str)
@pytest.mark.parametrize("other", [(5, 3, 3), (5, 1, 3), (1, 1, 3), (1,)], ids=str)
def test_compiled_operations_are_those_in_numpy(operation, one, other, wide):
    x, y = balls(1, one, wide), balls(2, other, False)
    for a, b in ((x, y), (y, x), (y[..., ::-1], y), (y[:0], y[:0])):
        found, expected = operators[operation](a, b), FORMULAS[operation](a, b)
        assert found.mid.dtype == expected.mid.dtype
        np.testing.assert_array_equal(found.mid, expected.mid, strict=True)
        np.testing.assert_array_equal(found.radius, expected.radius, strict=True)


@needs_the_kernel
@pytest.mark.parametrize("one", [(5, 2, 3), (1, 2, 3), (3, 3), (4, 5, 3, 3), (0, 3, 3)], ids=str)
def test_compiled_products_of_matrices_are_those_in_numpy(one, wide):
    x, y = balls(1, one, wide), balls(2, (1 if 0 in one else 5, 4, 3), False).T
    found, expected = x @ y, FORMULAS["@"](x, y)
    assert found.mid.shape == expected.mid.shape
    assert found.mid.dtype == expected.mid.dtype
    # Sums in another order.
    assert np.all(np.abs(found.mid - expected.mid) <= found.radius)
    np.testing.assert_allclose(found.radius, expected.radius, rtol=1e-14, strict=True)


def test_what_is_not_a_number_bounds_nothing(compiled_form):
    odd = Ball(np.array([np.nan, 1.0, np.inf]), np.array([0.0, np.nan, 0.0]))
    with np.errstate(invalid="ignore"):
        all_found = odd + 1.0, odd * 2.0, odd / 3.0, odd[:, None, None] @ np.ones((3, 1, 1))
    for found in all_found:
        assert not np.isfinite(found.lower).any()


def test_a_quotient_by_what_may_be_zero_is_anything():
    found = Ball.exact(np.ones(1)) / Ball.within(np.array([1e-3]), 1e-3)
    assert found.lower[0] == -np.inf
    assert found.upper[0] == np.inf
    nothing = Ball.exact(np.zeros(1)) / 0.0
    assert nothing.lower[0] == -np.inf
    assert nothing.upper[0] == np.inf


def test_bounds_are_doubles_beyond_the_ends(wide):
    ball = balls(3, 300, wide)
    assert ball.lower.dtype == ball.upper.dtype == np.float64
    for k in range(300):
        low, mid, high = ends(ball, k)
        assert rational(ball.lower[k]) <= low
        assert high <= rational(ball.upper[k])
        assert max(abs(low), abs(high)) <= rational(ball.size[k])
        assert rational(ball.absolute.mid[k]) == abs(mid)
    single = balls(3, 300, wide, exact=True)
    assert (single.upper - single.lower <= 4.0 * np.spacing(np.abs(single.nearest))).all()


def test_products_of_matrices_and_sums(wide, compiled_form):
    A, B = balls(4, (20, 3, 5), wide), balls(5, (20, 5, 2), False)
    product, total, vectors = A @ B, sums(A), B[:, :, 0]
    applied, dotted = A.apply(vectors), A[:, 0].dot(vectors)
    rng = np.random.default_rng(0)
    for k in range(20):
        a = [[ends(A, (k, i, j))[rng.integers(3)] for j in range(5)] for i in range(3)]
        b = [[ends(B, (k, i, j))[rng.integers(3)] for j in range(2)] for i in range(5)]
        for i in range(3):
            assert holds(total, (k, i), sum(a[i]))
            for j in range(2):
                value = sum(a[i][c] * b[c][j] for c in range(5))
                assert holds(product, (k, i, j), value)
                assert j or holds(applied, (k, i), value)
                assert i or j or holds(dotted, k, value)
    np.testing.assert_array_equal(A.T.mid[:, 2, 1], A.mid[:, 1, 2])


def test_a_long_sum():
    ball = balls(6, (1, 5_000), False)
    for end in (0, 2):
        assert holds(sums(ball), 0, sum(ends(ball, (0, k))[end] for k in range(5_000)))


def test_elementary_functions(wide):
    x = balls(7, 200, wide)
    small = Ball(np.remainder(x.mid, 10.0), x.radius)
    sine, cosine, root = small.sin(), small.cos(), small.sqrt()
    for k in range(200):
        for value in ends(small, k):
            at = arb(value.numerator) / value.denominator
            assert within(sine, k, at.sin())
            assert within(cosine, k, at.cos())
            if value >= 0:
                assert within(root, k, at.sqrt())


def within(ball, index, value):
    return abs(value - arbs.exact(ball.mid[index])) <= arbs.exact(ball.radius[index])


def test_angles_of_points():
    x, y = balls(8, 200, False), balls(9, 200, False)
    found = arctan2(y, x)
    for k in range(200):
        for a in ends(x, k):
            for b in ends(y, k):
                if a or b:
                    at = (arb(c.numerator) / c.denominator for c in (b, a))
                    assert within(found, k, arb.atan2(*at))
    cut = arctan2(Ball.within(np.array([0.0]), 1e-9), Ball.exact(-np.ones(1)))
    assert cut.lower[0] < -np.pi
    assert cut.upper[0] > np.pi
    unknown = arctan2(Ball.exact(np.array([np.nan])), Ball.exact(np.ones(1)))
    assert unknown.lower[0] == -np.inf


COEFFICIENTS = [Fraction(1, 3), Fraction(-2, 7), Fraction(5), Fraction(1, 10**5)]


def test_polynomials(wide, compiled_form):
    coefficients = COEFFICIENTS
    x = balls(10, 100, wide)
    found = polynomial(split(coefficients), x)
    for k in range(100):
        for value in ends(x, k):
            assert holds(found, k, sum(c * value**n for n, c in enumerate(coefficients)))


@needs_the_kernel
@pytest.mark.parametrize("shape", [(7,), (5, 1, 1), (0,)], ids=str)
def test_compiled_polynomials_are_those_in_numpy(shape, wide, monkeypatch):
    x, coefficients = balls(12, shape, wide), split(COEFFICIENTS)
    found = polynomial(coefficients, x)
    arrays = x.mid, x.radius, x.mid.copy(), np.empty(1 + x.radius.size)
    with pytest.raises(ValueError, match="coefficients"):
        compiled.kernel.polynomial(coefficients, 0.0, *arrays)
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    expected = polynomial(coefficients, x)
    np.testing.assert_array_equal(found.mid, expected.mid, strict=True)
    np.testing.assert_array_equal(found.radius, expected.radius, strict=True)


@pytest.mark.parametrize("q", [1, 3])
def test_skew_matrices(q, wide):
    ball = balls(11, (7, q), wide)
    found = crossed(ball)
    np.testing.assert_array_equal(found.nearest, so.hat(ball.nearest))
    np.testing.assert_array_equal(found.radius, np.abs(so.hat(ball.radius)))
    assert joined(ball, ball).mid.shape == (7, 2 * q)


@pytest.mark.parametrize("d", [2, 3])
def test_the_nearest_rotations(d):
    rng = np.random.default_rng(d)
    off = 10.0 ** rng.uniform(-17, -3, (50, 1, 1)) * rng.standard_normal((50, d, d))
    stored = so.random(rng, 50, d) + off
    found = near_rotations(stored)
    for k in range(50):
        nearest = arbs.nearest_rotation(stored[k])
        for a in range(d):
            for b in range(d):
                assert within(found, (k, a, b), nearest[a, b])
    assert (found.radius[np.abs(off).max(axis=(1, 2)) < 1e-10] < 1e-15).all()
    assert near_rotations(2.0 * np.eye(d)[None]).radius[0, 0, 0] == np.inf


@pytest.mark.parametrize("d", [2, 3])
def test_positive_definite_matrices(d):
    rng = np.random.default_rng(d)
    A = rng.standard_normal((200, d, d))
    A = A + np.swapaxes(A, 1, 2) + rng.uniform(-2, 6, (200, 1, 1)) * np.eye(d)
    least = np.linalg.eigvalsh(A)[:, 0]
    np.testing.assert_array_equal(is_positive_definite(Ball.exact(A)), least > 0.0)
    # All matrices within a radius: shifting by that of the whole ball decides.
    proven = is_positive_definite(Ball.within(A, 0.1))
    assert proven.any()
    assert (least[proven] > 0.1).all()
    assert not is_positive_definite(Ball.exact(np.full((1, d, d), np.nan)))[0]


@needs_the_kernel
@pytest.mark.parametrize("count", [0, 2, 5])
def test_compiled_elimination_is_that_in_numpy(count, wide, monkeypatch):
    rng = np.random.default_rng(0)
    A = rng.standard_normal((100, 5, 5))
    A = A + np.swapaxes(A, 1, 2) + rng.uniform(0, 6, (100, 1, 1)) * np.eye(5)
    A[:2, 2, 2] = np.nan, np.inf
    ball = Ball.within(A, 10.0 ** rng.uniform(-20, -1, A.shape))
    ball = ball.widened if wide else ball
    found, proven = eliminated(ball, count)
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    expected, expected_proven = eliminated(ball, count)
    np.testing.assert_array_equal(found.mid, expected.mid, strict=True)
    np.testing.assert_array_equal(found.radius, expected.radius, strict=True)
    np.testing.assert_array_equal(proven, expected_proven, strict=True)
    assert count == 0 or 10 < np.count_nonzero(proven) < 90


def test_padding_keeps_the_balls():
    ball = balls(12, (2, 3), False)
    padded = ball.padded(((0, 0), (1, 0))).reshaped(8)
    np.testing.assert_array_equal(padded.mid[1:4], ball.mid[0])
    np.testing.assert_array_equal(padded.radius[5:], ball.radius[1])
