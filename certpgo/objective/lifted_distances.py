"""Poses, points and measured distances between them: f = F + sum w (d - |t_j - t_i|)^2.

By the tangents of `certpgo.objective.families.distances`, f is nowhere below the cost of a pose
graph with an edge of some weight, of either sign, for each distance, plus a constant. With those
of a stationary point this is exactly what the relaxation of Papalia et al. (CORA, T-RO 2024) has,
after its unit vectors are eliminated, without nodes for them. In the plane ours is tighter: see
`certpgo.objective.lifting`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, cast

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.display import Brief
from certpgo.graph.ranges import Ranges
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import Layout, diagonal_of, scatter_sum
from certpgo.linalg.factor import Factor, default_engine
from certpgo.linalg.rotations import orthonormal
from certpgo.objective import operators
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.families.distances import FAINT, SHORTEST, Distances
from certpgo.objective.lifting import COMPLEX, REAL
from certpgo.objective.manifold_model import ManifoldModel
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.quadratic_model import ROUNDING, largest_step
from certpgo.objective.scales import Scales
from certpgo.objective.signed_weights import with_rows_of

#: Distances of estimates below this share of the coordinates, which may be rounding, have no
#: direction.
INEXACT = 16.0 * U
#: Damping that fixes the gauge, and the least after a step that fails, relative to the diagonal.
GAUGE, DAMPING = 1e-9, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class LiftedDistances(Brief):
    """F over poses and points, plus the terms of distances, at points of any rank.

    Attributes
    ----------
    measured : the measurements, with distances; nodes may have distances alone
    engine : factorization engine, see `certpgo.linalg.factor.engines`
    roundings : of the measurements' numbers, see `certpgo.objective.quadratic.Quadratic`
    """

    measured: Graph
    engine: str = field(default_factory=default_engine)
    roundings: float = 0.0

    #: Whether translations are eliminated; whether there are descents at points of higher rank.
    eliminates: ClassVar[bool] = False
    climbs: ClassVar[bool] = True

    @property
    def n(self) -> int:
        """Number of nodes."""
        return self.measured.num_nodes

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.measured.d

    @property
    def ranges(self) -> Ranges:
        """The distances."""
        return cast("Ranges", self.measured.ranges)

    @property
    def poses(self) -> IntArray:
        """The nodes that are poses."""
        return self.measured.pose_nodes

    @cached_property
    def scale(self) -> float:
        """W: the scale of the cost."""
        return (Scale.of(self.measured) + self.distances.scale).total

    @property
    def root(self) -> int:
        """The node that a way down does not move."""
        return self.whole.root if self.whole.takes_scales else 0

    @property
    def graph(self) -> Graph:
        """The measurements, then an edge for each distance with its weight as tau."""
        return self.whole.graph

    @cached_property
    def form(self) -> Graph:
        """The measurements, as edges between `blocks` where scales are unknown."""
        one = self.measured
        return Scales(one, one.free, one.in_mean_unit).form if one.has_scales else one

    @property
    def chordal(self) -> Quadratic:
        """The same as `whole`, whose nodes these are."""
        return self.whole

    @cached_property
    def whole(self) -> Quadratic:
        """The problem in which each distance is an edge that measures zero, with its weight."""
        one = self.measured
        # Frames of other kinds may be reflected, which complex numbers are not.
        real = self.d == 3 or one.has_matrix_weights or one.has_others or one.has_scales
        lifting = REAL if real else COMPLEX
        whole = with_rows_of(one, [self.distances])
        return Quadratic(whole, self.engine, lifting, roundings=self.roundings)

    @cached_property
    def distances(self) -> Distances:
        """The term of the distances."""
        return Distances(self.ranges)

    def lengths(self, point: Point) -> FloatArray:
        """(k,) lengths of t_j - t_i."""
        i, j = self.ranges.edges.T
        t = translations_of(point)
        return np.asarray(np.linalg.norm(t[j] - t[i], axis=1))

    def _apart(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """(k, r) directions of t_j - t_i, and (k,) lengths, not below the least with a direction.

        Only derivatives and weights of tangents take these lengths; costs take `lengths`.
        """
        i, j = self.ranges.edges.T
        t = translations_of(point)
        size = np.linalg.norm(t, axis=1)
        least = np.maximum(SHORTEST * self.ranges.distances, INEXACT * (size[i] + size[j]))
        length = np.maximum(self.lengths(point), np.maximum(least, np.finfo(float).tiny))
        return (t[j] - t[i]) / length[:, None], length

    def cost(self, point: Point) -> float:
        """The cost of a point of any rank."""
        return float(self.edge_costs(point).sum())

    def edge_costs(self, point: Point) -> FloatArray:
        """Terms of f: of the measurements, then of the distances."""
        of_ranges = self.ranges.weights * (self.ranges.distances - self.lengths(point)) ** 2
        return np.concatenate([self._sums.terms(self.blocks(point)), of_ranges])

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.form)

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of f, (n, r, d + 1): translation column, then rotation."""
        G, _ = self._sums.gradient(self.blocks(point))
        i, j = self.ranges.edges.T
        direction, length = self._apart(point)
        pull = (self.ranges.weights * (length - self.ranges.distances))[:, None] * direction
        G[:, :, 0] += scatter_sum(j, pull, self.n) - scatter_sum(i, pull, self.n)
        return G

    def blocks(self, point: Point) -> Lift:
        """The point, of any rank, with blocks s_i R_i where scales are unknown."""
        if self.measured.has_scales:
            return cast("Lift", self.whole.blocks(point))
        return Lift(point.rotations, point.translations)

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) multipliers of the rotations at a point of any rank."""
        here = self.blocks(point)
        return self.whole.constrained(self.gradient(here)[:, :, -self.d :], here.rotations)

    @property
    def matrix(self) -> CSC:
        """(N, N) with the size of a certificate matrix in each row."""
        return self.whole.matrix

    def linearized(self, point: Point) -> LiftedModel | ManifoldModel:
        """The quadratic model of f at a point of any rank."""
        if self.measured.has_scales:
            return ManifoldModel(self, self.blocks(point))
        return LiftedModel(self, point)

    @cached_property
    def length(self) -> float:
        """Of the distances: their root mean square, or 1."""
        return math.sqrt(float(np.mean(self.ranges.distances**2))) or 1.0

    def hessian(self, point: Point, basis: FloatArray, multipliers: FloatArray | None) -> CSC:
        """The Riemannian Hessian of f/2, of `hessian_blocks`."""
        blocks = self.hessian_blocks(point, basis, multipliers)
        return self.whole.pattern.assemble(*blocks, basis.shape[2])

    def hessian_blocks(
        self, point: Point, basis: FloatArray, multipliers: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Riemannian Hessian of f/2; of the Gauss-Newton matrix without multipliers.

        Over translations, then the tangents of ``basis`` (n, q, r, d); see
        `operators.lifted_hessian`.
        """
        r, (i, j) = basis.shape[2], self.ranges.edges.T
        diagonal, upper = operators.lifted_hessian(self.form, basis, multipliers)
        direction, length = self._apart(point)
        share = self.ranges.distances / length
        B = direction[:, :, None] * direction[:, None, :]
        if multipliers is not None:
            B = (1.0 - share)[:, None, None] * np.eye(r) + share[:, None, None] * B
        B = self.ranges.weights[:, None, None] * B
        between = np.zeros((len(B), *upper.shape[1:]))
        between[:, :r, :r] = -B
        diagonal[:, :r, :r] += scatter_sum(i, B, self.n) + scatter_sum(j, B, self.n)
        return diagonal, np.concatenate([upper, between])

    def layout(self, rank: int) -> Layout:
        """Of such matrices at points of that rank."""
        return self.whole.pattern.layout(rank + self.whole.kinds.tangent_dim(rank, self.d), rank)

    def tangents(self, point: Point) -> Iterator[tuple[Quadratic, float]]:
        """Pose graphs whose edges are tangents at a point of any rank, and the constants.

        These are rounded down for exactly the weights of the problems. The second ones have faint
        weights more, where those of the first leave positions free, as of points that the minimum
        has on a line.
        """
        _, length = self._apart(point)
        for more in (0.0, FAINT):
            tau, constants = self.distances.tangent_weights(length, more)
            constant = math.nextafter(math.fsum(constants), -math.inf)
            weights = np.r_[self.measured.tau, tau]
            yield self.whole.of_same_edges(replace(self.graph, tau=weights)), constant


