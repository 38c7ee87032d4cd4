"""Minorants of truncated edge costs min(f, c): of a rejected measurement and its price.

Write F = [v Q] for the relative pose of an edge, v = R_i^T (t_j - t_i) and Q = R_i^T R_j, and M for
the measured one. Then f = tr((F - M) D (F - M)^T) with D = diag(tau, kappa I). For any centre C and
any weight W >= 0 let A : B = (A^-1 + B^-1)^-1 be the parallel sum, and

    c' = tr((C - M) (D : W) (C - M)^T).

The sum of two quadratic forms is never below their parallel sum, whatever F is, so that

    f >= c' - tr((F - C) W (F - C)^T),

and if c' is cut off at c, the right side is nowhere above c: it is a minorant of min(f, c). In the
matrix of all poses, it is an edge of negative weight.

Where a measurement is rejected at an estimate, f > c there, C is the estimate's own relative pose:
the edge has no residual and no gradient, and touches min(f, c) if c' = c. Where f < c, C lies
further out, F + (F - M) D W^-1: value and gradient are those of f, if c' <= c. That is
M + (c / f) (F - M) for W = f / (c - f) D.

The constants that are used do not rely on these formulas, and are slightly better: for all
rotations Q and all v, by the nuclear norm |X|_* = max <X, Q> over orthogonal Q.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, sums
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import relative

#: Weights over those of the measurement beyond which an edge has no minorant, as its cost is too
#: close to its price, and below which a cost under the price counts as zero.
STEEPEST, FLATTEST = 1e6, 1e-9
#: Share by which loads of kept measurements are above what has no centre.
APART = 1e-3
#: By which weights are raised, so that rounding does not lower the price that is reached.
RAISED = 1e-13
EPS = float(np.finfo(float).eps)
#: Where a price is split, from the least to the largest share of the rotation; None as the cost is.
SPLITS = (None, *np.linspace(0.0, 1.0, 13).tolist())
#: Bisections of the logarithm, for the weight that reaches a price.
BISECTIONS = 32


@dataclass(frozen=True, eq=False)
class Truncation:
    """Rejected measurements at the relative poses of an estimate.

    Matrices of weights are (k, d + 1, d + 1), translations first; of rotations alone, (k, d, d).

    Attributes
    ----------
    graph : k measurements
    prices : (k,) at which their costs are truncated, in units of F
    v : (k, d) R_i^T (t_j - t_i) of the estimate; zeros for rotations alone
    Q : (k, d, d) R_i^T R_j
    exact : whether F of the graph is the measurements' cost, and not only below it
    """

    graph: Graph
    prices: FloatArray
    v: FloatArray
    Q: FloatArray
    exact: bool = True

    @staticmethod
    def at_point(graph: Graph, prices: FloatArray, point: Point, exact: bool = True) -> Truncation:
        """Those of a graph (k edges) at the relative poses of a point."""
        if graph.has_positions:
            v, Q = relative(graph.edges, graph.arms, point)
        else:
            R, (i, j) = point.rotations, graph.edges.T
            v, Q = np.zeros((len(i), graph.d)), np.swapaxes(R[i], 1, 2) @ R[j]
        return Truncation(graph, prices, v, Q, exact)

    def subset(self, chosen: IntArray) -> Truncation:
        """Some of them."""
        parts = self.prices[chosen], self.v[chosen], self.Q[chosen]
        return Truncation(self.graph.with_edges(chosen), *parts, self.exact)

    @property
    def moved(self) -> int:
        """1 for poses, 0 for rotations alone."""
        return int(self.graph.has_positions)

    @property
    def translations(self) -> FloatArray:
        """(k, d) measured translations, zeros for rotations alone."""
        return self.graph.translations

    @cached_property
    def weights(self) -> FloatArray:
        """(k, b, b) matrices D."""
        D = np.zeros((len(self.prices), *[self.graph.d + self.moved] * 2))
        D[:, self.moved :, self.moved :] = self.graph.polar[1]
        if self.moved:
            D[:, 0, 0] = self.graph.tau
        return D

    @cached_property
    def residuals(self) -> FloatArray:
        """(k, d, b) F - M."""
        turned = self.Q - self.graph.polar[0]
        if not self.moved:
            return turned
        return np.concatenate([(self.v - self.translations)[:, :, None], turned], axis=2)

    @cached_property
    def costs(self) -> FloatArray:
        """(k,) terms of F."""
        return np.asarray(self._of_columns.sum(axis=1))

    @property
    def _of_columns(self) -> FloatArray:
        """(k, b) the shares of the columns of F - M in the costs."""
        return np.asarray((self.residuals * (self.residuals @ self.weights)).sum(axis=1))

    @property
    def is_far(self) -> BoolArray:
        """(k,) whether each costs more than its price."""
        return np.asarray(self.costs > self.prices)

    def plain(self) -> FloatArray:
        """(k, b, b) weights W = ratio D with which minorants touch, zero where there are none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.minimum(self.prices, self.costs) / np.abs(self.costs - self.prices)
        near = ~self.is_far & ((ratio < FLATTEST) | (not self.exact))
        ratio[~(ratio <= STEEPEST) | near] = 0.0
        return np.asarray((1.0 + RAISED) * ratio[:, None, None] * self.weights)

    def reaching(self, resistances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The weights that reach the prices at the least load, and these loads (k,).

        W = s G^-1 for resistances G (k, b, b) has the load s, see `certpgo.certify.resistances`,
        and no W of that load is larger. Infinite loads where the price is more than the cost.
        """
        values, squares, half = self._modes(resistances)
        low, high = np.full((2, len(squares)), [[1e-15], [1e15]])
        for _ in range(BISECTIONS):
            s = np.sqrt(low * high)
            reached = _reached(values, squares, s) >= self.prices
            low, high = np.where(reached, low, s), np.where(reached, s, high)
        return _inverse(values, half, high), np.where(self.is_far, high, np.inf)

    def splitting(self, resistances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `reaching`, with multiples of both blocks of D, as proof files have them.

        Of the price c, a share x is that of the rotation's term b, and the rest of the other one a:
        of kappa the multiple is x c / (b - x c). The best of some shares is chosen.
        """
        c, p, terms = self.prices, self.moved, self._of_columns
        a, b = terms[:, :p].sum(axis=1), terms[:, p:].sum(axis=1)
        low, high = np.maximum(1.0 - a / c, 0.0), np.minimum(b / c, 1.0)
        best, loads = np.zeros_like(self.weights), np.full(len(c), np.inf)
        for place in SPLITS:
            x = b / (a + b) if place is None else low + place * (high - low)
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.stack([(1.0 - x) * c / (a - (1.0 - x) * c), x * c / (b - x * c)])
                ratio = np.where(np.stack([x < 1.0, x > 0.0]), ratio, 0.0)
            known = self.is_far & ((ratio >= 0.0) & (ratio <= STEEPEST)).all(axis=0)
            ratio = np.where(known, (1.0 + RAISED) * ratio, 0.0)
            turned = np.repeat(ratio[1:].T, self.graph.d, axis=1)
            shares = np.concatenate([ratio[:p].T, turned], axis=1)
            root = self._root * np.sqrt(shares)[:, None, :]
            load = np.linalg.eigvalsh(np.swapaxes(root, 1, 2) @ resistances @ root)[:, -1]
            better = known & (load < loads)
            loads = np.where(better, load, loads)
            best[better] = (shares[:, :, None] * self.weights)[better]
        return best, loads

    def loaded(self, resistances: FloatArray, load: float) -> tuple[FloatArray, FloatArray]:
        """The largest weights of a load, and the values (k,) that their minorants have, uncut.

        For a load of 1 that is tr((F - M) (D^-1 + G)^-1 (F - M)^T): by how much F rises at least,
        where S leaves all room, if the measurement is taken back.
        """
        values, squares, half = self._modes(resistances)
        s = np.full(len(squares), load)
        return _inverse(values, half, s), _reached(values, squares, s)

    def _modes(self, resistances: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eigenvalues (k, b) and -vectors U of D^1/2 G D^1/2; |(F - M) D^1/2 U|^2, and D^1/2 U."""
        root = self._root
        values, U = np.linalg.eigh(np.swapaxes(root, 1, 2) @ resistances @ root)
        half = root @ U
        return values, ((self.residuals @ half) ** 2).sum(axis=1), half

    @cached_property
    def _root(self) -> FloatArray:
        """(k, b, b) D^1/2."""
        if not self.graph.has_couplings:
            return np.sqrt(self.weights)
        values, V = np.linalg.eigh(self.weights)
        return np.asarray((V * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(V, 1, 2))

    def dropping(self, resistances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `reaching`, of kept measurements, whose resistances are those of S with them.

        W = s G^-1 - D replaces D, so that s is the load, for the least s with c' <= c. Infinite
        loads where the cost is more than the price.
        """
        values, squares, half = self._modes(resistances)
        values = np.maximum(values, FLATTEST)
        least = (1.0 + APART) * values[:, -1]
        low, high = least, np.full(len(squares), 1e15)
        for _ in range(BISECTIONS):
            s = np.sqrt(low * high)
            needed = (squares * s[:, None] / (s[:, None] - values)).sum(axis=1)
            low, high = (
                np.where(needed > self.prices, s, low),
                np.where(needed > self.prices, high, s),
            )
        W = (half * (high[:, None] / values - 1.0)[:, None, :]) @ np.swapaxes(half, 1, 2)
        return W, np.where(self.is_far, np.inf, high)

    def centres(self, W: FloatArray) -> FloatArray:
        """(k, d, b) C for weights W (k, b, b)."""
        near = W.any(axis=(1, 2)) & ~self.is_far
        C = self.residuals.copy()
        C[near] += (self.residuals @ self.weights)[near] @ np.linalg.pinv(W[near])
        C[:, :, self.moved :] += self.graph.polar[0]
        if self.moved:
            C[:, :, 0] += self.translations
        return C

    def minorants(self, W: FloatArray) -> Minorants:
        """The minorants with these weights (k, b, b); zero where they are zero.

        Their constants are rounded down for exactly the other doubles.
        """
        used = np.asarray(W.any(axis=(1, 2)))
        if not used.any():
            return self.nothing
        if not used.all():
            return self.nothing.replaced(used, self.subset(np.flatnonzero(used)).minorants(W[used]))
        C = self.centres(W)
        tau, arms = np.zeros(len(W)), np.zeros_like(self.v)
        if self.moved:
            tau = W[:, 0, 0]
            arms = W[:, 1:, 0] / np.where(tau > 0.0, tau, 1.0)[:, None]
        K = W[:, self.moved :, self.moved :] - tau[:, None, None] * _outer(arms, arms)
        Z = C[:, :, self.moved :]
        b = C[:, :, 0] * self.moved + (Z @ arms[:, :, None])[:, :, 0]
        N, a = -Z @ K, arms + self.graph.own_arms
        return Minorants(-tau, a, b, N, self._constants(tau, a, b, N))

    @property
    def nothing(self) -> Minorants:
        """Minorants that are zero."""
        none = np.zeros(len(self.prices))
        return Minorants(none, 0.0 * self.v, 0.0 * self.v, 0.0 * self.Q, none)

    def _constants(
        self, tau: FloatArray, a: FloatArray, b: FloatArray, N: FloatArray
    ) -> FloatArray:
        """(k,) the largest C with -tau |t + Q a - b|^2 - 2 <N, Q> + C <= min(f, c), rounded down.

        It is at most c for C <= c - 2 |N|_*. Of v, the arm is a' = a less that of the measurement:
        against f, the best v is between its b and b - Q a'; what is left is linear in Q.
        """
        own, most = terms_of_rotations(self.graph)
        y, between = Ball.exact(self.translations) - b, Ball.exact(np.zeros(len(tau)))
        if self.graph.has_positions:
            both = (tau > 0.0) & (self.graph.tau > 0.0)
            one, other = (Ball.exact(np.where(both, w, 1.0)) for w in (tau, self.graph.tau))
            between = one * other / (one + other) * np.where(both, 1.0, 0.0)
        more = Ball.exact(a) - self.graph.own_arms
        coupling = Ball.exact(N) - own + between[:, None, None] * (y[:, :, None] * more[:, None, :])
        squares = sums(y.squared()) + sums(more.squared())
        of_cost = most + between * squares - 2.0 * nuclear(coupling)
        of_price = Ball.exact(self.prices) - 2.0 * nuclear(Ball.exact(N))
        return np.minimum(of_cost.lower, of_price.lower)


def _reached(values: FloatArray, squares: FloatArray, s: FloatArray) -> FloatArray:
    """(k,) sums of squares over 1 + values / s."""
    return np.asarray((squares * (s[:, None] / (s[:, None] + np.maximum(values, 0.0)))).sum(axis=1))


def _inverse(values: FloatArray, half: FloatArray, s: FloatArray) -> FloatArray:
    """(k, b, b) s G^-1, without what is not measured."""
    known = values > FLATTEST * values[:, -1:]
    inverse = np.where(known, s[:, None] / np.where(known, values, 1.0), 0.0)
    return np.asarray((half * inverse[:, None, :]) @ np.swapaxes(half, 1, 2))


def largest(minorants: Minorants) -> FloatArray:
    """(k,) upper bounds on minorants of negative weight: C + 2 |N|_*, rounded up."""
    return (2.0 * nuclear(Ball.exact(minorants.N)) + minorants.constant).upper


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, :, None] * b[:, None, :])


