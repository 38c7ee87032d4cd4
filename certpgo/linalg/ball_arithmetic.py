"""Arrays of balls: numbers with error bounds, for formulas whose rounding must be bounded.

A ball is a floating-point number and a radius; the result of each operation contains the exact
result for all numbers in its operands. It relies on IEEE 754 arithmetic, and on elementary
functions accurate to `ULPS` units in the last place. Numbers are doubles, or of the machine's wider
format after `Ball.widened`; what is not a number bounds nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Union, cast

import numpy as np

from certpgo.linalg import compiled
from certpgo.linalg.arrays import BoolArray, FloatArray

U = float(np.finfo(float).eps) / 2
#: Assumed accuracy of sine, cosine, arctangent and logarithm.
ULPS = 4.0
#: A bound on underflow in any single operation.
TINY = 2.0**-1070
#: Rounding of the radius itself.
_UP = 1.0 + 16.0 * U

#: Rows of the matrices that the compiled kernel eliminates, at most.
LARGEST_ELIMINATED = 8

# Extended precision where the machine has it as an IEEE format: x86 has 64 bits. PowerPC's pair of
# doubles does not round as IEEE formats do.
_LONG = np.finfo(np.longdouble)
WIDE: Any = np.longdouble if _LONG.nmant in (63, 112) else np.float64
_UNITS = {np.dtype(np.float64): U, np.dtype(WIDE): float(np.finfo(WIDE).eps) / 2}

Number = Union["Ball", FloatArray, float]


@dataclass(frozen=True, eq=False)
class Ball:
    """Numbers within ``radius`` of ``mid``, elementwise.

    Examples
    --------
    >>> import numpy as np
    >>> third = Ball.exact(np.ones(1)) / 3.0
    >>> bool(third.radius[0] > 0.0), bool(third.lower[0] <= 1 / 3 <= third.upper[0])
    (True, True)
    """

    mid: FloatArray
    radius: FloatArray

    # NumPy arrays leave operations with balls to the ball.
    __array_ufunc__ = None

    @staticmethod
    def exact(values: FloatArray | float) -> Ball:
        """Doubles as they are."""
        mid = np.asarray(values, dtype=np.float64)
        return Ball(mid, np.zeros(mid.shape))

    @staticmethod
    def within(values: FloatArray | float, radius: float | FloatArray) -> Ball:
        """All numbers within a radius of doubles."""
        mid = np.asarray(values, dtype=np.float64)
        return Ball(mid, np.broadcast_to(np.asarray(radius, dtype=np.float64), mid.shape))

    @property
    def widened(self) -> Ball:
        """The same numbers; operations with them round in the machine's wider format."""
        # Annotated as doubles, like all arrays here.
        return Ball(cast(FloatArray, self.mid.astype(WIDE)), self.radius)

    @property
    def lower(self) -> FloatArray:
        """Doubles not above any number of the ball."""
        with np.errstate(invalid="ignore", over="ignore"):
            low = np.nextafter(self.mid - self.radius, -np.inf)
            double = low.astype(np.float64)
        double = np.where(double > low, np.nextafter(double, -np.inf), double)
        return np.asarray(np.where(np.isnan(double), -np.inf, double))

    @property
    def upper(self) -> FloatArray:
        """Doubles not below any number of the ball."""
        return np.asarray(-(-self).lower)

    @property
    def size(self) -> FloatArray:
        """Doubles not below the absolute value of any number of the ball."""
        return np.asarray(_doubles(np.abs(self.mid)) + self.radius) * _UP

    @property
    def nearest(self) -> FloatArray:
        """The doubles nearest to the middles."""
        return np.asarray(self.mid.astype(np.float64))

    @property
    def T(self) -> Ball:  # noqa: N802
        """The transposes of matrices (..., p, q)."""
        return Ball(np.swapaxes(self.mid, -1, -2), np.swapaxes(self.radius, -1, -2))

    def __getitem__(self, index: Any) -> Ball:
        return Ball(self.mid[index], self.radius[index])

    def __neg__(self) -> Ball:
        return Ball(-self.mid, self.radius)

    def __add__(self, other: Number) -> Ball:
        return _combined("+", self, _ball(other))

    def __sub__(self, other: Number) -> Ball:
        return self + (-_ball(other))

    def __mul__(self, other: Number) -> Ball:
        return _combined("*", self, _ball(other))

    def __truediv__(self, other: Number) -> Ball:
        return _combined("/", self, _ball(other))

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: Number) -> Ball:
        return _ball(other) - self

    def __rtruediv__(self, other: Number) -> Ball:
        return _ball(other) / self

    def __matmul__(self, other: Number) -> Ball:
        """Products of matrices (..., p, q) and (..., q, r)."""
        return _combined("@", self, _ball(other))

    def dot(self, other: Number) -> Ball:
        """Inner products of vectors (..., p)."""
        b = _ball(other)
        return (self[..., None, :] @ b[..., :, None])[..., 0, 0]

    def apply(self, vectors: Number) -> Ball:
        """Products of matrices (..., p, q) and vectors (..., q)."""
        return (self @ _ball(vectors)[..., None])[..., 0]

    def reshaped(self, *shape: int) -> Ball:
        """The same balls in another shape."""
        return Ball(self.mid.reshape(shape), self.radius.reshape(shape))

    def padded(self, widths: tuple[tuple[int, int], ...]) -> Ball:
        """Zeros around, as by `numpy.pad`, which takes ten times as long for small arrays."""
        shape = self.mid.shape
        whole = tuple(low + n + high for n, (low, high) in zip(shape, widths, strict=True))
        inside = tuple(slice(low, low + n) for n, (low, _) in zip(shape, widths, strict=True))
        mid, radius = np.zeros(whole, self.mid.dtype), np.zeros(whole)
        mid[inside], radius[inside] = self.mid, self.radius
        return Ball(mid, radius)

    @property
    def absolute(self) -> Ball:
        """Numbers from the absolute values of the middles up to the `size`."""
        return Ball(np.abs(self.mid), self.radius)

    def squared(self) -> Ball:
        """Squares."""
        return self * self

    def sqrt(self) -> Ball:
        """Square roots; of what is below zero, zero."""
        u = _unit(self.mid)
        with np.errstate(invalid="ignore"):
            low = np.nextafter(self.mid - self.radius, -np.inf)
            high = np.nextafter(self.mid + self.radius, np.inf)
        low = np.sqrt(np.maximum(low, 0.0)) * (1.0 - 2.0 * u)
        high = np.sqrt(np.maximum(high, 0.0)) * (1.0 + 2.0 * u)
        return _rounded(0.5 * (low + high), 0.5 * (high - low) + u * high)

    def log(self) -> Ball:
        """Logarithms; of balls that reach zero, everything."""
        with np.errstate(all="ignore"):
            least = _doubles(self.mid) * (1.0 - 4.0 * U) - self.radius * _UP
            error = np.where(least > 0.0, self.radius / least * _UP, np.inf)
            return _elementary(np.log(self.mid), error)

    def sin(self) -> Ball:
        """Sines."""
        return _elementary(np.sin(self.mid), self.radius)

    def cos(self) -> Ball:
        """Cosines."""
        return _elementary(np.cos(self.mid), self.radius)


