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

from certpgo.graph.information import InformationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball, crossed, is_positive_definite, sums
from certpgo.objective.angle_functions import (
    AngleFunctions,
    clipped,
    exponential,
    half_cotangent,
    half_cotangents,
)
from certpgo.objective.edge_cost import Minorants
from certpgo.objective.marginalized import blocks, is_isotropic

#: Shares of the largest t for which W' is positive semidefinite.
SHARES = (0.99, 0.9, 0.75, 0.5, 0.25, 0.1)
#: The share without cross terms, and the share of t that tau is where k = 0: nothing is lost.
WHOLE, NEARLY = 1.0 - 2.0**-20, 1.0 - 2.0**-30
#: Shares of q^T T' q that may be touched, in order.
TOUCHED = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.0)
#: What of the least rotational information must be left after paying for the touched share.
KEPT = 0.1
#: eta is such that both lose alike if this share of the least rotational information were there,
#: and at most this share of t.
BALANCE, MOST = 0.25, 0.8
#: Bounds of the docstring: on zeta, on D, and the angle up to which they stand.
CURVED, SWEPT, TURNED = 0.34, 0.1867, 0.9
#: X may be at most this times rho; 5 would do.
ROOM = 4.0


@dataclass(frozen=True, eq=False)
class _Terms:
    """How the cost is taken apart, and where it is touched; none of these needs be accurate."""

    y: FloatArray  # (m, 3)
    omega: FloatArray  # (m, 3) omega0
    at: AngleFunctions
    t: FloatArray  # (m,)
    scalar: BoolArray  # (m,) whether T = t I and P = 0
    rest: FloatArray  # (m, 3, 3) T'
    r: FloatArray  # (m, 3, 3) T'^-1 P
    left: FloatArray  # (m, 3, 3) W'
    share: FloatArray  # (m,)
    x: FloatArray  # (m, 3) k = T' x
    p: FloatArray  # (m, 3)
    mu: FloatArray  # (m,)
    eta: FloatArray  # (m,)
    remains: FloatArray  # O, (m, 3, 3)
    rho: FloatArray  # (m,)

    @property
    def k(self) -> FloatArray:
        """(m, 3) the slope of the touched share of q^T T' q."""
        return _times(self.rest, self.x)

    @property
    def e(self) -> FloatArray:
        """(m, 3) psi0 e0."""
        return self.omega / self.at.sinc.nearest[:, None]

    @property
    def part(self) -> FloatArray:
        """(m,) of O - rho I that is touched."""
        X = np.einsum("ma,mab,mb->m", self.e, self.remains, self.e) - self.rho * _dots(
            self.e, self.e
        )
        return np.asarray(np.minimum(1.0, ROOM * self.rho / np.maximum(X, 1e-300)))


def minorants_in_space(
    graph: InformationGraph, measured: Ball, y: FloatArray, E: FloatArray
) -> Minorants:
    """Minorants that touch at translations y (m, 3) and rotations E (m, 3, 3), up to rounding.

    None where the information is not positive definite.
    """
    with np.errstate(all="ignore"):
        terms = _taken_apart(graph, y, clipped(so.log(E)))
        tau, a, b, N = _edges(graph, terms)
        sound = (terms.rho > 0.0) & (tau > 0.0) & np.isfinite(N).all(axis=(1, 2))
        sound &= np.isfinite(a + b).all(axis=1)
        tau, a, b, N = np.where(sound, tau, 1.0), _kept(a, sound), _kept(b, sound), _kept(N, sound)
        found = Minorants(tau, a, b, N, np.zeros_like(tau))
        constant = _constants(graph, measured, found, terms)
    return Minorants(tau, a, b, N, np.where(sound & np.isfinite(constant), constant, -np.inf))


