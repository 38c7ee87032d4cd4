"""Preintegrated steps of velocities and positions, see `certpgo.graph.preintegrated`.

A residual is linear in the positions x of four nodes and in two rotations:

    e = sum_k c_k x_k - R_i m - R_w h,      sum_k c_k = 0.

So its square is a quadratic form of the Gram matrix, a minorant of itself, and adds up from pairs
of nodes:

    |e|^2 = - sum_(k<l) c_k c_l |x_k - x_l|^2 - 2 sum_k c_k (x_k - p_i).R_i m
            - 2 sum_k c_k (x_k - t_w).R_w h + 2 (R_i m).(R_w h) + |m|^2 + |h|^2.

A pair that leaves node i is an edge of weight tau = -c_i c_k with b = -m / c_i; as c_i is not zero,
all products with R_i are in these. Those with R_w are pairs of edges of opposite weights, at b and
-b. Every number of an edge is a product of few stored ones, so that it is off by `ROUNDINGS` units
of its own size at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.observations import Observations
from certpgo.graph.preintegrated import (
    FROM_W,
    MAIN,
    PAIRS,
    POSITIONS,
    VA,
    VB,
    A,
    B,
    Preintegrated,
    W,
)
from certpgo.graph.relaxed_point import translations_of
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball, U, sums
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import Term

#: Units of rounding of the coefficients of pairs, over their sizes.
ROUNDINGS = 12.0
#: Share of a tilt's cost in weights: a node of gravity does not hold the frame.
A_LITTLE = 2.0**-16
#: The rows of a residual's pairs that leave pose i, and the one between i and w.
TO_VA, TO_B, TO_VB, TO_W = 0, 1, 2, len(PAIRS) - 1
#: The first rows of pairs that leave w, and those at the opposite b.
LEAVING = len(POSITIONS)
OPPOSITE = LEAVING + len(FROM_W)


@dataclass(frozen=True, eq=False)
class Preintegration(Term):
    """Squared errors of preintegrated steps.

    Rows are the pairs of nodes of each residual. The row between the poses has the residual, in the
    frame of pose i, and the cost; others have none.
    """

    block: Preintegrated
    takes: ClassVar[type[Observations]] = Preintegrated
    plural: ClassVar[str] = "preintegrated steps (as in F)"
    roundings: ClassVar[float] = ROUNDINGS

    @property
    def edges(self) -> IntArray:
        """(r, 2) the nodes of each row."""
        return self.block.edges

    @cached_property
    def coefficients(self) -> FloatArray:
        """(k, 2, 4) c of the residuals e_v and e_p at pose i, its velocity, pose j and its."""
        T, lag = self.block.units, self.block.lags
        held, ahead = lag / T, (self.block.seconds - lag) / T
        one = np.ones_like(T)
        of_v = np.stack([one, -one, -one, one], axis=1) / T[:, None]
        of_p = np.stack([ahead - 1.0, -ahead, 1.0 + held, -held], axis=1)
        return np.stack([of_v, of_p], axis=1)

    @cached_property
    def levers(self) -> tuple[FloatArray, FloatArray]:
        """(k, 2, 3) m in the frame of pose i, and h in that of w."""
        block, dt, lag = self.block, self.block.seconds[:, None], self.block.lags[:, None]
        m = np.stack([block.velocity_steps, block.position_steps], axis=1)
        return m, np.stack([dt * block.gravity, dt * (0.5 * dt - lag) * block.gravity], axis=1)

    def _rows(self, values: FloatArray, at: int = MAIN) -> FloatArray:
        """(r, ...) values (k, 2, ...) of the residuals at one of their rows, zeros elsewhere."""
        k, *shape = len(values), *values.shape[2:]
        rows = np.zeros((k, 2, len(PAIRS), *shape))
        rows[:, :, at] = values
        return rows.reshape(-1, *shape)

    @property
    def weights(self) -> FloatArray:
        """(r, 3, 3) weights of the residuals; zeros in rows without one."""
        return self._rows(self.block.weights[:, :, None, None] * np.eye(3))

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them: w dv^2 and w dp^2."""
        w, (m, _) = self.block.weights, self.levers
        move = np.sum([self._rows(w, at) for at in (TO_VA, TO_B, TO_VB)], axis=0)
        none = np.zeros(len(move))
        return Scale(none, move, self._rows((m * m).sum(axis=2)), none > 0.0)

    @property
    def turning(self) -> FloatArray:
        """(r,) a little of what a tilt of gravity costs, where node w's rotation is measured."""
        h = self.levers[1]
        return self._rows(A_LITTLE * self.block.weights * (h * h).sum(axis=2), TO_W)

    @property
    def sizes(self) -> FloatArray:
        """(r,) what is measured, m/s and metres."""
        m, h = self.levers
        return self._rows(np.linalg.norm(m, axis=2) + np.linalg.norm(h, axis=2))

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(r, 3) residuals, m/s and metres."""
        found = self._steps(v, Q)
        return self._rows(found - self.levers[0])

    def _steps(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, 2, 3) what m is measured of, in the frame of pose i."""
        v, Q = v.reshape(-1, 2, len(PAIRS), 3), Q.reshape(-1, 2, len(PAIRS), 3, 3)
        star = v[:, :, [TO_VA, TO_B, TO_VB]]
        moved = np.einsum("krc,krca->kra", self.coefficients[:, :, 1:], star)
        fallen = (Q[:, :, TO_W] @ self.levers[1][..., None])[..., 0]
        return np.asarray(moved - fallen)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals with zeros in place of derivatives, which are of more nodes than a row's."""
        none = np.zeros((len(v), 3, 3))
        return self.residuals(v, Q), none, none

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(r,) balls that contain the costs of all of these (v, Q)."""
        block, k = self.block, len(self.block.nodes)
        star = v.reshaped(k, 2, len(PAIRS), 3)[:, :, [TO_VA, TO_B, TO_VB]]
        T, lag, dt = (Ball.exact(of) for of in (block.units, block.lags, block.seconds))
        held, ahead, half = lag / T, (dt - lag) / T, dt * 0.5 - lag
        turned = Q.reshaped(k, 2, len(PAIRS), 3, 3)[:, :, TO_W]
        g = turned.apply(np.repeat(block.gravity[:, None], 2, axis=1))

        def of(r: int, at: int) -> Ball:
            return star[:, r, at]

        fallen = g * block.seconds[:, None, None]
        e_v = (of(0, 2) - of(0, 0) - of(0, 1)) / T.reshaped(k, 1)
        e_v = e_v - fallen[:, 0] - block.velocity_steps
        e_p = of(1, 1) * (held + 1.0).reshaped(k, 1) - of(1, 0) * ahead.reshaped(k, 1)
        e_p = e_p - of(1, 2) * held.reshaped(k, 1)
        e_p = e_p - fallen[:, 1] * half.reshaped(k, 1) - block.position_steps
        mid, radius = np.zeros((2, k, 2, len(PAIRS)))
        for r, e in enumerate((e_v, e_p)):
            cost = e.dot(e) * block.weights[:, r]
            mid[:, r, MAIN], radius[:, r, MAIN] = cost.mid, cost.radius
        return Ball(mid.ravel(), radius.ravel())

    @cached_property
    def _pairs(self) -> Minorants:
        """The cost as a sum over rows; the constants are in those of the residuals."""
        block, c, (m, h) = self.block, self.coefficients, self.levers
        w = block.weights[:, :, None]
        tau = np.zeros((*c.shape[:2], len(PAIRS)))
        b = np.zeros((*tau.shape, 3))
        for row, (k, other) in enumerate(POSITIONS):
            tau[:, :, row] = -w[:, :, 0] * c[:, :, k] * c[:, :, other]
            if k == A:
                b[:, :, row] = -m / c[:, :, :1]
        for at, (_, k) in enumerate(FROM_W):
            # -2 w c_k x.R_w h = s |x - R_w b|^2 - s |x + R_w b|^2, at s = w |c_k|, b = +- h / 2.
            s = w[:, :, 0] * np.abs(c[:, :, k])
            tau[:, :, LEAVING + at], tau[:, :, OPPOSITE + at] = s, -s
            half = 0.5 * np.sign(c[:, :, k])[:, :, None] * h
            b[:, :, LEAVING + at], b[:, :, OPPOSITE + at] = half, -half
        N = np.zeros((*tau.shape, 3, 3))
        N[:, :, TO_W] = -w[..., None] * m[..., :, None] * h[..., None, :]
        return Minorants(
            tau.ravel(),
            np.zeros((tau.size, 3)),
            b.reshape(-1, 3),
            N.reshape(-1, 3, 3),
            self._constants(c, m),
        )

    def _constants(self, c: FloatArray, m: FloatArray) -> FloatArray:
        """(r,) w (|m|^2 + |h|^2) less what rows have of their own, rounded down.

        That is sum_(k != i) tau_ik |b|^2 = w c_i^2 |m|^2 / c_i^2 = w |m|^2: only |h|^2 is left.
        """
        block, k = self.block, len(c)
        dt, lag = (Ball.exact(of) for of in (block.seconds, block.lags))
        g = sums(Ball.exact(block.gravity).squared())
        fallen = dt.squared() * g
        both = (
            fallen * block.weights[:, 0],
            fallen * (dt * 0.5 - lag).squared() * block.weights[:, 1],
        )
        found = np.zeros((k, 2))
        for r, ball in enumerate(both):
            found[:, r] = ball.lower
        # Stored tau and b are off by few units of rounding each.
        w, size = block.weights, (m * m).sum(axis=2)
        off = 64.0 * U * w * size * (1.0 + np.abs(c).sum(axis=2) / np.abs(c[:, :, A]))
        return self._rows(np.nextafter(found - off, -np.inf))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """The cost itself, whatever (v, Q) are."""
        return self._pairs

    def bend(self, v: FloatArray) -> FloatArray:
        """(r,) the quadratic parts of the rows in moves v (r, 3)."""
        return np.asarray(self._pairs.tau * (v * v).sum(axis=1))

    def idle_turns(self, measured: Graph) -> tuple[IntArray, IntArray]:
        """Gravity's node and the axis next to it, unless something else is measured from there."""
        w, first = np.unique(self.block.nodes[:, W], return_index=True)
        known = measured.edges[measured.is_measured] if measured.num_edges else measured.edges
        alone = ~np.isin(w, known)
        return w[alone], np.argmax(np.abs(self.block.gravity[first[alone]]), axis=1)

    def equations(self, n: int) -> Equations:
        """The derivatives, which are of all nodes of a measurement at once."""
        return Equations(self, n)