def arctan2(y: Ball, x: Ball) -> Ball:
    """Angles of (x, y), in (-pi, pi]; balls that contain the origin or the cut contain all."""
    mid = np.arctan2(y.mid, x.mid)
    r = np.hypot(x.mid, y.mid) * (1.0 - 4.0 * U)
    off = (x.radius + y.radius) * _UP
    with np.errstate(all="ignore"):
        # Within a distance off < r of a point, angles differ by at most arcsin(off / r).
        error = 1.6 * off / r
    everything = ~(off < 0.5 * r) | ((x.mid - x.radius <= 0.0) & (np.abs(y.mid) <= y.radius))
    return _elementary(mid, np.where(everything, 6.3, error))


def sums(ball: Ball, axis: int = -1) -> Ball:
    """Sums along an axis."""
    count = ball.mid.shape[axis] + 2.0
    sizes, radii = np.abs(ball.mid).sum(axis=axis), ball.radius.sum(axis=axis)
    mid = ball.mid.sum(axis=axis)
    # No more than one rounding per term, in whatever order.
    errors = radii + count * _unit(mid) * sizes
    return _rounded(mid, errors * (1.0 + 2.0 * count * U) + count * TINY)


def split(coefficients: Sequence[Fraction]) -> FloatArray:
    """(k, 2) doubles and what they leave of coefficients, which counts in the wider format."""
    return np.array([(float(c), float(c - Fraction(float(c)))) for c in coefficients])