def _taken_apart(graph: InformationGraph, y: FloatArray, omega: FloatArray) -> _Terms:
    """The largest share of T' touched for which enough rotational information remains."""
    T, P, W = blocks(graph.information, 3)
    t, scalar, r, left = _split(T, P, W)
    rest = np.where(scalar[:, None, None], 0.0, T - t[:, None, None] * np.eye(3))
    at = AngleFunctions.of(np.linalg.norm(omega, axis=1))
    inverse = _inverse_jacobians(omega)
    q = _times(inverse, y) + _times(r, omega)
    m = len(t)
    share, mu, eta, rho = np.zeros(m), np.zeros(m), np.zeros(m), np.empty(m)
    remains, todo = np.empty((m, 3, 3)), np.arange(m)
    known = rest, q, P, y, omega, at.theta, inverse, t, left, _smallest(left)
    for tried in TOUCHED:
        mu_now, eta_now, remains_now, rho_now, fits = _paid(tried, *(x[todo] for x in known))
        done, share[todo[fits]] = todo[fits], tried
        mu[done], eta[done] = mu_now[fits], eta_now[fits]
        remains[done], rho[done] = remains_now[fits], rho_now[fits]
        todo = todo[~fits]
        if not len(todo):
            break
    x = share[:, None] * q
    p = _times(_transposed(P), x)
    return _Terms(y, omega, at, t, scalar, rest, r, left, share, x, p, mu, eta, remains, rho)