def nuclear(A: Ball) -> Ball:
    """Upper bounds, as points, on the nuclear norms of matrices (m, d, d) in balls.

    The sum of the singular values of A = U S V^T + E is at most |U| |V| tr(S) + d^(1/2) |E|_F.
    """
    m, d, _ = A.mid.shape
    U, S, Vt = np.linalg.svd(A.mid)
    rest = A - Ball.exact(U * S[:, None, :]) @ Vt
    error = sums(rest.reshaped(m, d * d).squared()).sqrt().size
    largest = _norms(U) * _norms(Vt) * S.sum(axis=1)
    return Ball.exact((1.0 + 16.0 * EPS) * (largest + 1.0001 * math.sqrt(d) * error))


def _norms(U: FloatArray) -> FloatArray:
    """(m,) upper bounds on the norms of almost orthogonal matrices: |U|^2 <= 1 + |U^T U - I|."""
    m, d, _ = U.shape
    defect = Ball.exact(np.swapaxes(U, 1, 2)) @ U - np.eye(d)
    return np.asarray(1.0 + sums(defect.reshaped(m, d * d).squared()).sqrt().size)


def untruncated(graph: Graph) -> Minorants:
    """Minorants of measurements under F, which differ from their costs by rounding.

    A rounded coupling costs its distance from that of `terms_of_rotations`.
    """
    m, d, N = graph.num_edges, graph.d, graph.coupled
    exact, most = terms_of_rotations(graph)
    off = Ball.exact(N) - exact
    distance = sums(off.reshaped(m, d * d).squared()).sqrt().size
    lost = 2.002 * math.sqrt(d) * Ball.exact(distance)
    constant = (most - lost).lower
    return Minorants(graph.tau, graph.own_arms, graph.translations, N, constant)


def terms_of_rotations(graph: Graph) -> tuple[Ball, Ball]:
    """N (m, d, d) and c (m,) of the terms c - 2 <N, Q> that F has of rotations Q.

    kappa |Q - R|^2 = 2 d kappa - 2 kappa <R, Q>, for the rotation R nearest to the stored matrix;
    of general edges c is twice the nuclear norm of N, see `certpgo.Graph`.
    """
    if graph.couplings is not None:
        N = Ball.exact(graph.couplings)
        return N, 2.0 * nuclear_norms(N, graph.polar[0])
    R, kappa = graph.rotations, graph.kappa
    exact = Ball.within(R, rotation_defect(R)) * kappa[:, None, None]
    return exact, 2.0 * graph.d * Ball.exact(kappa)


def nuclear_norms(N: Ball, P: FloatArray) -> Ball:
    """The nuclear norms of matrices (m, d, d) with these almost orthogonal polar factors."""
    m, d, _ = N.mid.shape
    above = nuclear(N).mid
    below = sums((N * Ball.exact(P)).reshaped(m, d * d)) / _norms(P)
    low = np.minimum(below.lower, above)
    return Ball.within(above, np.nextafter(above - low, np.inf))
