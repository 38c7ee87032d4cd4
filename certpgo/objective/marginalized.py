"""Quadratic costs with some of their translational weight set aside, the rest minimised over it.

For e = (y, x) with information Omega = (T, P; P^T, W), positive definite A = T - lam I and any y',

    e^T Omega e >= lam |y - y'|^2 + x^T S x + l.x + constant,    S = W - P^T A^-1 P,

where the terms in x are the minimum of the difference over y. It is attained at (y, x) if
lam (y - y') is half the slope of the cost in y there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.information import unmeasured
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball, eliminated, is_positive_definite

#: By which weights below a matrix are less than its eigenvalues, to be proven so.
LESS = 1e-3

#: Shares of the largest lam that leaves the rest of the information semidefinite.
SHARES = (0.99, 0.9, 0.7, 0.5, 0.3, 0.1)
#: The share without cross terms, where that information is isotropic; nothing is lost there.
WHOLE = 1.0 - 2.0**-30
#: Share of the information that `lowered` takes at least, for rounding.
SPARE = 1e-9


@dataclass(frozen=True, eq=False)
class SetAside:
    """What is set aside where a minorant is to touch, in floating point; NaN where nothing fits.

    Attributes
    ----------
    lam : (m,) the weights
    schur : (m, q, q) S
    slope : (m, q) of e^T Omega e in x
    b : (m, d) arms, with y' = R~^T (b - t~)
    """

    lam: FloatArray
    schur: FloatArray
    slope: FloatArray
    b: FloatArray


def set_aside(
    graph: Graph,
    e: FloatArray,
    curvature: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
) -> SetAside:
    """Of the shares tried, that with the largest lam^q times the curvatures on the rotations.

    Relaxations are loose where lam or a curvature is small: each curvature is weighed against lam.

    Parameters
    ----------
    e : (m, p) residuals at which to touch
    curvature : of S (k, q, q), residuals x (k, q) and slopes (k, q): what a minorant makes of them,
        at most zero if it is of little use, -inf if there is none
    """
    d, q = graph.d, graph.information_matrices.shape[1] - graph.d
    T, P, W = blocks(graph.information_matrices, d)
    x, slope = e[:, d:], 2.0 * (graph.information_matrices @ e[:, :, None])[:, :, 0]
    # For a smaller lam, S is positive definite.
    definite = graph.is_definite & ~unmeasured(graph.information_matrices).any(axis=1)
    scalar = is_isotropic(T) & ~P.any(axis=(1, 2))
    largest = np.where(scalar, T[:, 0, 0], 0.0)
    tried = np.flatnonzero(definite & ~scalar)
    largest[tried] = _largest(graph.information_matrices[tried], d)
    lam = np.where(scalar & definite, WHOLE * largest, np.nan)
    schur = np.where(scalar[:, None, None], W, np.nan)
    if len(tried):
        # All shares of an edge in turn, in one call.
        every, shares = np.repeat(tried, len(SHARES)), np.tile(SHARES, len(tried))
        weight = shares * largest[every]
        left = W[every] - _eliminated(T[every], P[every], weight)
        worth = curvature(left, x[every], slope[every, d:])
        worth = np.where(worth > 0.0, weight**q, 1.0) * worth
        worth = np.where(worth > -np.inf, worth, -np.inf).reshape(-1, len(SHARES))
        best = len(SHARES) * np.arange(len(tried)) + worth.argmax(axis=1)
        fits = worth.max(axis=1) > -np.inf
        lam[tried[fits]], schur[tried[fits]] = weight[best[fits]], left[best[fits]]
    target = e[:, :d] - slope[:, :d] / (2.0 * lam[:, None])
    b = graph.translations + (graph.rotations @ target[:, :, None])[:, :, 0]
    return SetAside(lam, schur, slope[:, d:], b)


def _largest(information: FloatArray, d: int) -> FloatArray:
    """(k,) the largest weights that leave definite matrices (k, p, p) semidefinite."""
    T, P, W = blocks(information, d)
    if d == 3:
        return np.asarray(1.0 / np.linalg.eigvalsh(np.linalg.inv(information)[:, :d, :d])[:, -1])
    a, b, c = _entries(T - P @ np.swapaxes(P, 1, 2) / W)
    return np.asarray((a * c - b * b) / (0.5 * (a + c) + np.hypot(0.5 * (a - c), b)))


def _eliminated(T: FloatArray, P: FloatArray, weight: FloatArray) -> FloatArray:
    """(k, q, q) P^T (T - weight I)^-1 P."""
    rest = T - weight[:, None, None] * np.eye(T.shape[1])
    if T.shape[1] == 3:
        return np.asarray(np.swapaxes(P, 1, 2) @ np.linalg.solve(rest, P))
    # Cramer's rule: LAPACK takes some ten times as long for matrices of two rows.
    a, b, c = _entries(rest)
    p, q = P[:, 0, 0], P[:, 1, 0]
    return np.asarray(((c * p * p - 2.0 * b * p * q + a * q * q) / (a * c - b * b))[:, None, None])


def _entries(A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(k,) entries 11, 12 and 22 of symmetric matrices (k, 2, 2)."""
    return A[:, 0, 0], A[:, 0, 1], A[:, 1, 1]