def _paid(
    share: float,
    rest: FloatArray,
    q: FloatArray,
    P: FloatArray,
    y: FloatArray,
    omega: FloatArray,
    theta: FloatArray,
    inverse: FloatArray,
    t: FloatArray,
    left: FloatArray,
    smallest: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    """The prices mu and eta of touching a share, O and rho after it, and whether they suffice."""
    k = share * _times(rest, q)
    size = np.linalg.norm(k, axis=1)
    slope = _slopes(k, share * _times(_transposed(P), q), y, omega)
    swept = (SWEPT * (np.pi + theta) * size) ** 2
    balanced = np.clip(np.sqrt(swept * t / (BALANCE * smallest)), t / 1024, MOST * t)
    eta = np.where(size > 0.0, balanced, (1.0 - NEARLY) * t)
    needed = CURVED * size * np.linalg.norm(y, axis=1) + swept / eta
    needed += 0.5 * np.linalg.norm(_times(inverse, slope), axis=1)
    mu = np.where(needed > 0.0, 1.0001 * needed / (1.0 - theta), 0.0)
    remains = left + _bilinear(k, y) / 6.0 - mu[:, None, None] * np.eye(3)
    rho = _smallest(remains) - 1e-12 * np.abs(remains).sum(axis=(1, 2))
    fits = (rho >= KEPT * smallest) & ~((theta > TURNED) & (needed > 0.0))
    return mu, eta, remains, rho, fits | (share == 0.0)


def _edges(
    graph: InformationGraph, of: _Terms
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weights (m,), arms a and b (m, 3) and couplings (m, 3, 3) of the minorants."""
    at, k, part = of.at, of.k, of.part
    tau, E = of.t - of.eta, so.exp(of.omega)
    inverse = _inverse_jacobians(of.omega)
    swept = _times(_transposed(inverse), k) - 0.5 * (k + _times(E, k))
    over = of.remains - of.rho[:, None, None] * np.eye(3)
    c_e = 2.0 * part[:, None] * _times(over, of.e)
    c_z = 2.0 * (of.t / at.h.nearest)[:, None] * (of.y - _times(_transposed(E), of.y))
    c_s = of.rho * at.dg.nearest - _dots(c_z, c_z) / (4.0 * of.t) * at.dh.nearest
    c_s -= 0.5 * _dots(c_e, of.e) * at.dchi.nearest
    a = (k - c_z) / (2.0 * tau)[:, None]
    b = a - (k + swept + of.eta[:, None] * of.y) / tau[:, None]
    free = (1.0 - part)[:, None, None] * over
    slope = 2.0 * of.mu[:, None] * of.omega + _slopes(k, of.p, of.y, of.omega)
    coupled = c_s[:, None, None] * np.eye(3) - 0.5 * so.hat(c_e)
    coupled += np.trace(free, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 2.0 * free
    coupled += of.y[:, :, None] * k[:, None, :] - 0.5 * E @ so.hat(_times(inverse, slope))
    coupled = 0.5 * coupled - tau[:, None, None] * b[:, :, None] * a[:, None, :]
    R = graph.rotations
    return tau, a, graph.translations + _times(R, b), R @ coupled


def _constants(graph: InformationGraph, R: Ball, found: Minorants, of: _Terms) -> FloatArray:
    """Lower bounds (m,) on f less the minorants with constant zero."""
    T, P, W = (Ball.exact(block).widened for block in blocks(graph.information, 3))
    t, tau, mu, rho = (Ball.exact(x).widened for x in (of.t, found.tau, of.mu, of.rho))
    a, omega, x, e = (Ball.exact(x).widened for x in (found.a, of.omega, of.x, of.e))
    share, part = np.where(of.share > 0.0, of.share, 1.0), Ball.exact(of.part)
    at, b = of.at, R.T.apply(Ball.exact(found.b).widened - graph.translations)
    N = R.T @ found.N + _scaled(tau, b[:, :, None] * a[:, None, :])
    rest, eta = T - _scaled(t), t - tau
    k, p = rest.apply(x), P.T.apply(x)
    least = 0.5 * _smallest(np.where(of.scalar[:, None, None], np.eye(3), of.rest))
    definite = of.scalar | is_positive_definite(rest - _scaled(Ball.exact(least)))

    # Minimised over translations: y~ and what depends on omega, a constant but for D.
    hat, E = crossed(omega), exponential(omega)
    c, dc = (x[:, None] for x in half_cotangent(omega.dot(omega)))
    swept = _inverse_jacobian(-hat, c, k) - 0.5 * (k + E.apply(k))
    y = (tau[:, None] * (a - b) - k - swept) / eta[:, None]
    c_z = 2.0 * tau[:, None] * a - k
    constant = k.dot(y) - eta * y.dot(y) - 2.0 * y.dot(swept) - x.dot(k) / share
    constant = constant - tau * (a.dot(a) + b.dot(b))

    # Linear in E but for what mu pays.
    M = 0.5 * (k[:, :, None] * y[:, None, :] + y[:, :, None] * k[:, None, :]) - _scaled(k.dot(y))
    turned, bent = M.apply(omega), c - Ball.exact(1.0).widened / 12.0
    form, linear = omega.dot(turned)[:, None], 2.0 * p + crossed(k).apply(y)
    slope = 2.0 * mu[:, None] * omega + linear + 4.0 * (dc * form * omega + bent * turned)
    g = _inverse_jacobian(hat, c, slope)
    constant = constant + mu * omega.dot(omega) + linear.dot(omega) + (2.0 * bent * form)[:, 0]
    swing = (SWEPT * (1.0 + 1e-9)) * (at.theta + np.pi) * k.dot(k).sqrt()
    price = CURVED * (k.dot(k) * y.dot(y)).sqrt() + swing * swing / eta + 0.5 * g.dot(g).sqrt()
    paid = (of.scalar | ~of.x.any(axis=1)) & (of.mu == 0.0)
    paid |= ((mu - price * (1.0 + 1e-9)).lower >= 0.0) & (at.theta <= TURNED)

    # Rotations. P = T' r + off: P^T T'^-1 P is at most P^T r + r^T off + |off|^2 / least.
    off = P - rest @ of.r
    square = sums(sums(off * off)) / least
    remains = W + M / 6.0 - _scaled(mu + square) - P.T @ of.r - Ball.exact(of.r).T @ off
    over = remains - _scaled(rho)
    over_e, free = over.apply(e), _scaled(1.0 - part, over)
    X, c_e = part * e.dot(over_e), 2.0 * part[:, None] * over_e
    couplings = 2.0 * N - y[:, :, None] * k[:, None, :] + 0.5 * (E @ crossed(g))
    couplings = couplings + 2.0 * free - _scaled(_trace(free))
    c_s, Z = _trace(couplings) / 3.0, c_z.dot(c_z) / (4.0 * t)
    wrong = couplings - _scaled(c_s) + 0.5 * crossed(c_e)
    value = rho * at.g - c_s * at.s - Z * at.h - X * at.chi
    tilt = rho * at.dg - c_s - Z * at.dh - X * at.dchi
    room = rho - 0.2 * X
    lowest = value - 3.0 * tilt * tilt / room + 3.0 * c_s + _trace(free)
    total = constant + lowest - sums(sums(wrong.absolute))
    proven = definite & paid & is_positive_definite(over) & (room.lower > 0.0)
    return np.where(proven & (eta.lower > 0.0), total.lower, -np.inf)


def _split(
    T: FloatArray, P: FloatArray, W: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
    """Weights t (m,), whether T = t I and P = 0 (m,), T'^-1 P and W' (m, 3, 3).

    They are nan where the information is not definite. Of the shares tried, the one with the
    largest t^3 det W'.
    """
    m, least = len(T), _smallest(T)
    crossless = np.asarray(~P.any(axis=(1, 2)))
    scalar = is_isotropic(T) & crossless
    t = np.where(scalar, T[:, 0, 0], np.where(crossless, WHOLE * least, np.nan))
    # W' is positive definite exactly for t below the inverse of the largest translational variance.
    both = ~crossless & (_smallest(W) > 0.0)
    least[both] = _smallest(T[both] - P[both] @ np.linalg.solve(W[both], _transposed(P[both])))
    r, left, best = np.zeros((m, 3, 3)), W.copy(), np.full(m, -np.inf)
    left[~crossless] = np.nan
    for share in SHARES:
        tried = np.flatnonzero(both & (least > 0.0))
        rest = T[tried] - (share * least[tried])[:, None, None] * np.eye(3)
        solved = np.linalg.solve(rest, P[tried])
        remaining = W[tried] - _transposed(P[tried]) @ solved
        remaining = 0.5 * (remaining + _transposed(remaining))
        values = np.linalg.eigvalsh(remaining)
        worth = np.where(values[:, 0] > 0.0, share**3 * values.prod(axis=1), -np.inf)
        better = worth > best[tried]
        place = tried[better]
        t[place], r[place] = share * least[place], solved[better]
        left[place], best[place] = remaining[better], worth[better]
    return t, scalar, r, left


def _slopes(k: FloatArray, p: FloatArray, y: FloatArray, omega: FloatArray) -> FloatArray:
    """(m, 3) 2 p + k x y + zeta'(omega0)."""
    c, slope = half_cotangents(_dots(omega, omega))
    turned = _times(_bilinear(k, y), omega)
    bent = (slope * _dots(omega, turned))[:, None] * omega + (c - 1.0 / 12.0)[:, None] * turned
    return np.asarray(2.0 * p + np.cross(k, y) + 4.0 * bent)


def _bilinear(k: FloatArray, y: FloatArray) -> FloatArray:
    """The matrices M (m, 3, 3)."""
    outer = k[:, :, None] * y[:, None, :]
    return np.asarray(0.5 * (outer + _transposed(outer)) - _dots(k, y)[:, None, None] * np.eye(3))


def _inverse_jacobians(omega: FloatArray) -> FloatArray:
    """V^-1 (m, 3, 3)."""
    c, _ = half_cotangents(_dots(omega, omega))
    hat = so.hat(omega)
    return np.asarray(np.eye(3) - 0.5 * hat + c[:, None, None] * (hat @ hat))


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


def _smallest(A: FloatArray) -> FloatArray:
    """Smallest eigenvalues (m,) of symmetric matrices; nan where they are not finite."""
    finite = np.isfinite(A).all(axis=(1, 2), keepdims=True)
    values = np.linalg.eigvalsh(np.where(finite, A, 0.0))[:, 0]
    return np.where(np.ravel(finite), values, np.nan)


def _times(A: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray((A @ x[:, :, None])[:, :, 0])


def _dots(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ma,ma->m", x, y))


def _transposed(A: FloatArray) -> FloatArray:
    return np.swapaxes(A, 1, 2)


def _kept(x: FloatArray, sound: BoolArray) -> FloatArray:
    """Zeros where minorants are not sound."""
    return np.where(sound.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)