def polynomial(coefficients: FloatArray, x: Ball) -> Ball:
    """Values of sum_k c_k x^k, by Horner's rule, for coefficients of `split`."""
    if not compiled.AVAILABLE:
        return _polynomial_in_numpy(coefficients, x)
    at, radii = np.ascontiguousarray(x.mid), np.ascontiguousarray(x.radius)
    mid, radius = np.empty(at.shape, at.dtype), np.empty(at.shape)
    arrays = at, radii, mid, radius
    compiled.kernel.polynomial(np.ascontiguousarray(coefficients), _unit(at), *arrays)
    return Ball(mid, radius)


def _polynomial_in_numpy(coefficients: FloatArray, x: Ball) -> Ball:
    total = Ball.exact(0.0)
    for high, low in coefficients[::-1].tolist():
        total = total * x + Ball.within(low, U * abs(low)) + high
    return total


def joined(*balls: Ball, axis: int = -1) -> Ball:
    """Balls one after another along an axis."""
    mid = np.concatenate([ball.mid for ball in balls], axis=axis)
    return Ball(mid, np.concatenate([ball.radius for ball in balls], axis=axis))


def crossed(ball: Ball) -> Ball:
    """Skew matrices (..., d, d) of vectors (..., 1) or (..., 3), as `rotations.hat`."""
    generators = _GENERATORS[ball.mid.shape[-1]]
    # Each entry is one component or zero: nothing is rounded.
    mid = np.tensordot(ball.mid, generators, 1)
    return Ball(mid, np.tensordot(ball.radius, np.abs(generators), 1))


def near_rotations(R: FloatArray) -> Ball:
    """Wide balls that contain the rotations nearest to matrices (m, d, d) of positive determinant.

    The nearest rotation is the polar factor R (I + D)^(-1/2) with D = R^T R - I, and
    ||(I + D)^(-1/2) - I + D/2||_F <= ||D||_F^2 / 2 where ||D||_F <= 1/10.
    """
    stored = Ball.exact(R).widened
    D = stored.T @ stored - np.eye(R.shape[-1])
    defect = np.sqrt(np.sum(D.size**2, axis=(-2, -1)))[:, None, None] * (1.0 + 32.0 * U)
    near = stored - stored @ D * 0.5
    remainder = np.where(defect <= 0.1, 0.55 * defect**2, np.inf)
    return Ball(near.mid, (near.radius + remainder) * _UP)


def eliminated(A: Ball, count: int) -> tuple[Ball, BoolArray]:
    """Schur complements of the leading blocks of symmetric matrices in balls (m, p, p).

    Returns the complements (m, p - count, p - count), and (m,) whether all leading blocks
    (count, count) are proven positive definite. They are if the pivots of elimination are positive.
    """
    m, p, _ = A.mid.shape
    if not compiled.AVAILABLE or p > LARGEST_ELIMINATED:
        return _eliminated_in_numpy(A, count)
    shape = (m, p - count, p - count)
    mid, radius, proven = np.empty(shape, A.mid.dtype), np.empty(shape), np.empty(m, np.int64)
    arrays = np.ascontiguousarray(A.mid), np.ascontiguousarray(A.radius)
    compiled.kernel.eliminate(*arrays, p, count, _unit(mid), mid, radius, proven)
    return Ball(mid, radius), proven != 0


