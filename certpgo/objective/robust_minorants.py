"""Minorants of robust costs rho(q), where q = kappa |Q - R|_F^2 + tau |v - t|^2.

**Rotations** (tau = 0). With E = R^T Q, s = |E - I|_F^2 = 4 (1 - cos) of its angle, g(y) = rho at
the angle y, and E0 at the estimate, of angle theta0 about n: in quaternions (w, x) of E, let
r^2 = w^2 + (n . x)^2 and (w, n . x) = r (cos y/2, sin y/2). Then

    m = r^2 [g0 + g0' sin(y - theta0) + k (1 - cos(y - theta0))] + (1 - r^2) g(pi)

is linear in E and touches at E0 with its gradient. As s = r^2 s(y) + (1 - r^2) 8 and rho is
concave, m <= rho everywhere iff the bracket is at most g on the circle. As rho is the least of its
tangents, that is so for the k of `certpgo.objective.kernel_profiles`. In the plane r = 1.

With P = -g0' sin theta0 - k cos theta0, S = g0' cos theta0 - k sin theta0, B = g0 + k - g(pi),

    m = g(pi) + B / 2 + <(B - P) / 2 n n^T + P / 2 I + S / 2 [n], E>,    [n] the skew matrix of n.

What is exact is theta0, by s0, and n; R has a ball; the rounded coupling costs its distance.

**Poses.** Let z be the residual with |z|^2 = q. For w >= 0 such that r(x^2) is nowhere below its
tangent less w (x - x0)^2, rho is nowhere below its tangent less w |z - z0|^2: that is a square of
negative weight, -w |z - z0 (1 + rho' / w)|^2 + rho + q rho'^2 / w, as in
`certpgo.objective.truncated`. It touches, but takes translational weight away: where no other
measurement gives some, there is no bound.
"""

from __future__ import annotations

import math

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball, U, crossed, sums
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.kernel_profiles import FARTHEST
from certpgo.objective.kernels import AppliedKernel
from certpgo.objective.minorants import Minorants
from certpgo.objective.truncated import Truncation

#: The least weight w that minorants of poses take away, whose centre is as much further out.
FAINT = 2.0**-12
#: By which w is above what suffices, for rounding.
RAISED = 1e-9


def robust_minorants(
    kernel: AppliedKernel, graph: Graph, v: FloatArray, Q: FloatArray
) -> Minorants:
    """Minorants of rho of the terms of F, which touch at (v, Q) where there are any.

    Parameters
    ----------
    kernel : of all edges, none of which is idle
    graph : k edges with isotropic weights
    v, Q : (k, d) and (k, d, d)
    """
    alone = ~graph.measures_translation
    if alone.all():
        return of_rotations(kernel, graph, Q)
    found = of_poses(kernel, graph, v, Q)
    if not alone.any():
        return found
    return found.replaced(alone, of_rotations(kernel.of(alone), graph.with_edges(alone), Q[alone]))


def of_rotations(kernel: AppliedKernel, graph: Graph, Q: FloatArray) -> Minorants:
    """Those of edges that measure rotations alone."""
    R, kappa, d = graph.rotations, graph.kappa, graph.d
    E = np.swapaxes(R, 1, 2) @ Q
    turn = so.log(E)
    size = np.linalg.norm(turn, axis=1)
    n = np.where((size > 0.0)[:, None], turn, np.eye(turn.shape[1])[-1])
    s0 = np.minimum(FARTHEST * np.sin(0.5 * size) ** 2, FARTHEST)
    # rho grows with c.
    c = np.nextafter(kernel.squares / kappa, 0.0)
    found = _on_circle(kernel, s0, c)
    N, lost = _couplings(found, n, R, kappa)
    g0, g_pi, k, B = found["g0"], found["g_pi"], found["k"], found["B"]
    constant = g0 + k if d == 2 else g_pi + 0.5 * B
    values = (Ball.exact(kappa) * constant - lost).lower
    none = np.zeros((len(kappa), d))
    exist = np.isfinite(N).all(axis=(1, 2)) & np.isfinite(values)
    N = np.where(exist[:, None, None], N, 0.0)
    return Minorants(none[:, 0], none, none.copy(), N, np.where(exist, values, -np.inf))


def _on_circle(kernel: AppliedKernel, s0: FloatArray, c: FloatArray) -> dict[str, Ball]:
    """The numbers of m at exact s0 and c, for kappa = 1."""
    profile, s = kernel.profile, Ball.exact(s0)
    cos = 1.0 - 0.25 * s
    # Near a half turn, where this difference is small, it is exact.
    left = Ball.within(1.0 - 0.125 * s0, np.where(s0 < 0.5 * FARTHEST, U, 0.0))
    sin = (0.5 * s * left).sqrt()
    u, far = s / c, Ball.exact(np.full(len(c), FARTHEST)) / c
    g0 = profile.value_enclosures(u) * c
    g_pi = profile.value_enclosures(far) * c
    slope = 4.0 * sin * profile.slope_enclosures(u)
    k = Ball.exact(profile.curvature(s, Ball.exact(c)))
    return {
        "g0": g0,
        "g_pi": g_pi,
        "k": k,
        "P": -(slope * sin) - k * cos,
        "S": slope * cos - k * sin,
        "B": g0 + k - g_pi,
    }


