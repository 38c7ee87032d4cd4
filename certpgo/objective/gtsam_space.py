r"""Minorants of GTSAM's cost in space, for any positive definite information.

Let Omega = [[T, P], [P^T, W]], t < lambda_min(T) (or t = T where T is a multiple of I and P = 0),
T' = T - t I, W' = W - P^T T'^-1 P and q = u + T'^-1 P omega. Then

    f = t |u|^2 + q^T T' q + omega^T W' omega,    |u|^2 = |y|^2 + |z|^2 / h,    z = y - E^T y,

with the functions of s = 4 sin^2(theta/2) of `certpgo.objective.angle_functions`. The minorant is a
sum of minorants of the three terms, each minus what pays for the others. With arbitrary q0, k =
share T' q0, p = share P^T q0 and 0 <= share <= 1,

    q^T T' q >= 2 k.u + 2 p.omega - k.q0,

and, as k.u = y.V^-T k, its part that is not linear in the class is

    2 k.u - (2 k.y - k.z) = 2 y.D(omega),    D(omega) = V^-T k - (k + E k) / 2.

*Translations.* With b' = R~^T (b - t~), the minorant's terms in y and z are tau |y|^2 +
2 tau (a - b').y - 2 tau a.z. Minimising the difference over y and z, whatever they are, leaves

    - eta |y~|^2 + 2 y~.(D(omega) - D0) - |D(omega) - D0|^2 / eta - |2 tau a - k|^2 h / (4 t),

eta = t - tau > 0, D0 = D(omega0), and y~ = -(k - tau (a - b') + D0) / eta, intended to be y0.

*What couples translations and rotations*, for k or p not zero. By the definition of D,

    2 y~.D(omega) = omega.(k x y~) + 2 c(theta) omega^T M omega + k.y~ - y~^T E k,
    M = (k y~^T + y~ k^T) / 2 - (k.y~) I,

of which the last two are linear in E. c(theta) >= 1/12 leaves omega^T M omega / 6, which joins W',
and zeta = 2 (c - 1/12) omega^T M omega. Let d = omega - omega0; all is smooth on |omega| <= pi:

- |zeta - its tangent at omega0| <= 0.34 |k| |y~| |d|^2. By the derivatives in x = theta^2 of
  c - 1/12, all of which increase, the Hessian of zeta is at most 2 |M| (4 c'' x^2 + 10 c' x +
  2 (c - 1/12)) at x = pi^2, below 0.68 |M|, and |M| <= |k| |y~|.
- |D(omega) - D0| <= ((pi + theta0) / 6) 1.12 |k| |d| for theta0 <= 0.9. D = nu(theta) k in the
  plane normal to omega, taken as complex numbers, with |nu| = rho(theta/2), rho(x) = x / sin(x) -
  cos(x), and |nu'| = (rho'^2 + rho^2)^(1/2) / 2 <= (theta/3) (1 + 0.22 theta^2 / pi^2). The
  derivative of D along unit vectors at an angle beta to omega has norm at most (n cos(beta) +
  (n^2 cos^2(beta) + 4 (|nu| / theta)^2 sin^2(beta))^(1/2)) / 2, n = |nu'|, which is at most n or
  2 |nu| / theta; the bound on |nu'| bounds both. On the segment from omega0 to omega, theta is at
  most its linear interpolation between theta0 and pi.
- For a slope gamma, G = E0 [g]_x / 2 with g = J_r(omega0)^-T gamma, <G, E - E0> has the slope gamma
  at omega0, and is within |g| |d|^2 / 2 of gamma.d, as the second derivative of exp([omega]_x)
  along a unit vector has a norm of at most one, and G's singular values sum to |g|.

So with mu |omega|^2 = mu (theta0^2 + 2 omega0.d + |d|^2) taken from W' + M / 6, and gamma = 2 mu
omega0 + 2 p + k x y~ + zeta'(omega0), the inequality

    mu >= 0.34 |k| |y~| + (0.1867 (pi + theta0) |k|)^2 / eta + |g| / 2

leaves mu theta0^2 + (2 p + k x y~).omega0 + zeta(omega0) + <G, E - E0> below all these terms.

*Rotations.* What remains is O = W' + M / 6 - mu I. Let rho <= lambda_min(O) and O' = part (O - rho
I), 0 <= part <= 1. With e = vee(E) = omega sin(theta) / theta and psi = 1 / chi,

    omega^T O omega >= rho g + psi e^T O' e + s n^T (1 - part) (O - rho I) n,

as theta^2 >= s. The last term is 2 <K, I - E> for K = tr(O'') I / 2 - O'', O'' = (1 - part) (O -
rho I). For any e0, psi e^T O' e >= c_e.e - X chi, c_e = 2 psi0 O' e0 and X = psi0^2 e0^T O' e0. Now

    phi(s) = rho g - c_s s - |2 tau a - k|^2 h / (4 t) - X chi

is convex and bounded below as in the plane (see `certpgo.objective.gtsam_plane`), with rho for w'.
What the couplings of the minorant have beyond c_s I, c_e, K, y~ k^T and G is of the size of
rounding, and |<A, E>| <= sum |A_ij|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball, crossed, is_positive_definite, sums
from certpgo.objective.angle_functions import clipped, exponential, half_cotangent
from certpgo.objective.gtsam_terms import (
    CURVED,
    SWEPT,
    TURNED,
    SpatialTerms,
    dots,
    inverse_jacobians,
    slopes,
    smallest_eigenvalue,
    taken_apart,
    times,
    transposed,
)
from certpgo.objective.marginalized import blocks
from certpgo.objective.minorants import Minorants


def minorants_in_space(graph: Graph, measured: Ball, y: FloatArray, E: FloatArray) -> Minorants:
    """Minorants that touch at translations y (m, 3) and rotations E (m, 3, 3), up to rounding.

    None where the information is not positive definite.
    """
    with np.errstate(all="ignore"):
        terms = taken_apart(graph, y, clipped(so.log(E)))
        tau, a, b, N = _edges(graph, terms)
        sound = (terms.rho > 0.0) & (tau > 0.0) & np.isfinite(N).all(axis=(1, 2))
        sound &= np.isfinite(a + b).all(axis=1)
        tau, a, b, N = np.where(sound, tau, 1.0), _kept(a, sound), _kept(b, sound), _kept(N, sound)
        a = a + graph.own_arms
        found = Minorants(tau, a, b, N, np.zeros_like(tau))
        constant = _constants(graph, measured, found, terms)
    return Minorants(tau, a, b, N, np.where(sound & np.isfinite(constant), constant, -np.inf))


def _edges(graph: Graph, of: SpatialTerms) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weights (m,), arms a and b (m, 3) and couplings (m, 3, 3) of the minorants."""
    at, k, part = of.at, of.k, of.part
    tau, E = of.t - of.eta, so.exp(of.omega)
    inverse = inverse_jacobians(of.omega)
    swept = times(transposed(inverse), k) - 0.5 * (k + times(E, k))
    over = of.remains - of.rho[:, None, None] * np.eye(3)
    c_e = 2.0 * part[:, None] * times(over, of.e)
    c_z = 2.0 * (of.t / at.h.nearest)[:, None] * (of.y - times(transposed(E), of.y))
    c_s = of.rho * at.dg.nearest - dots(c_z, c_z) / (4.0 * of.t) * at.dh.nearest
    c_s -= 0.5 * dots(c_e, of.e) * at.dchi.nearest
    a = (k - c_z) / (2.0 * tau)[:, None]
    b = a - (k + swept + of.eta[:, None] * of.y) / tau[:, None]
    free = (1.0 - part)[:, None, None] * over
    slope = 2.0 * of.mu[:, None] * of.omega + slopes(k, of.p, of.y, of.omega)
    coupled = c_s[:, None, None] * np.eye(3) - 0.5 * so.hat(c_e)
    coupled += np.trace(free, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 2.0 * free
    coupled += of.y[:, :, None] * k[:, None, :] - 0.5 * E @ so.hat(times(inverse, slope))
    coupled = 0.5 * coupled - tau[:, None, None] * b[:, :, None] * a[:, None, :]
    R = graph.rotations
    return tau, a, graph.translations + times(R, b), R @ coupled


def _constants(graph: Graph, R: Ball, found: Minorants, of: SpatialTerms) -> FloatArray:
    """Lower bounds (m,) on f less the minorants with constant zero."""
    T, P, W = (Ball.exact(block).widened for block in blocks(graph.information_matrices, 3))
    t, tau, rho = (Ball.exact(x).widened for x in (of.t, found.tau, of.rho))
    a, e = Ball.exact(found.a).widened - graph.own_arms, Ball.exact(of.e).widened
    at, part = of.at, of.part
    b = R.T.apply(Ball.exact(found.b).widened - graph.translations)
    N = R.T @ found.N + _scaled(tau, b[:, :, None] * a[:, None, :])
    rest, eta = T - _scaled(t), t - tau
    least, definite = np.full(len(of.t), 0.5), of.scalar
    if not of.scalar.all():
        of_rest = np.where(of.scalar[:, None, None], np.eye(3), of.rest)
        least = 0.5 * smallest_eigenvalue(of_rest)
        definite = definite | is_positive_definite(rest - _scaled(Ball.exact(least)))
    touched = _touched(of, rest, P, tau, a, b) if of.x.any() else _untouched(of, tau, a, b)

    # Rotations. P = T' r + off: P^T T'^-1 P is at most P^T r + r^T off + |off|^2 / least.
    remains = W if touched.bent is None else W + touched.bent
    if P.mid.any() or of.r.any():
        off = P - rest @ of.r
        remains = remains - _scaled(sums(sums(off * off)) / least)
        remains = remains - P.T @ of.r - Ball.exact(of.r).T @ off
    over = remains - _scaled(Ball.exact(of.mu) + rho)
    over_e = over.apply(e)
    X, c_e = part * e.dot(over_e), 2.0 * part[:, None] * over_e
    couplings, free = 2.0 * N, None
    if touched.linear is not None:
        couplings = couplings - touched.linear
    if (part != 1.0).any():
        shared = _scaled(1.0 - Ball.exact(part), over)
        free = _trace(shared)
        couplings = couplings + 2.0 * shared - _scaled(free)
    c_s, Z = _trace(couplings) / 3.0, touched.c_z.dot(touched.c_z) / (4.0 * t)
    wrong = couplings - _scaled(c_s) + 0.5 * crossed(c_e)
    value = rho * at.g - c_s * at.s - Z * at.h - X * at.chi
    tilt = rho * at.dg - c_s - Z * at.dh - X * at.dchi
    room = rho - 0.2 * X
    lowest = value - 3.0 * tilt * tilt / room + 3.0 * c_s
    total = touched.constant - tau * (a.dot(a) + b.dot(b)) + lowest - sums(sums(wrong.absolute))
    total = total if free is None else total + free
    proven = definite & touched.paid & is_positive_definite(over) & (room.lower > 0.0)
    return np.where(proven & (eta.lower > 0.0), total.lower, -np.inf)


@dataclass(frozen=True, eq=False)
class _Touched:
    """What the translations leave, minimised over; None stands for zeros."""

    constant: Ball  # (m,)
    c_z: Ball  # (m, 3) 2 tau a - k
    paid: BoolArray  # (m,) whether mu is large enough
    bent: Ball | None = None  # (m, 3, 3) M / 6
    linear: Ball | None = None  # (m, 3, 3) what is linear in E


def _untouched(of: SpatialTerms, tau: Ball, a: Ball, b: Ball) -> _Touched:
    """With k, p and D zero."""
    y = tau[:, None] * (a - b) / (of.t - tau)[:, None]
    return _Touched((tau - of.t) * y.dot(y), 2.0 * tau[:, None] * a, of.mu == 0.0)


def _touched(of: SpatialTerms, rest: Ball, P: Ball, tau: Ball, a: Ball, b: Ball) -> _Touched:
    mu, omega, x = (Ball.exact(x).widened for x in (of.mu, of.omega, of.x))
    share, eta = np.where(of.share > 0.0, of.share, 1.0), of.t - tau
    k, p = rest.apply(x), P.T.apply(x)
    # Minimised over translations: y~ and what depends on omega, a constant but for D.
    hat, E = crossed(omega), exponential(omega)
    c, dc = (x[:, None] for x in half_cotangent(omega.dot(omega)))
    swept = _inverse_jacobian(-hat, c, k) - 0.5 * (k + E.apply(k))
    y = (tau[:, None] * (a - b) - k - swept) / eta[:, None]
    constant = k.dot(y) - eta * y.dot(y) - 2.0 * y.dot(swept) - x.dot(k) / share

    # Linear in E but for what mu pays.
    M = 0.5 * (k[:, :, None] * y[:, None, :] + y[:, :, None] * k[:, None, :]) - _scaled(k.dot(y))
    turned, bent = M.apply(omega), c - Ball.exact(1.0).widened / 12.0
    form, linear = omega.dot(turned)[:, None], 2.0 * p + crossed(k).apply(y)
    slope = 2.0 * mu[:, None] * omega + linear + 4.0 * (dc * form * omega + bent * turned)
    g = _inverse_jacobian(hat, c, slope)
    constant = constant + mu * omega.dot(omega) + linear.dot(omega) + (2.0 * bent * form)[:, 0]
    swing = (SWEPT * (1.0 + 1e-9)) * (of.at.theta + np.pi) * k.dot(k).sqrt()
    price = CURVED * (k.dot(k) * y.dot(y)).sqrt() + swing * swing / eta + 0.5 * g.dot(g).sqrt()
    paid = (of.scalar | ~of.x.any(axis=1)) & (of.mu == 0.0)
    paid |= ((mu - price * (1.0 + 1e-9)).lower >= 0.0) & (of.at.theta <= TURNED)
    coupled = y[:, :, None] * k[:, None, :] - 0.5 * (E @ crossed(g))
    return _Touched(constant, 2.0 * tau[:, None] * a - k, paid, M / 6.0, coupled)


def _inverse_jacobian(hat: Ball, c: Ball, x: Ball) -> Ball:
    """V^-1 x; its transpose for -hat."""
    turned = hat.apply(x)
    return x - 0.5 * turned + c * hat.apply(turned)


def _scaled(weights: Ball, matrices: Ball | None = None) -> Ball:
    """Multiples (m, 3, 3) of matrices, or of I."""
    scale = weights[:, None, None]
    return scale * np.eye(3) if matrices is None else scale * matrices


def _trace(A: Ball) -> Ball:
    return A[:, 0, 0] + A[:, 1, 1] + A[:, 2, 2]


def _kept(x: FloatArray, sound: BoolArray) -> FloatArray:
    """Zeros where minorants are not sound."""
    return np.where(sound.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)