def remainder(
    graph: Graph, measured: Ball, lam: FloatArray, b: FloatArray
) -> tuple[Ball, Ball, Ball]:
    """S (m, q, q), l (m, q) and the constants (m,), whose radius is infinite if A is not definite.

    Parameters
    ----------
    measured : (m, d, d) the measured rotations
    lam, b : (m,) and (m, d), any
    """
    d, information = graph.d, graph.information_matrices
    p = information.shape[1]
    y = measured.T.apply(Ball.exact(b) - graph.translations)
    T, P, W = blocks(information, d)
    if not P.any() and is_isotropic(T).all():
        # The least of t |y|^2 - lam |y - y'|^2 is -t lam |y'|^2 / (t - lam).
        t, apart = T[:, 0, 0], Ball.exact(T[:, 0, 0]) - lam
        with np.errstate(all="ignore"):
            constant = -(Ball.exact(t) * lam / apart * y.dot(y))
        radius = np.where(apart.lower > 0.0, constant.radius, np.inf)
        none = Ball.exact(np.zeros(W.shape[:2]))
        return Ball.exact(W), none, Ball(constant.mid, radius)
    # Of (y, x, 1), the difference is a quadratic form; its first columns are eliminated.
    weights = Ball.exact(lam)
    pull = (weights[:, None] * y).padded(((0, 0), (0, p + 1 - d)))
    side = pull[:, :, None].padded(((0, 0), (0, 0), (p, 0)))
    corner = (weights * y.dot(y))[:, None, None].padded(((0, 0), (p, 0), (p, 0)))
    aside = weights[:, None, None] * np.diag(np.repeat((1.0, 0.0), (d, p + 1 - d)))
    form = Ball.exact(information).padded(((0, 0), (0, 1), (0, 1))) - aside + side + side.T
    left, definite = eliminated(form - corner, d)
    linear = 2.0 * left[:, :-1, -1]
    coupled = information[:, :d, d:].any(axis=1)
    linear = Ball(linear.mid, np.where(coupled, linear.radius, 0.0))
    constant = left[:, -1, -1]
    constant = Ball(constant.mid, np.where(definite, constant.radius, np.inf))
    return left[:, :-1, :-1], linear, constant


def lowered(
    graph: Graph,
    chosen: BoolArray,
    lower: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]],
) -> Graph | None:
    """The graph with less information on the chosen edges (m,), none of it in cross terms.

    None if none are chosen, or the difference is not proven to be positive definite.

    Parameters
    ----------
    lower : blocks T (k, d, d) and W (k, q, q) to blocks nowhere above them, up to rounding
    """
    d, full = graph.d, graph.information_matrices[chosen]
    if unmeasured(full).any():
        return None
    below = np.zeros_like(full)
    with np.errstate(all="ignore"):
        below[:, :d, :d], below[:, d:, d:] = lower(*_decoupled(full, d))
        below *= 1.0 - SPARE
        proven = is_positive_definite(Ball.exact(full) - below)
    if not (chosen.any() and proven.all()):
        return None
    information = graph.information_matrices.copy()
    information[chosen] = below
    return graph.with_information(information)


