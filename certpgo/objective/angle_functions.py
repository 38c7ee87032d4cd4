r"""Functions of a rotation by an angle that make up the logarithm, with error bounds.

With s = 4 sin^2(theta/2) for an angle theta of at most pi,

    g = theta^2,    h = s^2 / (g - s),    chi = (sin(theta) / theta)^2

are functions of s on [0, 4], and primes are derivatives in s. All are products and quotients of
entire functions of x = theta^2 that are not near zero, and of sin(theta), which is computed
accurately near pi too:

    A(x) = (theta^2 - s) / theta^4             = 2 (1/4! - x/6! + x^2/8! - ...)
    B(x) = s / theta^2                         = 2 (1/2! - x/4! + x^2/6! - ...)
    S(x) = sin(theta) / theta                  = 1 - x/3! + x^2/5! - ...
    D(x) = (cos(theta) - S) / theta^2          = -sum_k (-x)^k (2 k + 2) / (2 k + 3)!
    H(x) = (2 A S - B (1 - S) / x) / x         = 2 sum_(k >= 3) (-1)^k c_k x^(k - 3),
                                                 c_k = (4^k - 4 k^2) / (2 k + 1)!

and DD = D', so that h = B^2 / A, h' = B H / (S A^2), g' = 1 / S, chi = S^2 and chi' = D.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import factorial

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, crossed, polynomial, split

#: Terms of the series, and the largest x for which they stand.
TERMS, LARGEST = 22, 10.5
EXACT = {
    "A": [Fraction(2 * (-1) ** k, factorial(2 * k + 4)) for k in range(TERMS + 1)],
    "B": [Fraction(2 * (-1) ** k, factorial(2 * k + 2)) for k in range(TERMS + 1)],
    "S": [Fraction((-1) ** k, factorial(2 * k + 1)) for k in range(TERMS + 1)],
    "D": [Fraction((-1) ** (k + 1) * (2 * k + 2), factorial(2 * k + 3)) for k in range(TERMS + 1)],
    "DD": [
        Fraction((-1) ** k * (k + 1) * (2 * k + 4), factorial(2 * k + 5)) for k in range(TERMS + 1)
    ],
    "H": [
        Fraction(2 * (-1) ** k * (4**k - 4 * k**2), factorial(2 * k + 1))
        for k in range(3, TERMS + 4)
    ],
}
A, B, S, D, DD, H = map(split, EXACT.values())
#: Fewest terms, and a tail over the first term that no longer counts.
FEWEST, NEGLIGIBLE = 4, 2.0**-72
#: The least angle at which functions are expanded, and the least distance from pi.
SMALL, EDGE = 2.0**-60, 2.0**-24


@cache
def cotangent(terms: int = 30) -> FloatArray:
    """Coefficients of c = (1 - (theta/2) cot(theta/2)) / theta^2 = sum |B_2n| x^(n-1) / (2n)!."""
    sine = [Fraction((-1) ** k, factorial(2 * k + 1)) for k in range(terms + 1)]
    ratio: list[Fraction] = []  # of u cot u = cos u / (sin u / u), in u^2
    for n in range(terms + 1):
        known = sum(ratio[k] * sine[n - k] for k in range(n))
        ratio.append(Fraction((-1) ** n, factorial(2 * n)) - known)
    return np.array([float(-ratio[n] / 4**n) for n in range(1, terms + 1)])


def series(coefficients: FloatArray, x: Ball) -> Ball:
    """Alternating series at 0 <= x <= `LARGEST`, where its terms decrease from the third on.

    Then the tail is at most its first term, and as few terms are summed as make that negligible.
    Beyond, nothing is known.
    """
    # NaN does not count, and has a tail without bounds.
    largest = min(float(np.fmax.reduce(x.upper, axis=None, initial=0.0)), LARGEST)
    sizes = np.abs(coefficients[:, 0]).tolist()
    terms = FEWEST
    while terms < TERMS and sizes[terms] * largest**terms > NEGLIGIBLE * sizes[0]:
        terms += 1
    value = polynomial(coefficients[:terms], x)
    bound = 1.01 * sizes[terms] * largest**terms
    tail = np.where(x.upper <= LARGEST, bound, np.inf)
    return Ball(value.mid, (value.radius + tail) * (1.0 + 1e-15))


@dataclass(frozen=True, eq=False)
class AngleFunctions:
    """The functions at angles 0 < theta < pi, and their derivatives in s."""

    theta: FloatArray
    s: Ball
    sinc: Ball
    g: Ball
    dg: Ball
    h: Ball
    dh: Ball
    chi: Ball
    dchi: Ball

    @staticmethod
    def of(theta: FloatArray) -> AngleFunctions:
        """For angles (m,)."""
        t = Ball.exact(theta).widened
        x = t * t
        a, b, sinc = series(A, x), series(B, x), t.sin() / t
        return AngleFunctions(
            theta=theta,
            s=b * x,
            sinc=sinc,
            g=x,
            dg=1.0 / sinc,
            h=b * b / a,
            dh=b * series(H, x) / (sinc * a * a),
            chi=sinc * sinc,
            dchi=series(D, x),
        )


def exponential(omega: Ball) -> Ball:
    """Rotations (m, d, d) by vectors (m, 1) or (m, 3) whose square is at most `LARGEST`."""
    x, hat = omega.dot(omega)[:, None, None], crossed(omega)
    return series(S, x) * hat + 0.5 * series(B, x) * (hat @ hat) + np.eye(hat.mid.shape[-1])


def half_cotangent(x: Ball) -> tuple[Ball, Ball]:
    """The c = (1 - (theta/2) cot(theta/2)) / theta^2 at x = theta^2, and its derivative in x.

    c = -D / (4 S) at x/4, and S' = D/2.
    """
    quarter = 0.25 * x
    d, s = series(D, quarter), series(S, quarter)
    slope = (series(DD, quarter) * s - 0.5 * (d * d)) / (s * s)
    return -0.25 * (d / s), -0.0625 * slope


@cache
def _cotangent_slopes() -> FloatArray:
    return np.asarray(polyder(cotangent()))


def half_cotangents(x: FloatArray) -> FloatArray:
    """The same c at doubles up to pi^2."""
    return np.asarray(polyval(x, cotangent()))


def half_cotangent_slopes(x: FloatArray) -> FloatArray:
    """Its derivative in x."""
    return np.asarray(polyval(x, _cotangent_slopes()))


def clipped(omega: FloatArray) -> FloatArray:
    """Rotation vectors (m, q) with angles that `AngleFunctions` takes, next to those given.

    Near pi slopes in s grow without bound, and rounding with them: expanding `EDGE` away from pi
    loses some pi `EDGE` of the curvature, no more than rounding does there.
    """
    theta = np.linalg.norm(omega, axis=1)[:, None]
    first = np.eye(omega.shape[1])[0]
    turned = np.where(theta > SMALL, omega, SMALL * first)
    return np.asarray(turned * np.minimum(1.0, (np.pi - EDGE) / np.maximum(theta, SMALL)))
