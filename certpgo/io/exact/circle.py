"""Cosine and sine of half an angle, correctly rounded, the same on every machine.

An angle enters a proof as the pair (c, s) = (cos(theta/2), sin(theta/2)), each the double nearest
to the true value. The definition is a fixed-point series in Python's integers
(`half_angle_pair`); `half_angles` computes the same pairs in batches by double-double arithmetic,
and uses the definition when its error bound leaves the rounding undecided.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import frexp

import numpy as np

from certpgo.errors import InputError
from certpgo.io.exact.doubledouble import DD, add, multiply, rounds_alike, two_sum
from certpgo.linalg.arrays import FloatArray

#: Larger angles are refused: they are mistakes, and would need more bits to reduce modulo pi.
MAX_ANGLE = 1e6

#: Relative error bound of the double-double pairs; their true error is below 2^-95.
_MARGIN = 2.0**-80


@lru_cache(maxsize=16)
def _pi(bits: int) -> int:
    """The integer pi 2^bits, off by less than 2^-20 units (Machin's formula)."""
    guard = bits + 40

    def arccot(k: int) -> int:
        term, total, n = (1 << guard) // k, 0, 0
        while term:
            total += (-term if n % 2 else term) // (2 * n + 1)
            term //= k * k
            n += 1
        return total

    return 4 * (4 * arccot(5) - arccot(239)) >> 40


def half_angle_pair(theta: float) -> tuple[float, float]:
    """The doubles nearest to cos(theta/2) and sin(theta/2).

    Raises
    ------
    InputError
        The angle is not finite or larger than `MAX_ANGLE`.
    """
    _check_range(np.array([theta]))
    if theta == 0.0:
        return 1.0, theta
    bits = 256 + max(0, -frexp(theta)[1])
    while True:
        cosine, sine = _series(theta, bits)
        # 2^20 units bound all truncation errors; only theta = 0 is a rounding tie.
        pairs = {
            ((cosine + e) / (1 << bits), (sine + f) / (1 << bits))
            for e in (-(1 << 20), 1 << 20)
            for f in (-(1 << 20), 1 << 20)
        }
        if len(pairs) == 1:
            return pairs.pop()
        bits *= 2


def _series(theta: float, bits: int) -> tuple[int, int]:
    """cos(theta/2) 2^bits and sin(theta/2) 2^bits, off by less than 2^20 units."""
    numerator, denominator = theta.as_integer_ratio()
    x = (numerator << bits) // (2 * denominator)
    pi = _pi(bits + 32)
    quarter, x = divmod((x << 32) + pi // 4, pi // 2)
    x = (x - pi // 4) >> 32
    cosine, sine, term, n = 0, 0, 1 << bits, 0
    while term not in (0, -1):
        signed = -term if n & 2 else term
        if n & 1:
            sine += signed
        else:
            cosine += signed
        n += 1
        term = (term * x >> bits) // n
    turns = ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))
    return turns[quarter % 4]


def _check_range(theta: FloatArray) -> None:
    if not (np.abs(theta) <= MAX_ANGLE).all():
        raise InputError(f"an angle must lie within {MAX_ANGLE:g} radians")


def half_angles(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Arrays (...,) of cos(theta/2) and sin(theta/2), equal to `half_angle_pair` bit for bit."""
    theta = np.asarray(theta, dtype=np.float64)
    _check_range(theta)
    cosine, sine = _double_double_pairs(0.5 * theta)
    # Below 2^-400 the products may underflow.
    certain = np.abs(theta) > 2.0**-400
    certain &= rounds_alike(cosine, _MARGIN) & rounds_alike(sine, _MARGIN)
    c, s = np.asarray(cosine[0] + cosine[1]), np.asarray(sine[0] + sine[1])
    for k in zip(*np.nonzero(~certain), strict=True):
        c[k], s[k] = half_angle_pair(float(theta[k]))
    return c, s


def _nearest_pair(value: Fraction) -> tuple[float, float]:
    high = float(value)
    return high, float(value - Fraction(high))


def _half_pi_parts() -> tuple[float, ...]:
    """pi/2 in parts of 32 bits, so that products with quadrants below 2^20 are exact."""
    rest, parts = Fraction(_pi(256), 1 << 257), []
    for k in range(1, 6):
        scale = 1 << (32 * k - 1)
        piece = Fraction(int(rest * scale), scale)
        parts.append(float(piece))
        rest -= piece
    return tuple(parts)


_HALF_PI = _half_pi_parts()
_FACTORIALS = np.cumprod(np.array([1, *range(1, 31)], dtype=object))
# Coefficients of cos(r) and sin(r)/r in powers of -r^2, as double-doubles (term, high/low, 2).
_COEFFICIENTS = np.array(
    [
        [_nearest_pair(Fraction(1, int(_FACTORIALS[2 * k + odd]))) for odd in (0, 1)]
        for k in range(15)
    ]
).swapaxes(1, 2)


def _double_double_pairs(x: FloatArray) -> tuple[DD, DD]:
    """cos(x) and sin(x) as double-doubles."""
    quadrant = np.rint(x * (2.0 / np.pi))
    # The first subtraction is exact (both are multiples of the finer unit, the result is below 1).
    r: DD = two_sum(x - quadrant * _HALF_PI[0], -quadrant * _HALF_PI[1])
    for part in _HALF_PI[2:]:
        r = add(r, (-quadrant * part, np.zeros_like(x)))
    square = multiply(r, r)
    z = (-square[0], -square[1])
    cosine, sine = (_horner(_COEFFICIENTS[:, :, odd], z) for odd in (0, 1))
    sine = multiply(sine, r)
    swap, turn = (quadrant % 2.0 == 1.0), quadrant % 4.0
    cosine_sign = np.where((turn == 1.0) | (turn == 2.0), -1.0, 1.0)
    sine_sign = np.where(turn >= 2.0, -1.0, 1.0)
    return (
        _signed(cosine_sign, np.where(swap, sine, cosine)),
        _signed(sine_sign, np.where(swap, cosine, sine)),
    )


def _signed(sign: FloatArray, x: FloatArray) -> DD:
    return sign * x[0], sign * x[1]


def _horner(coefficients: FloatArray, z: DD) -> DD:
    total: DD = (np.full_like(z[0], coefficients[-1, 0]), np.full_like(z[0], coefficients[-1, 1]))
    for high, low in coefficients[-2::-1]:
        total = add(multiply(total, z), (np.asarray(high), np.asarray(low)))
    return total
