"""Double-double arithmetic in batches (Dekker 1971): a number is the sum of two doubles.

Each operation is accurate to a few 2^-104 of its operands' magnitude, without over- or underflow;
products of two doubles are exact. It is faster than integers; `rounds_alike` decides which
roundings are certain.
"""

from __future__ import annotations

import numpy as np

from certpgo.linalg.arrays import BoolArray, FloatArray

DD = tuple[FloatArray, FloatArray]


def two_sum(a: FloatArray, b: FloatArray) -> DD:
    """The sum a + b, exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def _fast_two_sum(a: FloatArray, b: FloatArray) -> DD:
    s = a + b
    return s, b - (s - a)


def _split(a: FloatArray) -> DD:
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high


def two_product(a: FloatArray, b: FloatArray) -> DD:
    """The product a b, exactly (Veltkamp, Dekker)."""
    p = a * b
    (a1, a2), (b1, b2) = _split(a), _split(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def multiply(x: DD, y: DD) -> DD:
    """The product x y."""
    p, error = two_product(x[0], y[0])
    return _fast_two_sum(p, error + (x[0] * y[1] + x[1] * y[0]))


def add(x: DD, y: DD) -> DD:
    """The sum x + y."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = _fast_two_sum(s, e + t)
    return _fast_two_sum(s, e + f)


def negative(x: DD) -> DD:
    """The number -x."""
    return -x[0], -x[1]


def divide(x: DD, y: DD) -> DD:
    """The quotient x / y, by three steps of long division."""
    quotient: DD = (np.zeros_like(x[0]), np.zeros_like(x[0]))
    for _ in range(3):
        digit = (x[0] / y[0], np.zeros_like(x[0]))
        quotient = add(quotient, digit)
        x = add(x, negative(multiply(digit, y)))
    return quotient


def rounds_alike(x: DD, margin: FloatArray | float) -> BoolArray:
    """Whether all numbers within a relative ``margin`` of x round to one double (Ziv's test)."""
    high, low = x
    error = margin * np.abs(high)
    return np.asarray(high + (low - error) == high + (low + error))
