"""g2o's chi2: EdgeSE2 and EdgeSE3:QUAT with full information matrices.

The residual is y, then the angle of E in the plane, or the vector part b of its unit quaternion
(w, b), w >= 0, in space. Both minorants are the cost with lam |y - y'|^2 taken out, the remaining
quadratic form minimised over y (a Schur complement), and what is left bounded on the rotations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from certpgo.costs.edge_cost import EdgeCost, Minorants
from certpgo.graph.information import InformationGraph
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.balls import Ball, arctan2, crossed, joined, sums

#: Shares of the smallest eigenvalue of the translational information that lam may be.
SHARES = (0.99, 0.9, 0.7, 0.5, 0.3, 0.1)
#: The share where that information is isotropic, and cross terms zero; nothing is lost there.
WHOLE = 1.0 - 2.0**-30
#: Share of the sum of the two smaller eigenvalues of W to which a largest above another is clipped.
CLIPPED, NEARLY = 0.999, 0.9995
#: Angles below this touch like zero.
TINY = 2.0**-60
#: Attempts to round a slope up.
MAX_RAISES = 8


@dataclass(frozen=True, eq=False)
class G2oCost(EdgeCost):
    """g2o's chi2 of EdgeSE2 or EdgeSE3:QUAT.

    Examples
    --------
    One edge whose second pose is a centimetre and 0.1 radians from where it was measured:

    >>> import numpy as np
    >>> from certpgo import PoseGraph, RotationGraph
    >>> from certpgo.graph.information import InformationGraph
    >>> rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.ones(1))
    >>> graph = PoseGraph(rotation, np.zeros((1, 2)), np.ones(1))
    >>> cost = G2oCost(InformationGraph(graph, np.diag([100.0, 100.0, 4.0])[None]))
    >>> Q = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])[None]
    >>> print(cost.costs(np.array([[0.01, 0.0]]), Q).round(6))  # 100 0.01^2 + 4 0.1^2
    [0.05]
    """

    name: ClassVar[str] = "g2o"

    @property
    def title(self) -> str:
        """The cost in the words of g2o's users."""
        kind = "EdgeSE2" if self.graph.d == 2 else "EdgeSE3:QUAT"
        return f"g2o's chi2 of {kind} with full information"

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, p) residuals: y in metres, then an angle or the vector part of a quaternion."""
        y, E = self.unexplained(v, Q)
        turned = so.log(E) if self.graph.d == 2 else _quaternions(E)[:, 1:]
        return np.concatenate([y, turned], axis=1)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `EdgeCost.linearized`."""
        y, E = self.unexplained(v, Q)
        m, d = y.shape
        p, q = d * (d + 1) // 2, so.tangent_dim(d)
        in_v, in_w = np.zeros((m, p, d)), np.zeros((m, p, q))
        in_v[:, :d] = np.swapaxes(self.graph.rotations, 1, 2)
        if d == 2:
            turned, in_w[:, d:] = so.log(E), 1.0
        else:
            quaternion = _quaternions(E)
            turned = quaternion[:, 1:]
            in_w[:, d:] = 0.5 * (quaternion[:, :1, None] * np.eye(3) + so.hat(turned))
        return np.concatenate([y, turned], axis=1), in_v, in_w

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""
        measured, d = self.measured, self.graph.d
        y, E = measured.T.apply(v - self.graph.translations), measured.T @ Q
        T, P, W = blocks(self.graph.information, d)
        if d == 2:
            x = arctan2(E[:, 1, 0] - E[:, 0, 1], E[:, 0, 0] + E[:, 1, 1])[:, None]
            cross = 2.0 * y.dot(_times(P, x))
        else:
            x, sure = _vector_parts(E)
            cross = 2.0 * y.dot(_times(P, x))
            # With w near zero, the vector part may also be -x.
            cross = Ball(np.where(sure, cross.mid, 0.0), np.where(sure, cross.radius, cross.size))
        return y.dot(_times(T, y)) + cross + x.dot(_times(W, x))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding.

        None where the translational information is not positive definite, or, in the plane, where
        cross terms leave no rotational information.
        """
        # What is not finite is no minorant.
        with np.errstate(all="ignore"):
            return _planar(self, v, Q) if self.graph.d == 2 else _spatial(self, v, Q)

    def relaxed(self) -> G2oCost | None:
        """In space, with the largest eigenvalue of W below the sum of the others.

        Else K = (tr(W) I - 2 W) / 8 of an edge is indefinite, and the relaxation may be unbounded.
        """
        d = self.graph.d
        if d == 2:
            return None
        information = self.graph.information.copy()
        values, vectors = np.linalg.eigh(information[:, d:, d:])
        others, largest = values[:, 0] + values[:, 1], values[:, 2]
        steep = largest > NEARLY * others
        if not steep.any():
            return None
        v = vectors[steep, :, 2]
        taken = (largest - CLIPPED * others)[steep, None, None] * v[:, :, None] * v[:, None, :]
        # A little more than its rounding, so that what is taken is positive semidefinite.
        taken += 1e-13 * largest[steep, None, None] * np.eye(3)
        information[steep, d:, d:] -= 0.5 * (taken + np.swapaxes(taken, 1, 2))
        return replace(self, graph=InformationGraph(self.graph.isotropic, information))


def blocks(information: FloatArray, d: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Blocks T (m, d, d), P (m, d, q) and W (m, q, q) of information matrices."""
    return information[:, :d, :d], information[:, :d, d:], information[:, d:, d:]


