"""Functions of robust kernels: concave rho(q) of squared residuals q, in place of q itself.

With c the square of a kernel's scale and u = q / c, rho(q) = c r(u):

    huber           u up to 1, then 2 u^(1/2) - 1
    cauchy          log(1 + u)
    geman-mcclure   u / (1 + u)
    truncated       min(u, 1)

These are the losses of g2o, GTSAM and Ceres, times two where a program halves its costs. All begin
as u does, grow with u and with c, and are concave; so rho is the least of its tangents (half-
quadratic duality; Geman and Reynolds, PAMI 1992).

A minorant of rho on rotations that touches at an angle needs a curvature k, see
`certpgo.objective.robust_minorants`. With s0 = 4 (1 - cos theta0), e = 4 s0 - s0^2 / 2, a tangent
of slope w, M its excess over rho at s0, and w0 the slope there, k is the least over all tangents of

    (4 - s0) w + M / 2 - e (w - w0)^2 / M.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, U

#: Relative accuracy of the functions of u below: a few operations each, and a logarithm.
ACCURACY = 32.0 * U
#: The largest |R - R'|_F^2 of two rotations.
FARTHEST = 8.0
#: Bisections for a least value.
HALVINGS = 24

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Profile:
    """The function r of a kernel.

    Attributes
    ----------
    called : in sentences
    values, slopes, bends : r, r' and r'' at u
    falls : weights w with r(x^2) >= r + 2 r' x0 (x - x0) - w (x - x0)^2 for all x >= 0, where
        x0^2 = u; None for the truncated one, see `certpgo.objective.truncated`
    steepest : the largest slope of r(x^2), rounded up
    curvature : k, rounded down, at exact s0 and c (m,), c below `FARTHEST`
    """

    called: str
    values: Function
    slopes: Function
    bends: Function
    falls: Function | None
    steepest: float
    curvature: Callable[[Ball, Ball], FloatArray]

    def value_enclosures(self, u: Ball) -> Ball:
        """Values of r at all u in balls, which grows with u."""
        return _between(self.values(np.maximum(u.lower, 0.0)), self.values(u.upper))

    def slope_enclosures(self, u: Ball) -> Ball:
        """Slopes of r at all u in balls, which falls with u."""
        return _between(self.slopes(u.upper), self.slopes(np.maximum(u.lower, 0.0)))


def _of_huber(s: Ball, c: Ball) -> FloatArray:
    """Beyond the scale c / 2 - (c s)^(1/2); within it, the least value of a convex function of w.

    There, M = (1 - w) r with r = c / w - s, and (1 - w) / r = w (1 - w) / (c - w s) is linear but
    for a negative multiple of 1 / (c - w s).
    """
    found, within = (0.5 * c - (c * s).sqrt()).lower, s.mid <= c.mid
    if not within.any():
        return found
    s, c = s[within], c[within]
    e = _lever(s)

    def value(w: Ball) -> Ball:
        flat = (4.0 - s) * w + 0.5 * (1.0 - w) * (c / w - s)
        return flat - e * _at_most(w * (1.0 - w) / (c - w * s), w / c)

    def slope(w: Ball) -> Ball:
        left = c - w * s
        shares = (c - 2.0 * c * w + s * w * w) / (left * left)
        return 4.0 - 0.5 * s - 0.5 * c / (w * w) - e * shares

    least = np.minimum((c / FARTHEST).sqrt().lower, 1.0)
    found[within] = least_of_convex(value, slope, least, np.ones_like(least))
    return found


def _of_cauchy(s: Ball, c: Ball) -> FloatArray:
    """The least value of a convex function of z = w / w0, with M = c (z - 1 - log z).

    (z - 1)^2 / (z - 1 - log z) is twice a harmonic mean of the functions 1 - t + t z, so concave.
    """
    w0 = c / (c + s)
    flat, bent = (4.0 - s) * w0, _lever(s) * w0 * w0 / c

    def value(z: Ball) -> Ball:
        shares = z + z.sqrt(), z + 1.0  # as log z <= (z - 1) / z^(1/2), and 2 (z - 1) / (z + 1)
        near = Ball(*(np.where(z.mid >= 1.0, *of) for of in zip(*map(_parts, shares), strict=True)))
        share = _at_most((z - 1.0) * (z - 1.0) / _excess(z), near)
        return flat * z + 0.5 * c * _excess(z) - bent * share

    def slope(z: Ball) -> Ball:
        off, excess = z - 1.0, _excess(z)
        shares = off * (2.0 * excess - off * off / z) / (excess * excess)
        return flat + 0.5 * c * off / z - bent * shares

    ends = (c / (c + FARTHEST) / w0).lower, (1.0 / w0).upper
    return least_of_convex(value, slope, *ends)


def _fall_of_cauchy(u: FloatArray) -> FloatArray:
    """Half the most negative second derivative, or less near zero and below the scale.

    For y = (1 + x^2) / (1 + u), log y >= 2 (y - 1) / (y + 1) for y >= 1, which leads to the first
    bound, and log y >= (y - 1) / y^(1/2) >= (y - 1) (1 + 1 / y) / 2 for y <= 1, to the second.
    """
    with np.errstate(invalid="ignore"):
        above, below = u / ((1.0 + u) * (2.0 + u)), 0.5 * (u - 1.0) / (1.0 + u)
    return np.minimum(0.125, np.maximum(above, below))


def _of_geman_mcclure(s: Ball, c: Ball) -> FloatArray:
    """The least value of a quadratic function of p = w^(1/2): M = (c + s) (p - p0)^2."""
    whole = c + s
    p0, bent = c / whole, _lever(s) / whole
    square = 4.0 - s + 0.5 * whole - bent
    least, most = (c / (c + FARTHEST)).lower, np.ones_like(s.mid)

    def value(at: FloatArray) -> Ball:
        p = Ball.exact(at)
        apart, both = p - p0, p + p0
        return (4.0 - s) * p * p + 0.5 * whole * apart * apart - bent * both * both

    with np.errstate(all="ignore"):
        vertex = ((0.5 * whole + bent) * p0 / square).mid
    at = np.clip(np.where(np.isfinite(vertex), vertex, 1.0), least, most)
    slope = 2.0 * (square * at - (0.5 * whole + bent) * p0)
    moved = np.minimum(*((slope * (end - Ball.exact(at))).lower for end in (least, most)))
    # Above its tangent but for a negative square, and above its chord but for a positive one.
    convex = Ball.exact(value(at).lower) + moved - np.maximum(-square.lower, 0.0)
    chord = np.minimum(value(least).lower, value(most).lower)
    concave = Ball.exact(chord) - np.maximum(square.upper, 0.0)
    return np.maximum(convex.lower, concave.lower)


def _of_truncated(s: Ball, c: Ball) -> FloatArray:
    """Of its two tangents; none at the kink."""
    apart, near = c - s, s.mid < c.mid
    M = Ball(np.abs(apart.mid), apart.radius)
    with np.errstate(all="ignore"):
        other = 0.5 * M - _lever(s) / M
        taken_back = np.minimum((4.0 - s + other).lower, 0.0)
        # No two rotations are further apart.
        cut = np.where(c.mid < FARTHEST, other.lower, np.inf)
        found = np.where(near, np.minimum((4.0 - s).lower, cut), taken_back)
    return np.where(M.lower > 0.0, found, -np.inf)


def _reciprocal(u: FloatArray) -> FloatArray:
    """1 / (1 + u), whose powers do not overflow."""
    return 1.0 / (1.0 + u)


def _lever(s: Ball) -> Ball:
    """8 sin^2 of the angle."""
    return 4.0 * s - 0.5 * s * s


def least_of_convex(
    value: Callable[[Ball], Ball],
    slope: Callable[[Ball], Ball],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """Lower bounds on convex functions over intervals (m,), by bisection between proven slopes.

    Between two points, a function is above its tangent at the first one; before that and after the
    second one, it falls and rises.
    """
    a, b = low.copy(), np.maximum(high, low)
    with np.errstate(all="ignore"):
        for _ in range(HALVINGS):
            middle = 0.5 * (a + b)
            there = slope(Ball.exact(middle))
            a, b = np.where(there.upper <= 0.0, middle, a), np.where(there.lower >= 0.0, middle, b)
        falls = np.minimum(slope(Ball.exact(a)).lower, 0.0)
        first, second = value(Ball.exact(a)), value(Ball.exact(b))
        between = first + Ball.exact(falls) * (Ball.exact(b) - a)
        # Where the interval is so short that no slope is known, a chord from its ends would do.
        found = np.minimum(np.minimum(first.lower, second.lower), between.lower)
    return np.where(np.isnan(found), -np.inf, found)


def _between(low: FloatArray, high: FloatArray) -> Ball:
    """Balls from low to high, each accurate to `ACCURACY`, where low is not negative."""
    low, high = low * (1.0 - ACCURACY), high * (1.0 + ACCURACY)
    mid = 0.5 * (low + high)
    radius = np.maximum(high - mid, mid - low) * (1.0 + 4.0 * U) + 4.0 * U * np.abs(mid)
    return Ball.within(mid, radius)


def _excess(z: Ball) -> Ball:
    """Z - 1 - log z, not negative."""
    return z - 1.0 - z.log()


def _at_most(x: Ball, bound: Ball) -> Ball:
    """Balls of x, of which ``bound`` is an upper bound: that where it says more."""
    with np.errstate(invalid="ignore"):
        less = ~(x.upper <= bound.upper)
    return Ball(np.where(less, bound.mid, x.mid), np.where(less, bound.radius, x.radius))


def _parts(x: Ball) -> tuple[FloatArray, FloatArray]:
    return x.mid, x.radius


#: By their names in options.
PROFILES = {
    "huber": Profile(
        "Huber's kernel",
        lambda u: np.where(u <= 1.0, u, 2.0 * np.sqrt(np.maximum(u, 1.0)) - 1.0),
        lambda u: 1.0 / np.sqrt(np.maximum(u, 1.0)),
        lambda u: np.where(u <= 1.0, 0.0, -0.5 * np.maximum(u, 1.0) ** -1.5),
        lambda u: 0.0 * u,  # r(x^2) is convex
        2.0,
        _of_huber,
    ),
    "cauchy": Profile(
        "Cauchy's kernel",
        np.log1p,
        _reciprocal,
        lambda u: -(_reciprocal(u) ** 2),
        _fall_of_cauchy,
        1.0,
        _of_cauchy,
    ),
    "geman-mcclure": Profile(
        "Geman and McClure's kernel",
        lambda u: u * _reciprocal(u),
        lambda u: _reciprocal(u) ** 2,
        lambda u: -2.0 * _reciprocal(u) ** 3,
        lambda u: u * _reciprocal(u) ** 2,
        0.65,
        _of_geman_mcclure,
    ),
    "truncated": Profile(
        "the truncated kernel",
        lambda u: np.minimum(u, 1.0),
        lambda u: np.where(u < 1.0, 1.0, 0.0),
        lambda u: 0.0 * u,
        None,
        2.0,
        _of_truncated,
    ),
}
