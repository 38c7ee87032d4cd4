"""The functions of the angle against closed forms, and the inequalities the minorants rest on."""

from fractions import Fraction

import arbs
import numpy as np
import pytest
from flint import arb, fmpq

from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective import angle_functions as functions
from certpgo.objective.angle_functions import AngleFunctions
from certpgo.objective.gtsam_terms import CURVED, SWEPT, TURNED

ANGLES = np.r_[
    functions.SMALL, 10.0 ** np.arange(-9, 0), np.linspace(0.2, 3.1, 40), np.pi - functions.EDGE
]


@pytest.fixture(autouse=True)
def _precise():
    with arbs.precision():
        yield


def closed_forms(t):
    s, g, sine = 4 * (t / 2).sin() ** 2, t * t, t.sin()
    dg = t / sine
    return {
        "s": s,
        "g": g,
        "dg": dg,
        "h": s**2 / (g - s),
        "dh": (2 * s * (g - s) - s**2 * (dg - 1)) / (g - s) ** 2,
        "chi": (sine / t) ** 2,
        "dchi": (t.cos() - sine / t) / g,
    }


def inside(ball, k, value):
    return abs(value - arbs.exact(ball.mid[k])) <= arbs.exact(ball.radius[k])


def test_the_balls_contain_the_functions_and_are_small():
    found = AngleFunctions.of(ANGLES)
    for k, theta in enumerate(ANGLES):
        with arbs.precision(900):
            expected = closed_forms(arbs.exact(theta))
            for name, value in expected.items():
                ball = getattr(found, name)
                assert inside(ball, k, value), (name, theta)
                assert ball.radius[k] <= 1e-16 * abs(ball.mid[k])


def test_the_coefficient_of_the_inverse_jacobian():
    for x in (0.0, 1e-8, 0.3, 4.0, 9.86):
        with arbs.precision(600):
            at = arbs.exact(x) if x else arb(fmpq(1, 10**60))
            half, step = at.sqrt() / 2, arb(fmpq(1, 10**30))
            c = [(1 - h * h.cot()) / (4 * h * h) for h in (half, (at + step).sqrt() / 2)]
            slope = (c[1] - c[0]) / step
        ball, slopes = functions.half_cotangent(Ball.exact(np.array([x])).widened)
        assert abs(c[0] - arbs.exact(ball.mid[0])) <= arbs.exact(ball.radius[0]) + arb(1e-40)
        assert abs(slope - arbs.exact(slopes.mid[0])) <= arbs.exact(slopes.radius[0]) + arb(1e-25)
        double = functions.half_cotangents(np.array([x]))
        derivative = functions.half_cotangent_slopes(np.array([x]))
        assert double[0] == pytest.approx(float(c[0]), rel=1e-15)
        assert derivative[0] == pytest.approx(float(slope), rel=1e-14)


# What follows proves inequalities on intervals. Power series at 0 <= x <= pi^2 whose terms fall by
# a quarter or more from TERMS on, so that the rest is at most twice the first term left out.


def entire(coefficients, x):
    c = [arb(fmpq(f.numerator, f.denominator)) for f in coefficients]
    value = arb(0)
    for a in reversed(c[:-1]):
        value = value * x + a
    return value + arb(0, float(2 * abs(c[-1]) * arb(10.5) ** (len(c) - 1)))


def derived(coefficients):
    return [k * c for k, c in enumerate(coefficients)][1:]


def odd(k):
    """The coefficient of theta^(2 k + 1) in the sine."""
    return Fraction((-1) ** k, functions.factorial(2 * k + 1))


def even(k):
    """The coefficient of theta^(2 k) in the cosine."""
    return Fraction((-1) ** k, functions.factorial(2 * k))


def intervals(end, pieces):
    width = end / (2 * pieces)
    return [arb(((2 * k + 1) * width).mid(), (width * arb(1.01)).upper()) for k in range(pieces)]


def test_h_is_concave():
    # -h' = B (-H) / (S A^2) increases in x = theta^2: its logarithm's derivative, times S.
    A, B, S, H = (functions.EXACT[name] for name in "ABSH")
    for x in intervals(arb.pi() ** 2, 200):
        parts = [entire(derived(c), x) / entire(c, x) for c in (B, H, A)]
        rate = entire(S, x) * (parts[0] + parts[1] - 2 * parts[2]) - entire(derived(S), x)
        assert entire(H, x) < 0
        assert rate > 0