def _couplings(
    found: dict[str, Ball], n: FloatArray, R: FloatArray, kappa: FloatArray
) -> tuple[FloatArray, Ball]:
    """N (k, d, d) for exact axes n / |n|, and what its rounding costs at most."""
    d = R.shape[1]
    P, S, B = (found[name] for name in ("P", "S", "B"))
    axis = Ball.exact(n)
    axis = axis / sums(axis.squared()).sqrt()[:, None]
    X = 0.5 * P[:, None, None] * np.eye(d) + 0.5 * S[:, None, None] * crossed(axis)
    if d == 3:
        outer = axis[:, :, None] * axis[:, None, :]
        X = X + (0.5 * (B - P))[:, None, None] * outer
    exact = -(Ball.within(R, rotation_defect(R)) @ X) * (0.5 * kappa)[:, None, None]
    N = exact.nearest
    off = (exact - N).reshaped(len(N), d * d)
    return N, 2.001 * math.sqrt(d) * sums(off.squared()).sqrt()


def of_poses(kernel: AppliedKernel, graph: Graph, v: FloatArray, Q: FloatArray) -> Minorants:
    """Those of edges with a translation, of negative weight."""
    falls = kernel.profile.falls
    if falls is None:
        cut = Truncation(graph, kernel.squares, v, Q)
        return cut.minorants(cut.plain())
    kappa, tau, c = graph.kappa, graph.tau, kernel.squares
    moved, turned = v - graph.translations, Q - graph.rotations
    q = kappa * (turned**2).sum(axis=(1, 2)) + tau * (moved**2).sum(axis=1)
    u = q / c
    w = np.maximum((1.0 + RAISED) * falls(u), FAINT)
    out = 1.0 + kernel.profile.slopes(u) / w
    b = graph.translations + out[:, None] * moved
    weight = w * kappa
    N = -(weight[:, None, None] * (graph.rotations + out[:, None, None] * turned))
    aside = w * tau
    constant = _of_squares(kernel, graph, (1.0 + 0.5 * RAISED) * falls(u), u, (aside, b, weight, N))
    return Minorants(-aside, graph.own_arms, b, N, constant)


def _of_squares(
    kernel: AppliedKernel,
    graph: Graph,
    least: FloatArray,
    u: FloatArray,
    square: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """(k,) the constant of -aside |v - b|^2 - 2 <N, Q>, for exactly these doubles, rounded down.

    For Z = -N / weight the rest of the square is -weight (|Q|^2 + |Z|^2) + 2 <..>. Its centre is
    at a distance in z that may be less than that where rho touches at exact u: rho then is as much
    lower as it grows over the difference, at most.

    Parameters
    ----------
    least : (k,) what w must be at least
    """
    aside, b, weight, N = square
    d, c, profile = graph.d, Ball.exact(kernel.squares), kernel.profile
    turning = graph.kappa > 0.0
    kappa, tau = Ball.exact(np.where(turning, graph.kappa, 1.0)), Ball.exact(graph.tau)
    heavy = Ball.exact(np.where(turning, weight, 1.0))
    # The smaller of both weights, over those of the measurement.
    shares = Ball.exact(aside) / tau, heavy / kappa
    w = np.minimum(shares[0].lower, np.where(turning, shares[1].lower, np.inf))
    exact, w_ = Ball.exact(u), Ball.exact(w)
    value, slope = profile.value_enclosures(exact), profile.slope_enclosures(exact)
    touched = c * (value + exact * slope * slope / w_)
    there = (c * exact).sqrt() * (1.0 + slope / w_)
    R = graph.rotations
    Z = -(Ball.exact(N) / heavy[:, None, None])
    off = (Z - Ball.within(R, rotation_defect(R))).reshaped(len(u), d * d)
    y = Ball.exact(b) - graph.translations
    far = tau * y.dot(y) + kappa * sums(off.squared()) * np.where(turning, 1.0, 0.0)
    short = np.maximum((there - far.sqrt()).upper, 0.0)
    lost = profile.steepest * c.sqrt() * short
    size = sums(Z.reshaped(len(u), d * d).squared())
    square_of = heavy * (size + float(d)) * np.where(turning, 1.0, 0.0)
    found = (touched - lost - square_of).lower
    fits = (least <= w) & np.isfinite(found)
    return np.where(fits, found, -np.inf)
