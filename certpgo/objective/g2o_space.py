"""Minorants of g2o's EdgeSE3:QUAT.

What `certpgo.objective.marginalized` leaves is a quadratic form and l.b, in the vector part b of
the unit quaternion q = (w, b), w >= 0. Quadratic forms in q are linear in E. For q0 = (w0, b0),
w0 >= 0 and |q0| <= 1,

    l.b >= (q.q0) l.b - k (1 - (q.q0)^2)    if k >= |k b0 + l|,

as the difference is (1 - q.q0) (l.b + k + k q.q0) >= (1 - q.q0) (k - |l + k b0|).

The relaxation bounds a form only if its largest curvature at q0 is at most the sum of the other
two: else the symmetric part K = (tr(H) I - 2 H) / 8 of the couplings, H the curvatures, is
indefinite. Hence (z.q)^2 is taken away, for z across q0 that lowers the largest curvature; where
the minorant touches, this loses nothing.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, joined, sums
from certpgo.objective.marginalized import remainder, set_aside
from certpgo.objective.minorants import Minorants

#: Share of the sum of the other two to which the largest curvature is lowered.
LOWERED = 0.999
#: What |q0| is below one by, for its rounding.
SHORT = 2.0**-48
#: Attempts to round a slope up.
MAX_RAISES = 8


def minorants_in_space(graph: Graph, measured: Ball, y: FloatArray, E: FloatArray) -> Minorants:
    """Minorants that touch at translations y (m, 3) and rotations E (m, 3, 3), up to rounding."""
    q = quaternions(E)
    aside = set_aside(graph, np.concatenate([y, q[:, 1:]], axis=1), _curvature)
    fits = np.isfinite(aside.lam)
    lam, b = np.where(fits, aside.lam, 1.0), np.where(fits[:, None], aside.b, 0.0)
    schur = np.where(fits[:, None, None], aside.schur, 0.0)
    quadratic, linear, constant = remainder(graph, measured, lam, b)
    q0 = q * (1.0 - SHORT)
    k = _slope(q0, linear)
    fits &= np.isfinite(k) & (sums(Ball.exact(q0).squared()).upper <= 1.0)
    k, carried = np.where(fits, k, 0.0), np.where(fits[:, None], linear.mid, 0.0)
    # The form to be matched, and the couplings N' of -2 <N', E> that match it.
    form = _form(Ball.exact(schur), Ball.exact(carried), k, q0).mid
    z = _steepness(form, q0)
    form = form - z[:, :, None] * z[:, None, :]
    beta, cross, D = form[:, 0, 0], form[:, 1:, 0], form[:, 1:, 1:]
    D = D - beta[:, None, None] * np.eye(3)
    trace = np.trace(D, axis1=1, axis2=2)[:, None, None]
    N = graph.rotations @ (0.125 * trace * np.eye(3) - 0.25 * D - 0.25 * so.hat(cross))

    taken = Ball.exact(z)[:, :, None] * z[:, None, :]
    total = _form(quadratic, linear, k, q0) - taken + 2.0 * _davenport(measured.T @ N)
    level = np.trace(total.mid, axis1=1, axis2=2) / 4.0
    rest = (total - level[:, None, None] * np.eye(4)).reshaped(-1, 16)
    spread = sums(rest * rest).sqrt()
    found = (constant - k + level - spread.size).lower
    found = np.where(fits & np.isfinite(found), found, -np.inf)
    touching = np.concatenate([q0, k[:, None]], axis=1)
    return Minorants(lam, graph.own_arms, b, N, found, touching)


def _curvature(schur: FloatArray, x: FloatArray, slope: FloatArray) -> FloatArray:
    """The product of the curvatures on the rotations; if one is negative, it counts alone."""
    linear = Ball.exact(slope - 2.0 * (schur @ x[:, :, None])[:, :, 0])
    w = np.sqrt(np.maximum(1.0 - (x * x).sum(axis=1), 0.0))
    q0 = np.concatenate([w[:, None], x], axis=1) * (1.0 - SHORT)
    k = _slope(q0, linear)
    fits = np.isfinite(k)
    values, _ = _curvatures(_form(Ball.exact(schur), linear, np.where(fits, k, 0.0), q0).mid, q0)
    values[:, 2] = np.minimum(values[:, 2], values[:, 0] + values[:, 1])
    worth = np.where(values[:, 0] > 0.0, values.prod(axis=1), values[:, 0])
    return np.where(fits, worth, -np.inf)


def _slope(q0: FloatArray, linear: Ball) -> FloatArray:
    """(m,) the smallest k >= |k b0 + l|, or a little more; infinite where there is none."""
    mid, b0 = linear.mid, q0[:, 1:]
    along, room = np.einsum("ma,ma->m", b0, mid), 1.0 - np.einsum("ma,ma->m", b0, b0)
    k = (along + np.sqrt(along**2 + room * np.einsum("ma,ma->m", mid, mid))) / room
    for _ in range(MAX_RAISES):
        needed = sums((k[:, None] * Ball.exact(b0) + linear).squared()).sqrt().upper
        short = needed > k
        short &= linear.size.any(axis=1)
        if not short.any():
            break
        k = np.where(short, needed + 1e-14 * needed / room, k)
    return np.where(short, np.inf, k)


def _curvatures(form: FloatArray, q0: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Curvatures (m, 3) of q^T form q on the unit sphere at q0, and (m, 4, 3) their directions."""
    v = q0 + np.eye(4)[0]
    scale = 2.0 / np.einsum("ma,ma->m", v, v)
    across = np.eye(4)[:, 1:] - scale[:, None, None] * v[:, :, None] * v[:, None, 1:]
    level = np.einsum("ma,mab,mb->m", q0, form, q0)
    values, vectors = np.linalg.eigh(np.swapaxes(across, 1, 2) @ form @ across)
    return values - level[:, None], across @ vectors