class LiftedModel:
    """The cost near a point, a `QuadraticModel` over translations and an orthonormal basis."""

    def __init__(self, problem: LiftedDistances, point: Point) -> None:
        self.problem, self.point = problem, Lift(point.rotations, point.translations)
        self.cost = problem.cost(point)
        self.rank = point.rotations.shape[1]
        self._layout = problem.layout(self.rank)

    @property
    def gauge(self) -> FloatArray:
        """(N,) a little everywhere: above rank d, no single node holds all motions of the whole."""
        return np.full(self._layout.size, GAUGE)

    @property
    def rounding(self) -> float:
        """A decrease of the cost that may be lost in rounding of the lengths."""
        # With signed weights the cost may be negative.
        size = abs(self.cost)
        return max(ROUNDING * size, 2.0 * U * math.sqrt(self.problem.scale * size))

    @cached_property
    def _euclidean(self) -> FloatArray:
        return self.problem.gradient(self.point)

    @cached_property
    def _basis(self) -> FloatArray:
        return self.problem.whole.kinds.apply("tangents", self.point.rotations)

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of f."""
        G = self._euclidean
        turn = np.einsum("nqrd,nrd->nq", self._basis, G[:, :, 1:])
        return self._layout.pack(np.concatenate([G[:, :, 0], turn], axis=1))

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of f/2."""
        return self.problem.hessian(self.point, self._basis, None)

    @cached_property
    def hessian(self) -> CSC:
        """The Riemannian Hessian of f/2."""
        lam = self.problem.whole.constrained(self._euclidean[:, :, 1:], self.point.rotations)
        return self.problem.hessian(self.point, self._basis, lam)

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the diagonal, positive, and one number for each position."""
        size, r = self._layout.unpack(np.abs(diagonal_of(H))), self.rank
        # Of positions and of turns by themselves, as their ratio depends on the unit of length.
        largest = np.repeat([size[:, :r].max(), size[:, r:].max()], [r, size.shape[1] - r])
        # Each position's mean: entries of single coordinates depend on how the world is turned.
        size[:, :r] = size[:, :r].mean(axis=1, keepdims=True)
        return self._layout.pack(np.maximum(size, 1e-12 * largest))

    def raised(self, damping: float) -> float:
        """The damping after a failed step: ten times as much, enough for most Hessians at once."""
        return max(10.0 * damping, DAMPING)

    def stationarity(self, scale: FloatArray) -> float:
        """The largest gradient over ``scale``, radians and shares of the distances."""
        unpack = self._layout.unpack
        return largest_step(unpack(self.gradient), unpack(scale), self.rank, self.problem.length)

    def factor(self, A: CSC) -> Factor | None:
        """The factor of a matrix with the same pattern."""
        return self.problem.whole.symbolic(A).factor(A)

    def moved(self, x: FloatArray) -> LiftedModel:
        """The model after a step x (N,)."""
        step, r = self._layout.unpack(x), self.rank
        V = np.einsum("nq,nqrd->nrd", step[:, r:], self._basis)
        t = translations_of(self.point) + step[:, :r]
        return LiftedModel(self.problem, Lift(orthonormal(self.point.rotations + V), t))