def _times(A: FloatArray, x: Ball) -> Ball:
    return Ball.exact(A).apply(x)


def _chosen(T: FloatArray, P: FloatArray, W: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights lam (m,) and W - P^T (T - lam I)^-1 P, (m, q, q); nan where T is not definite.

    Of the shares tried, the one with the largest lam^d det of that matrix.
    """
    m, d, q = P.shape
    least = np.linalg.eigvalsh(T)[:, 0]
    chosen, schur, best = np.full(m, np.nan), np.full((m, q, q), np.nan), np.full(m, -np.inf)
    scalar = (T[:, :1, :1] * np.eye(d) == T).all(axis=(1, 2)) & ~P.any(axis=(1, 2))
    for share in (WHOLE, *SHARES):
        tried = np.flatnonzero((least > 0.0) & (scalar == (share == WHOLE)))
        lam = share * least[tried]
        rest = T[tried] - lam[:, None, None] * np.eye(d)
        left = W[tried] - np.swapaxes(P[tried], 1, 2) @ np.linalg.solve(rest, P[tried])
        values = np.linalg.eigvalsh(left)
        worth = np.where(values[:, 0] > 0.0, lam**d * np.abs(values.prod(axis=1)), values[:, 0])
        better = worth > best[tried]
        place = tried[better]
        chosen[place], schur[place], best[place] = lam[better], left[better], worth[better]
    return chosen, schur


def _expanded(
    cost: G2oCost, v: FloatArray, Q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Residuals (m, p) with gradients (m, p); lam and the Schur complement; the arms b (m, d)."""
    d = cost.graph.d
    information = cost.graph.information
    lam, schur = _chosen(*blocks(information, d))
    e = cost.residuals(v, Q)
    gradient = 2.0 * (information @ e[:, :, None])[:, :, 0]
    target = e[:, :d] - gradient[:, :d] / (2.0 * lam[:, None])
    b = cost.graph.translations + (cost.graph.rotations @ target[:, :, None])[:, :, 0]
    return e, gradient, lam, schur, b


def _schur_terms(cost: G2oCost, lam: FloatArray, b: FloatArray) -> tuple[Ball, Ball, Ball]:
    """What minimising over y leaves of e^T Omega e - lam |y - y'|^2, y' = R~^T (b - t~).

    The quadratic, linear and constant terms in the residual's rotational part: (m, q, q), (m, q)
    and (m,).
    """
    d = cost.graph.d
    T, P, W = (Ball.exact(block) for block in blocks(cost.graph.information, d))
    y = cost.measured.T.apply(Ball.exact(b) - cost.graph.translations)
    inverse = _inverse(T - lam[:, None, None] * np.eye(d))
    weights = Ball.exact(lam)
    quadratic = W - P.T @ inverse @ P
    carried = inverse.apply(y)
    linear = -2.0 * weights[:, None] * P.T.apply(carried)
    linear = Ball(linear.mid, np.where(P.mid.any(axis=1), linear.radius, 0.0))
    constant = -(weights * weights * y.dot(carried)) - weights * y.dot(y)
    return quadratic, linear, constant


def _inverse(A: Ball) -> Ball:
    """Inverses of symmetric positive definite matrices (m, d, d); infinite radii where not."""
    d = A.mid.shape[-1]
    a, b, c = A[:, 0, 0], A[:, 0, 1], A[:, 1, 1]
    if d == 2:
        determinant = a * c - b * b
        adjugate = _matrices([[c, -b], [-b, a]])
        definite = (a.lower > 0.0) & (determinant.lower > 0.0)
    else:
        p, q, r = A[:, 0, 2], A[:, 1, 2], A[:, 2, 2]
        xx, yy, zz = c * r - q * q, a * r - p * p, a * c - b * b
        xy, xz, yz = p * q - b * r, b * q - p * c, b * p - a * q
        determinant = a * xx + b * xy + p * xz
        adjugate = _matrices([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        definite = (a.lower > 0.0) & (zz.lower > 0.0) & (determinant.lower > 0.0)
    inverse = adjugate / determinant[:, None, None]
    radius = np.where(definite[:, None, None], inverse.radius, np.inf)
    return Ball(inverse.mid, radius)


def _matrices(rows: list[list[Ball]]) -> Ball:
    mid = np.stack([np.stack([x.mid for x in row], axis=-1) for row in rows], axis=-2)
    radius = np.stack([np.stack([x.radius for x in row], axis=-1) for row in rows], axis=-2)
    return Ball(mid, radius)


def _planar(cost: G2oCost, v: FloatArray, Q: FloatArray) -> Minorants:
    """EdgeSE2: an angle a leaves s (a + beta / s)^2 + gamma - beta^2 / s.

    theta^2 is convex in cos(theta), so s theta^2 + 4 k cos(theta) is smallest at theta = alpha for
    k = (s / 2) alpha / sin(alpha), and more turns only raise it. Couplings that are off by eps in
    the angle, and not k but kappa, cost at most 4 kappa |eps| + 4 |k - kappa|.
    """
    e, gradient, lam, schur, b = _expanded(cost, v, Q)
    s0 = schur[:, 0, 0]
    with np.errstate(all="ignore"):
        alpha = gradient[:, 2] / (2.0 * s0)
        fits = (s0 > 0.0) & (np.abs(alpha) < np.pi)
        alpha = np.where(fits, alpha, 0.0)
        kappa = np.where(fits, 0.5 * s0 / np.sinc(alpha / np.pi), 1.0)
    N = kappa[:, None, None] * (cost.graph.rotations @ so.exp((e[:, 2] - alpha)[:, None]))
    N[:, 0, 0], N[:, 0, 1] = N[:, 1, 1], -N[:, 1, 0]
    lam = np.where(fits, lam, 1.0)
    b = np.where(fits[:, None], b, 0.0)

    quadratic, linear, constant = _schur_terms(cost, lam, b)
    s, beta = quadratic[:, 0, 0], 0.5 * linear[:, 0]
    at = Ball.exact(alpha)
    sine = at.sin()
    quotient = at / sine
    tiny = np.abs(alpha) < 1e-5  # 1 <= alpha / sin(alpha) <= 1 + alpha^2 / 5
    mid = np.where(tiny, 1.0 + alpha**2 / 6.0, quotient.mid)
    k = 0.5 * s * Ball(mid, np.where(tiny, 0.3 * alpha**4 + 1e-15, quotient.radius))
    c, n = Ball.exact(N[:, 0, 0]), Ball.exact(N[:, 1, 0])
    weight = (c * c + n * n).sqrt()
    R = cost.graph.rotations
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
    # The series of the sine of a tiny angle has few correct digits.
    touching = np.where(np.abs(alpha) < TINY, 0.0, np.abs(alpha))[:, None]
    return Minorants(lam, np.zeros_like(b), b, N, np.where(fits, found, -np.inf), touching)


def _spatial(cost: G2oCost, v: FloatArray, Q: FloatArray) -> Minorants:
    """EdgeSE3:QUAT: a quadratic form in the unit quaternion q = (w, b), and l.b, w >= 0.

    Quadratic forms in q are linear in E. For q0 = (w0, b0), w0 >= 0 and |q0| <= 1,

        l.b >= (q.q0) l.b - k (1 - (q.q0)^2)    if k >= |k b0 + l|,

    as the difference is (1 - q.q0) (l.b + k + k q.q0) >= (1 - q.q0) (k - |l + k b0|).
    """
    _, _, lam, schur, b = _expanded(cost, v, Q)
    fits = np.isfinite(lam)
    lam, b = np.where(fits, lam, 1.0), np.where(fits[:, None], b, 0.0)
    schur = np.where(fits[:, None, None], schur, 0.0)
    quadratic, linear, constant = _schur_terms(cost, lam, b)
    q0 = _quaternions(np.swapaxes(cost.graph.rotations, 1, 2) @ Q) * (1.0 - 2.0**-48)
    k = _slope(q0, linear)
    fits &= np.isfinite(k)
    k = np.where(fits, k, 0.0)
    # The form to be matched, and the couplings N' of -2 <N', E> that match it.
    form = _form(Ball.exact(schur), Ball.exact(linear.mid), k, q0).mid
    beta, cross, D = form[:, 0, 0], form[:, 1:, 0], form[:, 1:, 1:]
    D = D - beta[:, None, None] * np.eye(3)
    trace = np.trace(D, axis1=1, axis2=2)[:, None, None]
    N = cost.graph.rotations @ (0.125 * trace * np.eye(3) - 0.25 * D - 0.25 * so.hat(cross))

    turned = cost.measured.T @ N
    total = _form(quadratic, linear, k, q0) + 2.0 * _davenport(turned)
    level = np.trace(total.mid, axis1=1, axis2=2) / 4.0
    rest = (total - level[:, None, None] * np.eye(4)).reshaped(-1, 16)
    spread = sums(rest * rest).sqrt()
    found = (constant - k + level - spread.size).lower
    found = np.where(fits & np.isfinite(found), found, -np.inf)
    touching = np.concatenate([q0, k[:, None]], axis=1)
    return Minorants(lam, np.zeros_like(b), b, N, found, touching)


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


def _quaternions(E: FloatArray) -> FloatArray:
    """(m, 4) unit quaternions (w, b) of rotations, w >= 0."""
    v = so.log(E)
    half = 0.5 * np.linalg.norm(v, axis=1)[:, None]
    w = np.maximum(np.cos(half), 0.0)  # not below zero where the angle is rounded up to pi
    return np.concatenate([w, 0.5 * np.sinc(half / np.pi) * v], axis=1)


def _vector_parts(E: Ball) -> tuple[Ball, FloatArray]:
    """Vector parts b (m, 3) of unit quaternions of E, w >= 0, and where their sign is sure.

    For unit quaternions of rotations E and E', one of |q - q'| and |q + q'| is at most
    |E - E'| / 2 in the Frobenius norm.
    """
    q = _quaternions(so.project(E.mid))
    exact = Ball.exact(q)
    w, b = exact[:, 0], exact[:, 1:]
    norm = sums(exact * exact)
    square = (w * w - sums(b * b))[:, None, None] * np.eye(3)
    there = square + 2.0 * (b[:, :, None] * b[:, None, :]) + 2.0 * w[:, None, None] * crossed(b)
    apart = (E * norm[:, None, None] - there).reshaped(-1, 9)
    distance = sums(apart * apart).sqrt().upper
    radius = 0.51 * distance + 2.0 * np.abs(norm.mid - 1.0) + 1e-15
    return Ball.within(q[:, 1:], radius[:, None]), np.asarray(q[:, 0] > radius)