def _eliminated_in_numpy(A: Ball, count: int) -> tuple[Ball, BoolArray]:
    proven = np.ones(len(A.mid), dtype=np.bool_)
    with np.errstate(all="ignore"):
        for _ in range(count):
            pivot, column = A[:, 0, 0], A[:, 1:, 0]
            proven &= pivot.lower > 0.0
            outer = column[:, :, None] * column[:, None, :]
            A = A[:, 1:, 1:] - outer / pivot[:, None, None]
    return A, np.asarray(proven)


def is_positive_definite(A: Ball) -> BoolArray:
    """(m,) whether all symmetric matrices in balls (m, d, d) are positive definite, as proven."""
    return eliminated(A, A.mid.shape[-1])[1]


def _generators(q: int) -> FloatArray:
    """(q, d, d) with sum_k v_k G_k the skew matrix of v."""
    if q == 1:
        return np.array([[[0.0, -1.0], [1.0, 0.0]]])
    G = np.zeros((3, 3, 3))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        G[k, j, i], G[k, i, j] = 1.0, -1.0
    return G


_GENERATORS = {1: _generators(1), 3: _generators(3)}


def _ball(x: Number) -> Ball:
    return x if isinstance(x, Ball) else Ball.exact(x)


def _unit(mid: FloatArray) -> float:
    return _UNITS[np.asarray(mid).dtype]


def _doubles(sizes: FloatArray) -> FloatArray:
    """Sizes as radii are stored: rounded, for which `_UP` makes up."""
    with np.errstate(over="ignore"):
        return np.asarray(sizes).astype(np.float64, copy=False)


def _rounded(mid: FloatArray, radius: FloatArray) -> Ball:
    size = _doubles(np.abs(mid))
    return Ball(mid, (_doubles(radius) + _unit(mid) * size + TINY) * _UP)


def _elementary(mid: FloatArray, radius: FloatArray) -> Ball:
    size = _doubles(np.abs(mid))
    return Ball(mid, (_doubles(radius) + 2.0 * ULPS * _unit(mid) * size + TINY) * _UP)


def _sum(a: Ball, b: Ball) -> Ball:
    return _rounded(a.mid + b.mid, a.radius + b.radius)


def _product(a: Ball, b: Ball) -> Ball:
    return _rounded(a.mid * b.mid, _doubles(np.abs(a.mid)) * b.radius + a.radius * b.size)


def _quotient(a: Ball, b: Ball) -> Ball:
    least = _doubles(np.abs(b.mid)) * (1.0 - 4.0 * U) - b.radius * _UP
    with np.errstate(all="ignore"):
        mid = a.mid / b.mid
        error = (a.radius + _doubles(np.abs(mid)) * b.radius) / (least * (1.0 - 4.0 * U))
    return _rounded(mid, np.where(least > 0.0, error, np.inf))


def _matrix_product(a: Ball, b: Ball) -> Ball:
    q, mid = a.mid.shape[-1], a.mid @ b.mid
    left, right = _doubles(np.abs(a.mid)), _doubles(np.abs(b.mid))
    error = left @ b.radius + a.radius @ b.size + (q + 2.0) * _unit(mid) * (left @ right)
    return _rounded(mid, error * (1.0 + 2.0 * q * U) + q * TINY)


#: Operations in NumPy, which the compiled kernel has in one pass each.
FORMULAS = {"+": _sum, "*": _product, "/": _quotient, "@": _matrix_product}


def _combined(operation: str, a: Ball, b: Ball) -> Ball:
    if not compiled.AVAILABLE:
        return FORMULAS[operation](a, b)
    # `np.broadcast_shapes` takes ten times as long.
    if operation == "@":
        (*left, p, _), (*right, _, r) = a.mid.shape, b.mid.shape
        shape = (*(left if left == right else np.broadcast_shapes(left, right)), p, r)
    else:
        shape = np.broadcast(a.mid, b.mid).shape
    mid, radius = np.empty(shape, np.result_type(a.mid, b.mid)), np.empty(shape)
    operands = a.mid, a.radius, b.mid, b.radius
    compiled.kernel.combine(operation, _unit(mid), *operands, mid, radius)
    return Ball(mid, radius)
