"""Minorants of g2o's EdgeSE2.

What `certpgo.objective.marginalized` leaves in the angle theta is
s (theta + beta / s)^2 + constant - beta^2 / s. theta^2 is convex in cos(theta), so
s theta^2 + 4 k cos(theta) is smallest at theta = alpha for k = (s / 2) alpha / sin(alpha), and
more turns only raise it. Couplings that are off by eps in the angle, and not k but kappa, cost at
most 4 kappa |eps| + 4 |k - kappa|.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, arctan2
from certpgo.objective.marginalized import remainder, set_aside
from certpgo.objective.minorants import Minorants

#: Angles below this touch like zero.
TINY = 2.0**-60


def minorants_in_the_plane(graph: Graph, measured: Ball, y: FloatArray, E: FloatArray) -> Minorants:
    """Minorants that touch at translations y (m, 2) and rotations E (m, 2, 2), up to rounding."""
    theta = so.log(E)
    aside = set_aside(graph, np.concatenate([y, theta], axis=1), _curvature)
    fits, s0 = np.isfinite(aside.lam), aside.schur[:, 0, 0]
    with np.errstate(all="ignore"):
        alpha = aside.slope[:, 0] / (2.0 * s0)
        fits &= np.abs(alpha) < np.pi
        alpha = np.where(fits, alpha, 0.0)
        kappa = np.where(fits, 0.5 * s0 / np.sinc(alpha / np.pi), 1.0)
    N = kappa[:, None, None] * (graph.rotations @ so.exp(theta - alpha[:, None]))
    N[:, 0, 0], N[:, 0, 1] = N[:, 1, 1], -N[:, 1, 0]
    lam = np.where(fits, aside.lam, 1.0)
    b = np.where(fits[:, None], aside.b, 0.0)

    quadratic, linear, constant = remainder(graph, measured, lam, b)
    s, beta = quadratic[:, 0, 0], 0.5 * linear[:, 0]
    at = Ball.exact(alpha)
    sine = at.sin()
    quotient = at / sine
    tiny = np.abs(alpha) < 1e-5  # 1 <= alpha / sin(alpha) <= 1 + alpha^2 / 5
    mid = np.where(tiny, 1.0 + alpha**2 / 6.0, quotient.mid)
    k = 0.5 * s * Ball(mid, np.where(tiny, 0.3 * alpha**4 + 1e-15, quotient.radius))
    c, n = Ball.exact(N[:, 0, 0]), Ball.exact(N[:, 1, 0])
    weight = (c * c + n * n).sqrt()
    R = graph.rotations
    x, z = Ball.exact(R[:, 0, 0]) + R[:, 1, 1], Ball.exact(R[:, 1, 0]) - R[:, 0, 1]
    # The angle of the couplings, less that of the measured rotation.
    apart = arctan2(n * x - c * z, c * x + n * z)
    off = apart + beta / s
    turns = np.round(off.mid / (2.0 * np.pi))
    off = off - 2.0 * np.pi * turns
    error = off.size + 1e-15 * np.abs(turns)  # and of 2 pi
    lowest = s * at * at + 4.0 * k * at.cos() - 4.0 * ((k - weight).size + weight.upper * error)
    found = (constant - beta * beta / s + lowest).lower
    fits &= (s.lower > 0.0) & np.isfinite(found)
    # The checker divides by the sine, of which a tiny angle leaves few digits.
    touching = np.where(np.abs(alpha) < TINY, 0.0, np.abs(alpha))[:, None]
    return Minorants(lam, graph.own_arms, b, N, np.where(fits, found, -np.inf), touching)


def _curvature(schur: FloatArray, theta: FloatArray, slope: FloatArray) -> FloatArray:
    """s, less the nearer the angle at which the minorant touches is to pi, where there is none."""
    s = schur[:, 0, 0]
    share = np.abs(slope[:, 0]) / (2.0 * np.pi * s)
    return np.where((s > 0.0) & (share < 1.0), s * (1.0 - share**2), -np.inf)