class Equations:
    """Derivatives of preintegrated steps at an estimate, see `certpgo.objective.edge_equations`."""

    has_more = False

    def __init__(self, term: Preintegration, n: int) -> None:
        self._term, self._n, self._nodes = term, n, term.block.nodes

    def _residuals(self, point: Estimate) -> tuple[FloatArray, FloatArray]:
        """(k, 2, 3) residuals in the world's frame, and their derivatives (k, 5, 2, 3, 6)."""
        nodes, c, (m, h) = self._nodes, self._term.coefficients, self._term.levers
        t, R_i, R_w = (
            translations_of(point),
            point.rotations[nodes[:, A]],
            point.rotations[nodes[:, W]],
        )
        from_i = t[nodes[:, [VA, B, VB]]] - t[nodes[:, A]][:, None]
        e = np.einsum("krc,kca->kra", c[:, :, 1:], from_i)
        e = e - m @ np.swapaxes(R_i, 1, 2) - h @ np.swapaxes(R_w, 1, 2)
        slopes = np.zeros((len(nodes), 5, 2, 3, 6))
        for at in (A, VA, B, VB):
            slopes[:, at, :, :, :3] = c[:, :, at, None, None] * np.eye(3)
        slopes[:, A, :, :, 3:] = R_i[:, None] @ so.hat(m)
        slopes[:, W, :, :, 3:] = R_w[:, None] @ so.hat(h)
        return np.asarray(e), slopes

    def first(self, point: Estimate) -> tuple[float, FloatArray]:
        """The cost and half its gradient (n, 6)."""
        e, slopes = self._residuals(point)
        forces = self._term.block.weights[:, :, None] * e
        gradient = np.einsum("knrap,kra->knp", slopes, forces)
        return float((forces * e).sum()), scatter_sum(
            self._nodes.ravel(), gradient.reshape(-1, 6), self._n
        )

    def second(self, point: Estimate, exact: bool) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Gauss-Newton matrix of half the cost, of nodes and of rows."""
        _, slopes = self._residuals(point)
        heavy = self._term.block.weights[:, None, :, None, None] * slopes
        own = np.einsum("knrap,knraq->knpq", slopes, heavy)
        diagonal = scatter_sum(self._nodes.ravel(), own.reshape(-1, 6, 6), self._n)
        upper = np.zeros((len(slopes), 2, len(PAIRS), 6, 6))
        for row in (*range(LEAVING), *range(LEAVING, OPPOSITE)):
            first, second = PAIRS[row]
            upper[:, :, row] = np.einsum("krap,kraq->krpq", slopes[:, first], heavy[:, second])
        return diagonal, upper.reshape(-1, 6, 6)
