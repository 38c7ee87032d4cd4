"""GTSAM's cost and minorants at 80 digits, for exactly the doubles given."""

from contextlib import contextmanager

import flint
import numpy as np
from flint import arb, arb_mat

HALF = arb(flint.fmpq(1, 2))


@contextmanager
def precision(bits=270):
    before, flint.ctx.prec = flint.ctx.prec, bits
    try:
        yield
    finally:
        flint.ctx.prec = before


def exact(x):
    """A double, or a number of the machine's wider format."""
    return arb(flint.fmpq(*(int(part) for part in x.as_integer_ratio())))


def matrix(A):
    return arb_mat([[exact(x) for x in row] for row in np.atleast_2d(A)])


def column(v):
    return matrix(np.asarray(v)[:, None])


def identity(d):
    return arb_mat([[arb(int(a == b)) for b in range(d)] for a in range(d)])


def nearest_rotation(A):
    """The polar factor of a matrix that is close to a rotation."""
    X = matrix(A)
    d = X.nrows()
    for _ in range(7):
        X = X * (3 * identity(d) - X.transpose() * X) * HALF
        X = arb_mat([[arb(X[a, b].mid()) for b in range(d)] for a in range(d)])
    return X


def hat(w):
    if len(w) == 1:
        return arb_mat([[arb(0), -w[0]], [w[0], arb(0)]])
    x, y, z = w
    return arb_mat([[arb(0), -z, y], [z, arb(0), -x], [-y, x, arb(0)]])


def exponential(w):
    x = sum((a * a for a in w), arb(0))
    theta, K = x.sqrt(), hat(w)
    if theta == 0:
        return identity(K.nrows())
    return identity(K.nrows()) + K * (theta.sin() / theta) + K * K * ((1 - theta.cos()) / x)


def logarithm(E):
    """Rotation vectors of angles that are neither zero nor pi."""
    if E.nrows() == 2:
        return [arb.atan2(E[1, 0] - E[0, 1], E[0, 0] + E[1, 1])]
    e = [(E[2, 1] - E[1, 2]) / 2, (E[0, 2] - E[2, 0]) / 2, (E[1, 0] - E[0, 1]) / 2]
    sine = sum((a * a for a in e), arb(0)).sqrt()
    theta = arb.atan2(sine, (E[0, 0] + E[1, 1] + E[2, 2] - 1) / 2)
    return [a * theta / sine for a in e]


def gtsam_residual(w, y):
    """(u, omega) of omega = Log E, a list, and y, a column."""
    x = sum((a * a for a in w), arb(0))
    half = x.sqrt() / 2
    c = (1 - half * half.cot()) / x if x > 0 else arb(flint.fmpq(1, 12))
    once = hat(w) * y
    u = y - once * HALF + hat(w) * once * c
    return arb_mat([[a] for a in [*u.entries(), *w]])


def gtsam_cost(information, w, y):
    e = gtsam_residual(w, y)
    return (e.transpose() * matrix(information) * e)[0, 0]


def minorant(found, edge, v, Q):
    """m(v, Q) of an edge of `Minorants`."""
    r = v + Q * column(found.a[edge]) - column(found.b[edge])
    pairs = zip(matrix(found.N[edge]).entries(), Q.entries(), strict=True)
    coupled = sum((a * b for a, b in pairs), arb(0))
    constant = exact(found.constant[edge])
    return exact(found.tau[edge]) * (r.transpose() * r)[0, 0] - 2 * coupled + constant