def _steepness(form: FloatArray, q0: FloatArray) -> FloatArray:
    """(m, 4) vectors z across q0 for which q^T (form - z z^T) q has a semidefinite K at q0.

    That is, the largest of its curvatures there is at most the sum of the other two.
    """
    values, directions = _curvatures(form, q0)
    excess = values[:, 2] - LOWERED * (values[:, 0] + values[:, 1])
    excess = np.where((values[:, 0] > 0.0) & (excess > 0.0), excess, 0.0)
    return np.asarray(np.sqrt(excess)[:, None] * directions[:, :, 2])


def _form(quadratic: Ball, linear: Ball, k: FloatArray, q0: FloatArray) -> Ball:
    """(m, 4, 4) matrices of b^T W b + (q.q0) l.b + k (q.q0)^2."""
    q = Ball.exact(q0)
    out = (k[:, None] * q)[:, :, None] * q[:, None, :]
    half = (0.5 * q)[:, :, None] * linear.padded(((0, 0), (1, 0)))[:, None, :]
    return out + half + half.T + quadratic.padded(((0, 0), (1, 0), (1, 0)))


def _davenport(N: Ball) -> Ball:
    """(m, 4, 4) matrices G with <N, E(q)> = q^T G q."""
    skew = N - N.T
    z = joined(skew[:, 2, 1, None], skew[:, 0, 2, None], skew[:, 1, 0, None])
    trace = N[:, 0, 0] + N[:, 1, 1] + N[:, 2, 2]
    lower = N + N.T - trace[:, None, None] * np.eye(3)
    corner = trace[:, None, None].padded(((0, 0), (0, 3), (0, 3)))
    side = z[:, None, :].padded(((0, 0), (0, 3), (1, 0)))
    return corner + side + side.T + lower.padded(((0, 0), (1, 0), (1, 0)))


def quaternions(E: FloatArray) -> FloatArray:
    """(m, 4) unit quaternions (w, b) of rotations, w >= 0."""
    v = so.log(E)
    half = 0.5 * np.linalg.norm(v, axis=1)[:, None]
    w = np.maximum(np.cos(half), 0.0)  # not below zero where the angle is rounded up to pi
    return np.concatenate([w, 0.5 * np.sinc(half / np.pi) * v], axis=1)
