r"""Minorants of GTSAM's cost in the plane, for any positive definite information.

Let Omega = [[T, p], [p^T, w]] and tau < lambda_min(T), T' = T - tau I, r = T'^-1 p, and
w' = w - p.r. With z = y - E^T y, y^ = (y + E^T y) / 2, z'' = y^ + r sin(theta), and the functions
of s = 4 sin^2(theta/2) of `certpgo.objective.angle_functions`, psi = 1 / chi,

    u = (theta / sin(theta)) y^,    |u|^2 = |y|^2 + |z|^2 / h,
    f = tau |y|^2 + tau |z|^2 / h + psi z''^T T' z'' + w' g.

The minorant keeps tau |y|^2 and has the tangent plane of the rest in (z, z'', s): with c_z, c and
c_s real, c_z.z + c.z'' + c_s s + constant. y = y^ + z/2 and E^T y = y^ - z/2, hence it has the form
tau |v + Q a - b|^2 - 2 <N, Q> + constant with, for b' = R~^T (b - t~) and N' = R~^T N + tau b' a^T,

    c = 2 tau (a - b'),    c_z = -tau (a + b'),    c_s = tr N',    c.r = -2 (N'_21 - N'_12).

*The constant for given doubles.* Take these as definitions of c, c_z and c_s, so that only the last
equation has an error, eps. Minimising f less the minorant over z and z'', whatever they are,

    f - m >= phi(s) - |eps| + const,    phi = w' g - c_s s - |c_z|^2 h / (4 tau) - X chi,
    X = c^T T'^-1 c / 4.

h is concave and chi'' <= g'' / 5 on [0, 4], where g'' >= 1/6 (tests/objective prove both; see
OBJECTIVES 1c). So phi'' >= k = (w' - X / 5) / 6, and if k > 0,

    phi(s) >= phi(s0) + phi'(s0) (s - s0) + k (s - s0)^2 / 2 >= phi(s0) - phi'(s0)^2 / (2 k)

for any s0, with phi'(s0) of the size of rounding where the minorant touches. X is expanded about
its intended value: for c = 2 T' x + xi, X = x^T T' x + x.xi + xi^T T'^-1 xi / 4, and likewise p.r.

Where the residual angle is so large that X would exceed 4 w', only a share of T' is touched: the
rest of psi z''^T T' z'' is at least zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball, is_positive_definite
from certpgo.objective.angle_functions import AngleFunctions, clipped
from certpgo.objective.minorants import Minorants

#: Shares of the largest tau for which w' is not negative.
SHARES = (1.0 - 2.0**-20, 0.99, 0.9, 0.75, 0.5, 0.25, 0.1)
#: X may be at most this times w'; 5 would do.
ROOM = 4.0


@dataclass(frozen=True, eq=False)
class _Expansion:
    """What the minorants are about: doubles, none of which needs be accurate."""

    tau: FloatArray  # (m,)
    least: FloatArray  # (m,) below the smallest eigenvalue of T'
    r: FloatArray  # (m, 2)
    x: FloatArray  # (m, 2) c = 2 T' x
    share: FloatArray  # (m,) of T' that is touched
    at: AngleFunctions


def minorants_in_the_plane(graph: Graph, measured: Ball, y: FloatArray, E: FloatArray) -> Minorants:
    """Minorants that touch at translations y (m, 2) and rotations E (m, 2, 2), up to rounding.

    None where the information is not positive definite.
    """
    T, p, w = _blocks(graph.information_matrices)
    tau, rest, r, left = _split(T, p, w)
    theta = clipped(so.log(E))[:, 0]
    at = AngleFunctions.of(np.abs(theta))
    back = np.swapaxes(so.exp(theta[:, None]), 1, 2)
    turned = (back @ y[:, :, None])[:, :, 0]
    z, middle = y - turned, 0.5 * (y + turned)
    psi, sine = 1.0 / at.chi.nearest, np.sin(theta)
    with np.errstate(all="ignore"):
        z2 = middle + r * sine[:, None]
        T_z2 = (rest @ z2[:, :, None])[:, :, 0]
        X = psi**2 * _dots(z2, T_z2)
        share = np.where(ROOM * left < X, ROOM * left / X, 1.0)
        c_z = 2.0 * (tau / at.h.nearest)[:, None] * z
        c = 2.0 * (share * psi)[:, None] * T_z2
        c_s = left * at.dg.nearest - at.dh.nearest * _dots(c_z, c_z) / (4.0 * tau)
        c_s -= share * X * at.dchi.nearest
        # m has alpha.y + beta.E^T y, with b' = -alpha / (2 tau) and a = beta / (2 tau).
        alpha, a = c_z + 0.5 * c, (0.5 * c - c_z) / (2.0 * tau)[:, None]
        coupled = 0.5 * c_s[:, None, None] * np.eye(2)
        coupled += 0.5 * alpha[:, :, None] * a[:, None, :]
        coupled -= 0.25 * _dots(c, r)[:, None, None] * so.hat(np.ones(1))
    R = graph.rotations
    b = graph.translations - (R @ (alpha / (2.0 * tau)[:, None])[:, :, None])[:, :, 0]
    N = R @ coupled
    sound = (left > 0.0) & np.isfinite(N).all(axis=(1, 2)) & np.isfinite(a + b).all(axis=1)
    least = 0.5 * np.linalg.eigvalsh(np.where(sound[:, None, None], rest, np.eye(2)))[:, 0]
    x = (share * psi)[:, None] * z2
    about = _Expansion(tau, least, r, x, share, at)
    found = Minorants(tau, a + graph.own_arms, b, N, np.zeros(len(tau)))
    return _with_constants(graph, measured, found, about, sound)


def _with_constants(
    graph: Graph,
    measured: Ball,
    found: Minorants,
    about: _Expansion,
    sound: BoolArray,
) -> Minorants:
    """The minorants with their constants, and none where they are not sound."""
    keep = sound[:, None]
    tau, a = np.where(sound, found.tau, 1.0), np.where(keep, found.a, 0.0)
    b, N = np.where(keep, found.b, 0.0), np.where(keep[:, :, None], found.N, 0.0)
    with np.errstate(all="ignore"):
        constant = _constants(graph, measured, Minorants(tau, a, b, N, found.constant), about)
    return Minorants(tau, a, b, N, np.where(sound & np.isfinite(constant), constant, -np.inf))


def _constants(graph: Graph, R: Ball, found: Minorants, about: _Expansion) -> FloatArray:
    """Lower bounds (m,) on f less the minorants with constant zero."""
    T, p, w = (Ball.exact(block).widened for block in _blocks(graph.information_matrices))
    tau, at = Ball.exact(found.tau).widened, about.at
    a = Ball.exact(found.a).widened - graph.own_arms
    b = R.T.apply(Ball.exact(found.b).widened - graph.translations)
    N = R.T @ found.N + tau[:, None, None] * b[:, :, None] * a[:, None, :]
    rest = T - tau[:, None, None] * np.eye(2)
    least = Ball.exact(about.least).widened
    definite = is_positive_definite(rest - least[:, None, None] * np.eye(2))

    # p = T' r + off: p.T'^-1 p = p.r + r.off + off.T'^-1 off.
    r, x = Ball.exact(about.r), Ball.exact(about.x)
    off = p - rest.apply(r)
    left = w - p.dot(r) - r.dot(off) - _up_to(off.dot(off) / least)
    c, c_z = 2.0 * tau[:, None] * (a - b), tau[:, None] * (a + b)
    xi = c - 2.0 * rest.apply(x)
    X = x.dot(rest.apply(x)) + x.dot(xi) + _up_to(0.25 * xi.dot(xi) / least)
    X = X / about.share
    c_s = N[:, 0, 0] + N[:, 1, 1]
    # c.T'^-1 p = 2 x.p + xi.r + xi.T'^-1 off
    sine = 2.0 * (x.dot(p) + N[:, 1, 0] - N[:, 0, 1]) + xi.dot(r)
    sizes = xi.dot(xi).sqrt() * off.dot(off).sqrt() / least
    Z = c_z.dot(c_z) / (4.0 * tau)
    value = left * at.g - c_s * at.s - Z * at.h - X * at.chi
    slope = left * at.dg - c_s - Z * at.dh - X * at.dchi
    room = left - 0.2 * X
    lowest = value - 3.0 * slope * slope / room - (sine.size + sizes.size)
    total = lowest + 2.0 * c_s - tau * (a.dot(a) + b.dot(b))
    proven = definite & (found.tau > 0.0) & (about.least > 0.0) & (room.lower > 0.0)
    return np.where(proven, total.lower, -np.inf)


def _split(
    T: FloatArray, p: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Tau (m,), T' (m, 2, 2), r (m, 2) and w' (m,); nan where the information is not definite.

    Of the shares tried, the one with the largest tau w'.
    """
    m = len(w)
    # w' > 0 exactly for tau below the inverse of the largest translational variance.
    with np.errstate(all="ignore"):
        conditional = T - p[:, :, None] * p[:, None, :] / w[:, None, None]
    finite = (w > 0.0) & np.isfinite(conditional).all(axis=(1, 2))
    smallest = np.linalg.eigvalsh(np.where(finite[:, None, None], conditional, 0.0))[:, 0]
    tau, rest = np.full(m, np.nan), np.full((m, 2, 2), np.nan)
    r, left, best = np.full((m, 2), np.nan), np.full(m, np.nan), np.zeros(m)
    for share in SHARES:
        tried = share * smallest
        matrix = T - tried[:, None, None] * np.eye(2)
        with np.errstate(all="ignore"):
            solved = _solved(matrix, p)
            remaining = w - _dots(p, solved)
            worth = tried * remaining
        better = (smallest > 0.0) & (remaining > 0.0) & (worth > best)
        tau[better], rest[better], r[better] = tried[better], matrix[better], solved[better]
        left[better], best[better] = remaining[better], worth[better]
    return tau, rest, r, left


def _solved(A: FloatArray, p: FloatArray) -> FloatArray:
    """A^-1 p for symmetric matrices (m, 2, 2); zero where p is."""
    determinant = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] ** 2
    first = A[:, 1, 1] * p[:, 0] - A[:, 0, 1] * p[:, 1]
    second = A[:, 0, 0] * p[:, 1] - A[:, 0, 1] * p[:, 0]
    solved = np.stack([first, second], axis=1) / determinant[:, None]
    return np.where(np.any(p, axis=1, keepdims=True), solved, 0.0)


def _blocks(information: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    return information[:, :2, :2], information[:, :2, 2], information[:, 2, 2]


def _dots(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ma,ma->m", x, y))


def _up_to(x: Ball) -> Ball:
    """All numbers from zero to those of balls of numbers not below zero."""
    return Ball(0.0 * x.mid, x.size)
