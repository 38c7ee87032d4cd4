"""How GTSAM's cost in space is taken apart, and where it is touched.

`certpgo.objective.gtsam_space` has the mathematics.
None of this needs be accurate: constants are computed for the doubles that it gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.angle_functions import AngleFunctions, half_cotangent_slopes, half_cotangents
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
class SpatialTerms:
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
        return times(self.rest, self.x)

    @property
    def e(self) -> FloatArray:
        """(m, 3) psi0 e0."""
        return self.omega / self.at.sinc.nearest[:, None]

    @property
    def part(self) -> FloatArray:
        """(m,) of O - rho I that is touched."""
        X = np.einsum("ma,mab,mb->m", self.e, self.remains, self.e) - self.rho * dots(
            self.e, self.e
        )
        return np.asarray(np.minimum(1.0, ROOM * self.rho / np.maximum(X, 1e-300)))


def taken_apart(graph: Graph, y: FloatArray, omega: FloatArray) -> SpatialTerms:
    """The largest share of T' touched for which enough rotational information remains."""
    T, P, W = blocks(graph.information_matrices, 3)
    t, scalar, r, left = _split(T, P, W)
    rest = np.where(scalar[:, None, None], 0.0, T - t[:, None, None] * np.eye(3))
    at = AngleFunctions.of(np.linalg.norm(omega, axis=1))
    inverse = inverse_jacobians(omega)
    # Where T = t I nothing is touched.
    q = np.where(scalar[:, None], 0.0, times(inverse, y) + times(r, omega))
    m = len(t)
    share, mu, eta, rho = np.zeros(m), np.zeros(m), np.zeros(m), np.empty(m)
    remains, todo = np.empty((m, 3, 3)), np.arange(m)
    known = rest, q, P, y, omega, at.theta, inverse, t, left, smallest_eigenvalue(left)
    for tried in TOUCHED:
        mu_now, eta_now, remains_now, rho_now, fits = _paid(tried, *(x[todo] for x in known))
        done, share[todo[fits]] = todo[fits], tried
        mu[done], eta[done] = mu_now[fits], eta_now[fits]
        remains[done], rho[done] = remains_now[fits], rho_now[fits]
        todo = todo[~fits]
        if not len(todo):
            break
    x = share[:, None] * q
    p = times(transposed(P), x)
    return SpatialTerms(y, omega, at, t, scalar, rest, r, left, share, x, p, mu, eta, remains, rho)


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
    k = share * times(rest, q)
    size = np.linalg.norm(k, axis=1)
    slope = slopes(k, share * times(transposed(P), q), y, omega)
    swept = (SWEPT * (np.pi + theta) * size) ** 2
    balanced = np.clip(np.sqrt(swept * t / (BALANCE * smallest)), t / 1024, MOST * t)
    eta = np.where(size > 0.0, balanced, (1.0 - NEARLY) * t)
    needed = CURVED * size * np.linalg.norm(y, axis=1) + swept / eta
    needed += 0.5 * np.linalg.norm(times(inverse, slope), axis=1)
    mu = np.where(needed > 0.0, 1.0001 * needed / (1.0 - theta), 0.0)
    remains = left + bilinear(k, y) / 6.0 - mu[:, None, None] * np.eye(3)
    rho = smallest_eigenvalue(remains) - 1e-12 * np.abs(remains).sum(axis=(1, 2))
    fits = (rho >= KEPT * smallest) & ~((theta > TURNED) & (needed > 0.0))
    return mu, eta, remains, rho, fits | (share == 0.0)


def _split(
    T: FloatArray, P: FloatArray, W: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
    """Weights t (m,), whether T = t I and P = 0 (m,), T'^-1 P and W' (m, 3, 3).

    They are nan where the information is not definite. Of the shares tried, the one with the
    largest t^3 det W'.
    """
    m, t = len(T), T[:, 0, 0].copy()
    crossless = np.asarray(~P.any(axis=(1, 2)))
    scalar = is_isotropic(T) & crossless
    uneven = np.flatnonzero(crossless & ~scalar)
    t[uneven] = WHOLE * smallest_eigenvalue(T[uneven])
    t[~crossless] = np.nan
    # W' is positive definite exactly for t below the inverse of the largest translational variance.
    both, least = ~crossless, np.full(m, np.nan)
    both[both] = smallest_eigenvalue(W[both]) > 0.0
    least[both] = smallest_eigenvalue(
        T[both] - P[both] @ np.linalg.solve(W[both], transposed(P[both]))
    )
    r, left, best = np.zeros((m, 3, 3)), W.copy(), np.full(m, -np.inf)
    left[~crossless] = np.nan
    for share in SHARES:
        tried = np.flatnonzero(both & (least > 0.0))
        rest = T[tried] - (share * least[tried])[:, None, None] * np.eye(3)
        solved = np.linalg.solve(rest, P[tried])
        remaining = W[tried] - transposed(P[tried]) @ solved
        remaining = 0.5 * (remaining + transposed(remaining))
        values = np.linalg.eigvalsh(remaining)
        worth = np.where(values[:, 0] > 0.0, share**3 * values.prod(axis=1), -np.inf)
        better = worth > best[tried]
        place = tried[better]
        t[place], r[place] = share * least[place], solved[better]
        left[place], best[place] = remaining[better], worth[better]
    return t, scalar, r, left


def slopes(k: FloatArray, p: FloatArray, y: FloatArray, omega: FloatArray) -> FloatArray:
    """(m, 3) 2 p + k x y + zeta'(omega0)."""
    squares = dots(omega, omega)
    c, slope = half_cotangents(squares), half_cotangent_slopes(squares)
    turned = times(bilinear(k, y), omega)
    bent = (slope * dots(omega, turned))[:, None] * omega + (c - 1.0 / 12.0)[:, None] * turned
    return np.asarray(2.0 * p + np.cross(k, y) + 4.0 * bent)


def bilinear(k: FloatArray, y: FloatArray) -> FloatArray:
    """The matrices M (m, 3, 3)."""
    outer = k[:, :, None] * y[:, None, :]
    return np.asarray(0.5 * (outer + transposed(outer)) - dots(k, y)[:, None, None] * np.eye(3))


def inverse_jacobians(omega: FloatArray) -> FloatArray:
    """V^-1 (m, 3, 3)."""
    c = half_cotangents(dots(omega, omega))
    hat = so.hat(omega)
    return np.asarray(np.eye(3) - 0.5 * hat + c[:, None, None] * (hat @ hat))


def smallest_eigenvalue(A: FloatArray) -> FloatArray:
    """Smallest eigenvalues (m,) of symmetric matrices; nan where they are not finite."""
    finite = np.isfinite(A).all(axis=(1, 2), keepdims=True)
    values = np.linalg.eigvalsh(np.where(finite, A, 0.0))[:, 0]
    return np.where(np.ravel(finite), values, np.nan)


def times(A: FloatArray, x: FloatArray) -> FloatArray:
    """Products (m, 3) of matrices and vectors."""
    return np.asarray((A @ x[:, :, None])[:, :, 0])


def dots(x: FloatArray, y: FloatArray) -> FloatArray:
    """Inner products (m,) of vectors."""
    return np.asarray(np.einsum("ma,ma->m", x, y))


def transposed(A: FloatArray) -> FloatArray:
    """The transposes (m, 3, 3)."""
    return np.swapaxes(A, 1, 2)
