"""Arrays of balls: numbers with error bounds, for formulas whose rounding must be bounded.

A ball is a double and a radius; the result of each operation contains the exact result for all
numbers in its operands. It relies on IEEE 754 arithmetic, and on elementary functions accurate to
`ULPS` units in the last place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Union

import numpy as np

from certpgo.linalg.arrays import FloatArray

U = float(np.finfo(float).eps) / 2
#: Assumed accuracy of sine, cosine and arctangent.
ULPS = 4.0
#: A bound on underflow in any single operation.
TINY = 2.0**-1070
#: Rounding of the radius itself.
_UP = 1.0 + 16.0 * U

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
        return Ball(mid, np.zeros_like(mid))

    @staticmethod
    def within(values: FloatArray, radius: float | FloatArray) -> Ball:
        """All numbers within a radius of doubles."""
        mid = np.asarray(values, dtype=np.float64)
        return Ball(mid, np.broadcast_to(np.asarray(radius, dtype=np.float64), mid.shape))

    @property
    def lower(self) -> FloatArray:
        """Doubles not above any number of the ball."""
        return np.asarray(np.nextafter(self.mid - self.radius, -np.inf))

    @property
    def upper(self) -> FloatArray:
        """Doubles not below any number of the ball."""
        return np.asarray(np.nextafter(self.mid + self.radius, np.inf))

    @property
    def size(self) -> FloatArray:
        """Doubles not below the absolute value of any number of the ball."""
        return np.asarray(np.abs(self.mid) + self.radius) * _UP

    @property
    def T(self) -> Ball:  # noqa: N802
        """The transposes of matrices (..., p, q)."""
        return Ball(np.swapaxes(self.mid, -1, -2), np.swapaxes(self.radius, -1, -2))

    def __getitem__(self, index: Any) -> Ball:
        return Ball(self.mid[index], self.radius[index])

    def __neg__(self) -> Ball:
        return Ball(-self.mid, self.radius)

    def __add__(self, other: Number) -> Ball:
        b = _ball(other)
        mid = self.mid + b.mid
        return _rounded(mid, self.radius + b.radius)

    def __sub__(self, other: Number) -> Ball:
        return self + (-_ball(other))

    def __mul__(self, other: Number) -> Ball:
        b = _ball(other)
        mid = self.mid * b.mid
        return _rounded(mid, np.abs(self.mid) * b.radius + self.radius * b.size)

    def __truediv__(self, other: Number) -> Ball:
        b = _ball(other)
        least = np.abs(b.mid) - b.radius * _UP
        with np.errstate(all="ignore"):
            mid = self.mid / b.mid
            error = (self.radius + np.abs(mid) * b.radius) / (least * (1.0 - 4.0 * U))
        return _rounded(mid, np.where(least > 0.0, error, np.inf))

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: Number) -> Ball:
        return _ball(other) - self

    def __rtruediv__(self, other: Number) -> Ball:
        return _ball(other) / self

    def __matmul__(self, other: Number) -> Ball:
        """Products of matrices (..., p, q) and (..., q, r)."""
        b = _ball(other)
        mid = self.mid @ b.mid
        error = np.abs(self.mid) @ b.radius + self.radius @ b.size
        rounding = (self.mid.shape[-1] + 2.0) * U * (np.abs(self.mid) @ np.abs(b.mid))
        return _rounded(mid, error + rounding)

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
        """Zeros around, as by `numpy.pad`."""
        return Ball(np.pad(self.mid, widths), np.pad(self.radius, widths))

    def squared(self) -> Ball:
        """Squares."""
        return self * self

    def sqrt(self) -> Ball:
        """Square roots; of what is below zero, zero."""
        low, high = np.maximum(self.lower, 0.0), np.maximum(self.upper, 0.0)
        low, high = np.sqrt(low) * (1.0 - 2.0 * U), np.sqrt(high) * (1.0 + 2.0 * U)
        mid = 0.5 * (low + high)
        return _rounded(mid, 0.5 * (high - low))

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
    everything = (off >= 0.5 * r) | ((x.mid - x.radius <= 0.0) & (np.abs(y.mid) <= y.radius))
    return _elementary(mid, np.where(everything, 6.3, error))


def _ball(x: Number) -> Ball:
    return x if isinstance(x, Ball) else Ball.exact(x)


def _rounded(mid: FloatArray, radius: FloatArray) -> Ball:
    return Ball(mid, (radius + U * np.abs(mid) + TINY) * _UP)


def _elementary(mid: FloatArray, radius: FloatArray) -> Ball:
    return Ball(mid, (radius + 2.0 * ULPS * U * np.abs(mid) + TINY) * _UP)


def sums(ball: Ball, axis: int = -1) -> Ball:
    """Sums along an axis."""
    mid = ball.mid.sum(axis=axis)
    sizes = np.abs(ball.mid).sum(axis=axis)
    return _rounded(mid, ball.radius.sum(axis=axis) * (1.0 + 8.0 * U) + _count(ball, axis) * sizes)


def _count(ball: Ball, axis: int) -> float:
    return float((ball.mid.shape[axis] + 2.0) * U * (1.0 + 1e-12))