def _decoupled(information: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Blocks (1 - r) T and W - P^T T^-1 P / r of information that is nowhere above.

    What is taken away, (r T, P; P^T, P^T T^-1 P / r), is semidefinite. Both are definite for r from
    c^2 to 1, where c^2, the largest eigenvalue of W^-1 P^T T^-1 P, is the square of the largest
    canonical correlation; r = c is best if there is only one.
    """
    T, P, W = blocks(information, d)
    shared = np.swapaxes(P, 1, 2) @ np.linalg.solve(T, P)
    factor = np.linalg.inv(np.linalg.cholesky(W))
    correlations = np.linalg.eigvalsh(factor @ shared @ np.swapaxes(factor, 1, 2))
    r = np.sqrt(np.clip(correlations[:, -1], 2.0**-40, 1.0))[:, None, None]
    left = W - shared / r
    return (1.0 - r) * T, 0.5 * (left + np.swapaxes(left, 1, 2))


def is_isotropic(T: FloatArray) -> BoolArray:
    """(m,) which matrices (m, d, d) are multiples of the identity."""
    return np.asarray((T[:, :1, :1] * np.eye(T.shape[-1]) == T).all(axis=(1, 2)))


def isotropic(T: FloatArray) -> FloatArray:
    """The largest multiples of the identity that are nowhere above T (m, d, d), up to rounding."""
    d = T.shape[-1]
    least = np.where(is_isotropic(T), T[:, 0, 0], np.linalg.eigvalsh(T)[:, 0])
    return np.asarray(least[:, None, None] * np.eye(d))


def blocks(information: FloatArray, d: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Blocks T (m, d, d), P (m, d, q) and W (m, q, q) of information matrices."""
    return information[:, :d, :d], information[:, :d, d:], information[:, d:, d:]


def isotropic_below(graph: Graph, turned_share: float) -> Graph | None:
    """The same measurements with weights whose F is nowhere above a cost, edge by edge.

    lam_t and lam_R with Omega - blkdiag(lam_t I, lam_R I) proven to be positive definite, so that
    the cost is at least lam_t |y|^2 and lam_R times the squared rotational residual. Zero for what
    is not measured.

    Parameters
    ----------
    turned_share : of the cost, see `certpgo.objective.edge_cost.EdgeCost`

    Returns
    -------
    None where some are not known or not proven.
    """
    d, unstated = graph.d, unmeasured(graph.information_matrices)
    moving, turning = np.split(unstated, [d], axis=1)
    if not turned_share or any((rows.any(1) != rows.all(1)).any() for rows in (moving, turning)):
        return None
    # What is not measured is filled by a block of its own, which is taken off again.
    information = graph.information_matrices + unstated[:, :, None] * np.eye(unstated.shape[1])
    T, P, W = blocks(information, d)
    with np.errstate(all="ignore"):
        marginal = np.linalg.eigvalsh(np.linalg.inv(information)[:, :d, :d])[:, -1]
        moved = np.where(P.any(axis=(1, 2)), 0.5, 1.0 - LESS) / marginal
        inverse = np.linalg.inv(T - moved[:, None, None] * np.eye(d))
    left = W - np.swapaxes(P, 1, 2) @ inverse @ P
    turned = (1.0 - LESS) * np.linalg.eigvalsh(left)[:, 0]
    spared = np.concatenate([np.tile(moved, (d, 1)), np.tile(turned, (P.shape[2], 1))]).T
    rest = Ball.exact(information) - spared[:, :, None] * np.eye(spared.shape[1])
    if not (is_positive_definite(rest) & (turned > 0.0)).all():
        return None
    kappa = np.nextafter(turned_share * turned, 0.0) * ~turning.all(axis=1)
    tau = np.asarray(moved * ~moving.all(axis=1), dtype=np.float64)
    return graph.with_weights(kappa, tau)
