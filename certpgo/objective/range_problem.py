"""Poses, points and measured distances between them: f = F + sum w (d - |t_j - t_i|)^2.

By the tangents of `certpgo.objective.families.distances`, f is nowhere below the cost of a pose
graph with an edge of some weight, of either sign, for each distance, plus a constant. With those
of a stationary point this is exactly what the relaxation of Papalia et al. (CORA, T-RO 2024) has,
after its unit vectors are eliminated, without nodes for them. In the plane ours is tighter: see
`certpgo.objective.signed_weights.OrientedProblem`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, cast

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.edges import components_of
from certpgo.graph.priors import require_held
from certpgo.graph.ranges import Ranges
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import Layout, scatter_sum
from certpgo.linalg.factor import Factor, Symbolic, default_engine
from certpgo.linalg.rotations import orthonormal
from certpgo.objective import operators
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.families.distances import FAINT, SHORTEST, Distances
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.problem import PoseProblem
from certpgo.objective.quadratic_model import ROUNDING, largest_step
from certpgo.objective.signed_weights import OrientedProblem, SignedGraph, SignedProblem

#: Distances of estimates below this share of the coordinates, which may be rounding, have no
#: direction.
INEXACT = 16.0 * U
#: Damping that fixes the gauge, and the least after a step that fails, relative to the diagonal.
GAUGE, DAMPING = 1e-9, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class RangeProblem(Objective):
    """Minimise F over poses and points, plus the terms of measured distances.

    Attributes
    ----------
    measured : the measurements, with distances; nodes may have distances alone
    engine : factorization engine, see `certpgo.linalg.factor.engines`

    Raises
    ------
    GraphError
        There are no distances, or these and the other measurements do not connect the graph, or
        leave a rotation free.
    """

    measured: PoseGraph
    engine: str = field(default_factory=default_engine)

    def __post_init__(self) -> None:
        if not len(self.poses) or self.measured.ranges is None or not self.ranges.num_edges:
            lack = "distances" if len(self.poses) else "poses"
            raise GraphError(f"there are no {lack} in the graph")
        moved = self.measured.edges[self.measured.tau != 0.0]
        joined = components_of(self.n, np.concatenate([moved, self.ranges.edges]))
        if joined.any():
            node = int(np.argmax(joined > 0))
            raise GraphError(f"no measurement or distance joins node {node} to the others")
        require_held(self.measured)

    @property
    def ranges(self) -> Ranges:
        """The distances."""
        return cast("Ranges", self.measured.ranges)

    @property
    def poses(self) -> IntArray:
        """The nodes that are poses."""
        return self.measured.pose_nodes

    @property
    def title(self) -> str:
        """What the cost is."""
        return "F and squared errors of distances"

    @property
    def graph(self) -> PoseGraph:
        """The measurements, then an edge for each distance with its weight as tau."""
        return self.whole.graph

    @cached_property
    def alone(self) -> PoseProblem:
        """The problem of the measurements without the distances."""
        return SignedProblem(self.measured.with_ranges(None), self.engine)

    @cached_property
    def whole(self) -> SignedProblem:
        """The problem in which each distance is an edge that measures zero, with its weight."""
        one = self.measured
        is_general = one.arms is not None or one.rotation.is_general
        kind = OrientedProblem if self.d == 2 and not is_general else SignedProblem
        return kind(SignedGraph.with_rows_of(one, [self.distances]), self.engine)

    @cached_property
    def distances(self) -> Distances:
        """The term of the distances."""
        return Distances(self.ranges)

    def scaled(self, factor: float) -> RangeProblem:
        """The same measurements with all weights times ``factor``."""
        return RangeProblem(self.measured.scaled(factor), self.engine)

    @cached_property
    def scale(self) -> float:
        """W: sums of kappa, of tau |t_ij|^2 and of w d^2, the scale of the cost."""
        distances = self.ranges.weights @ self.ranges.distances**2
        return self.alone.scale + float(distances)

    is_lifted = climbs = True
    most_steps = 250

    @property
    def chordal(self) -> PoseProblem:
        """The problem of the measurements and of edges as long as the distances."""
        return self.whole

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost."""
        return "the proof tier is not for graphs with measured distances"

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on f of an estimate, whose translations are taken as stored."""
        distances, length = self.ranges.distances, self.lengths(estimate)
        # The difference, d squares, their sum and the root, each relative to the length.
        error = 16.0 * U * (length + distances) + 2.0**-500
        size, weights = np.abs(length - distances), self.ranges.weights
        low, high = self.alone.enclosure(estimate)
        low += float(np.sum(weights * np.maximum(size - error, 0.0) ** 2))
        high += float(np.sum(weights * (size + error) ** 2))
        # A few roundings within each term, and at most one per term in the sum, in any order.
        of_sum = (len(distances) + 16) * 2.0 * U
        return low * (1.0 - of_sum), math.nextafter(high * (1.0 + of_sum), math.inf)

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

    def edge_costs(self, point: Point) -> FloatArray:
        """Terms of f: of the measurements, then of the distances."""
        of_ranges = self.ranges.weights * (self.ranges.distances - self.lengths(point)) ** 2
        return np.concatenate([self._sums.terms(point), of_ranges])

    def residual_lengths(self, estimate: Estimate) -> FloatArray:
        """Norms of t_j - t_i - R_i t_ij, then errors of the distances, metres."""
        moved = self.alone.residual_lengths(estimate)
        return np.concatenate([moved, np.abs(self.ranges.distances - self.lengths(estimate))])

    def stationarity(self, estimate: Estimate) -> float:
        """Largest gradient of a rotation over its weight, radians."""
        turn = operators.tangent_gradient(self.gradient(estimate)[:, :, 1:], estimate.rotations)
        size = np.linalg.norm(turn, axis=1)[self.poses]
        return float((size / self.alone.curvature[self.poses]).max())

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.measured)

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of f, (n, r, d + 1): translation column, then rotation."""
        G, _ = self._sums.gradient(point)
        i, j = self.ranges.edges.T
        direction, length = self._apart(point)
        pull = (self.ranges.weights * (length - self.ranges.distances))[:, None] * direction
        G[:, :, 0] += scatter_sum(j, pull, self.n) - scatter_sum(i, pull, self.n)
        return G

    def blocks(self, point: Point) -> Lift:
        """The point, of any rank."""
        return Lift(point.rotations, point.translations)

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) multipliers of the rotations at a point of any rank."""
        return self.whole.constrained(self.gradient(point)[:, :, -self.d :], point.rotations)

    #: The node that a way down does not move.
    root: ClassVar[int] = 0

    @property
    def row_weights(self) -> FloatArray:
        """(N,) the size of each row of a certificate matrix."""
        return np.asarray(np.abs(self.whole.matrix.diagonal()))

    def sizes_of(self, Y: FloatArray) -> FloatArray:
        """(n,) scales of blocks (n, r, d): ones."""
        return np.ones(len(Y))

    def retracted(self, moved: FloatArray, Y: FloatArray) -> FloatArray:
        """The nearest admissible blocks (n, r, d) to those that were moved from Y."""
        return orthonormal(moved)

    def linearized(self, point: Point) -> RangeModel:
        """The quadratic model of f at a point of any rank."""
        return RangeModel(self, point)

    @cached_property
    def length(self) -> float:
        """Of the distances: their root mean square, or 1."""
        return math.sqrt(float(np.mean(self.ranges.distances**2))) or 1.0

    def hessian(self, point: Point, basis: FloatArray, multipliers: FloatArray | None) -> CSC:
        """The Riemannian Hessian of f/2; the Gauss-Newton matrix without multipliers.

        Over translations, then the tangents of ``basis`` (n, q, r, d); see
        `operators.lifted_hessian`.
        """
        return self._hessian(self.measured, point, basis, multipliers)

    def _hessian(
        self, measured: PoseGraph, point: Point, basis: FloatArray, multipliers: FloatArray | None
    ) -> CSC:
        r, (i, j) = basis.shape[2], self.ranges.edges.T
        lam = np.zeros((self.n, self.d, self.d)) if multipliers is None else multipliers
        diagonal, upper = operators.lifted_hessian(measured, basis, lam)
        direction, length = self._apart(point)
        share = self.ranges.distances / length
        B = direction[:, :, None] * direction[:, None, :]
        if multipliers is not None:
            B = (1.0 - share)[:, None, None] * np.eye(r) + share[:, None, None] * B
        B = self.ranges.weights[:, None, None] * B
        between = np.zeros((len(B), *upper.shape[1:]))
        between[:, :r, :r] = -B
        diagonal[:, :r, :r] += scatter_sum(i, B, self.n) + scatter_sum(j, B, self.n)
        return self.whole.pattern.assemble(diagonal, np.concatenate([upper, between]), r)

    def layout(self, rank: int) -> Layout:
        """Of such matrices at points of that rank."""
        return self.whole.pattern.layout(rank + self.whole.tangent_dim(rank), rank)

    @property
    def tangent_layout(self) -> Layout:
        """Of the Gauss-Newton matrix."""
        return self.whole.tangent_layout

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """The Gauss-Newton matrix of f/2, over world translations and body rotations."""
        generators = so.hat(np.eye(so.tangent_dim(self.d)))
        basis = estimate.rotations[:, None] @ generators
        measured = cast("PoseGraph", operators.explained(self.measured, estimate))
        return self._hessian(measured, estimate, basis, None)

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a matrix of the whole pattern."""
        return self.whole.symbolic(A)

    def surrogate(self, point: Point) -> Surrogate:
        """The cost itself, which has a value at points of any rank."""
        return Surrogate(self)

    def tangents(self, point: Point) -> Iterator[tuple[SignedProblem, float]]:
        """Pose graphs whose edges are tangents at a point of any rank, and the constants.

        These are rounded down for exactly the weights of the problems. The second ones have faint
        weights more, where those of the first leave positions free, as of points that the minimum
        has on a line.
        """
        _, length = self._apart(point)
        for more in (0.0, FAINT):
            tau, constants = self.distances.tangents(length, more)
            constant = math.nextafter(math.fsum(constants), -math.inf)
            weights = np.r_[self.measured.tau, tau]
            yield self.whole.of_same_edges(replace(self.graph, tau=weights)), constant


class RangeModel:
    """The cost near a point, a `QuadraticModel` over translations and an orthonormal basis."""

    def __init__(self, problem: RangeProblem, point: Point) -> None:
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
        return self.problem.whole.tangent_basis(self.point.rotations)

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
        size, r = self._layout.unpack(np.abs(H.diagonal())), self.rank
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
        return self.problem.symbolic(A).factor(A)

    def moved(self, x: FloatArray) -> RangeModel:
        """The model after a step x (N,)."""
        step, r = self._layout.unpack(x), self.rank
        V = np.einsum("nq,nqrd->nrd", step[:, r:], self._basis)
        t = translations_of(self.point) + step[:, :r]
        return RangeModel(self.problem, Lift(orthonormal(self.point.rotations + V), t))