def test_a_fifth_of_the_curvature_of_g_bounds_that_of_chi():
    # chi'' / g'' = D_theta sin^2 / (sin - theta cos), D_theta = 3 sin / theta^4 - 3 cos / theta^3 -
    # sin / theta^2; both sides are theta^3 / 15 + ..., and what is left is divided by theta^5.
    def tripled(k):
        # sin^3 = (3 sin - sin(3 theta)) / 4 and cos sin^2 = (cos - cos(3 theta)) / 4
        return odd(k) * (3 - 3 ** (2 * k + 1)) / 4, even(k) * (1 - 9**k) / 4

    def left(k):
        # The coefficient of theta^(2 k + 1) in D_theta sin^2.
        return 3 * tripled(k + 2)[0] - 3 * tripled(k + 2)[1] - tripled(k + 1)[0]

    def right(k):
        return odd(k) - even(k)

    assert left(-1) == left(0) == right(0) == 0
    assert left(1) == right(1) / 5 == Fraction(1, 15)
    rest = [right(k) / 5 - left(k) for k in range(2, 62)]
    for x in intervals(arb.pi() ** 2, 200):
        assert entire(rest, x) > 0


def test_curvature_of_what_translations_and_rotations_share():
    # c = 2 sum_k 1 / ((2 pi k)^2 - x), and sum_(k > n) 1 / (4 k^2 - 1) = 1 / (4 n + 2).
    inverses = [1 / (4 * arb(k) ** 2 - 1) for k in range(1, 400)]
    c = 2 * (sum(inverses, arb(0)) + arb(fmpq(1, 4 * 399 + 2)))
    assert abs(c - 1) < 1e-70  # times pi^2, as for the next two
    slope = 2 * sum((a**2 for a in inverses), arb(0)) + arb(0, 1e-8)
    second = 4 * sum((a**3 for a in inverses), arb(0)) + arb(0, 1e-8)
    whole = (4 * second + 10 * slope + 2 * c) / arb.pi() ** 2 - arb(fmpq(1, 6))
    assert whole < CURVED


def test_how_far_the_rest_of_the_inverse_jacobian_sweeps():
    # rho(x) = x / sin(x) - cos(x), (rho'^2 + rho^2)^(1/2) <= (4/3) x (1 + b x^2), x <= pi / 2. With
    # P = (x - sin cos) / x^3, Q = (sin - x cos) / x^3, S = sin / x: rho = x^2 P / S, rho' = x a,
    # a = Q / S^2 + S and a - 4/3 = x^2 R / S^2, R = (Q + S^3 - 4/3 S^2) / x^2.
    terms = range(50)
    P = [-odd(k + 1) * 4 ** (k + 1) for k in terms]
    Q = [odd(k + 1) - even(k + 1) for k in terms]
    S = [odd(k) for k in terms]
    cube = [odd(k + 1) * (3 - 3 ** (2 * k + 3)) / 4 for k in range(51)]
    square = [-even(k + 1) * 4 ** (k + 1) / 2 for k in range(51)]
    whole = [odd(k + 1) - even(k + 1) + cube[k] - square[k] * Fraction(4, 3) for k in range(51)]
    assert whole[0] == 0
    b = arb(0.22) * 4 / arb.pi() ** 2
    for x in intervals(arb.pi() ** 2 / 4, 1000):
        p, q, s, r = (entire(c, x) for c in (P, Q, S, whole[1:]))
        a = q / s**2 + s
        # Both sides squared, less 16/9 x^2, over x^4.
        assert r / s**2 * (a + arb(fmpq(4, 3))) + (p / s) ** 2 < arb(fmpq(16, 9)) * (
            2 * b + b**2 * x
        )
    # The mean of (theta/3) (1 + 0.22 theta^2 / pi^2) between theta0 <= 0.9 and pi.
    mean = (1 + arb(0.22) / 2 * (1 + arb(TURNED) ** 2 / arb.pi() ** 2)) / 6
    assert mean < SWEPT
