"""Poses of unknown scale: F over similarities A_i = s_i R_i, t_i.

F is a quadratic form of A and t, the same matrix M as that of poses but for measured scales. A pose
of known scale has A^T A = I; one of unknown scale has A^T A = s^2 I for any s. For S = M less the
blocks Lam of symmetric multipliers,

    F = tr(X S X^T) + sum of tr(Lam_i) of known scales + sum of s_i^2 tr(Lam_i) of unknown ones.

Where some scales are known, the unknown ones have traces of zero. Where none is, the cost is F over
the mean of s_i^2, and all traces are equal. docs/concepts/similarities.md has the proofs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.graph.relaxed_point import Lift, Point, main_subspace, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import Layout, pinned
from certpgo.objective import operators
from certpgo.objective.base import AnyPoint, FirstOrder
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.problem import PoseProblem
from certpgo.objective.similarity_model import SimilarityModel
from certpgo.objective.similarity_rounding import enclosure, entry_errors

#: What the cost is called.
SIMILAR = "F over similarities"
#: Shares of the multipliers that are given up for a bound.
SHARES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)
IN_KNOWN, IN_MEAN = "the poses of known scale", "the root mean square scale"


@dataclass(frozen=True, eq=False, repr=False)
class SimilarityProblem(PoseProblem):
    """Minimise F over similarities and points; see `certpgo.SimilarityGraph`.

    A point of its relaxation is a `Lift` whose blocks Y_i have Y_i^T Y_i = s_i^2 I. An estimate has
    scales; without any, they are ones.

    Raises
    ------
    GraphError
        The graph is disconnected, or a node is left free.
    InputError
        Nodes have no positions.
    """

    graph: Graph

    def __post_init__(self) -> None:
        super().__post_init__()

    @property
    def title(self) -> str:
        """What the cost is."""
        return f"{SIMILAR}, in the unit of {IN_MEAN if self.in_mean_unit else IN_KNOWN}"

    takes_scales = climbs = True
    most_steps, polished = 300, 1e-11

    @property
    def eliminates(self) -> bool:
        """Not at once with scales."""
        return False

    def settled(self, estimate: Estimate) -> Estimate:
        """The estimate with its best translations."""
        if estimate.scales is None:
            estimate = self.complete(estimate.rotations)
        return self.with_optimal_translations(estimate)

    def nearest_estimates(self, point: Point) -> Iterator[Estimate]:
        """The projections to the main subspace of a point, of either handedness."""
        basis = main_subspace(cast("Lift", point).subset(self.poses))
        Y = point.rotations
        scales = np.where(self.graph.free, np.linalg.norm(Y, axis=(1, 2)) / math.sqrt(self.d), 1.0)
        for hand in (1.0, -1.0):
            B = basis * np.r_[hand, np.ones(self.d - 1)]
            t = translations_of(point) @ B
            yield self.with_optimal_translations(Estimate(so.project(B.T @ Y), t, scales=scales))

    def shares(self, rank: int) -> tuple[float, ...]:
        """Shares of the multipliers to give up where rounding has no other compensation.

        That is at points of higher rank, whose kernel need not meet the poses of known scale.
        """
        return SHARES if rank > self.d and not self.in_mean_unit else (0.0,)

    @cached_property
    def form(self) -> Graph:
        """The measurements as edges whose residuals are A_j - A_i s_ij R_ij."""
        graph = self.graph
        P = graph.scales[:, None, None] * graph.rotations
        kappa, one = graph.kappa[:, None, None], np.eye(self.d)
        N = kappa * P
        general = RotationGraph(self.n, graph.edges, graph.rotations, graph.kappa, N)
        K = kappa * one
        general.__dict__["polar"] = P, K, graph.scales[:, None, None] ** 2 * K
        flags = graph.is_point, graph.assumed, graph.absolute
        return PoseGraph(general, graph.translations, graph.tau, None, *flags)

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.form)

    @cached_property
    def data_matrix(self) -> CSC:
        """M with F = tr(X M X^T), interleaved."""
        return operators.data_matrix(self.pattern, self.form, self._sums.node_sums)

    # --- Points -----------------------------------------------------------------------------------

    @property
    def in_mean_unit(self) -> bool:
        """Whether the unit is the root mean square of the scales, as none is known."""
        return self.graph.in_mean_unit

    @cached_property
    def held(self) -> IntArray:
        """The poses whose scales are known, or whose mean square scale is."""
        if self.in_mean_unit:
            return self.graph.pose_nodes
        return np.flatnonzero(~self.graph.free & ~self.graph.is_point)

    @cached_property
    def held_rows(self) -> BoolArray:
        """(N,) which rows of the matrix belong to poses of known scale, and to no translation."""
        layout = self.pattern.layout_of(self.matrix)
        rows = np.zeros((self.n, self.d + 1), dtype=bool)
        rows[self.held, 1:] = True
        return np.asarray(layout.pack(rows))

    def loose_rows(self, point: Point, pin: int) -> FloatArray:
        """(k, r) rows of X^T whose lengths no constraint fixes, the pinned pose at the origin."""
        point = self.blocks(point)
        t = translations_of(point)
        rows = np.concatenate([(t - t[pin])[:, None], np.swapaxes(point.rotations, 1, 2)], axis=1)
        return np.asarray(self.pattern.layout_of(self.matrix).pack(rows)[~self.held_rows])

    def blocks(self, point: Point) -> Lift:
        """The point with A_i = s_i R_i in place of rotations."""
        A, t, unit = self._scaled(point), point.translations, self._unit_of(point)
        return Lift(A / unit, None if t is None else t / unit)

    def _scaled(self, point: Point) -> FloatArray:
        """The blocks s_i R_i."""
        if isinstance(point, Estimate) and point.scales is not None:
            return np.asarray(self.scales_of(point)[:, None, None] * point.rotations)
        return point.rotations

    def _unit_of(self, point: Point) -> float:
        """The root mean square scale, or 1 where some scales are known."""
        if not self.in_mean_unit:
            return 1.0
        return math.sqrt(float(np.mean(np.square(self.sizes_of(self._scaled(point))[self.held]))))

    def sizes_of(self, A: FloatArray) -> FloatArray:
        """(n,) scales of blocks (n, r, d); 1 of points."""
        sizes = np.sqrt(np.einsum("nra,nra->n", A, A) / self.d)
        return np.where(self.graph.is_point, 1.0, sizes)

    def frames_of(self, point: Point) -> FloatArray:
        """(n, r, d) blocks with orthonormal columns, of which those of a point are multiples."""
        A = point.rotations
        return np.asarray(A / self.sizes_of(A)[:, None, None])

    def scales_of(self, estimate: Estimate) -> FloatArray:
        """(n,) the scales of an estimate: 1 where they are known, and without any."""
        if estimate.scales is None:
            return np.ones(self.n)
        return np.where(self.graph.free, estimate.scales, 1.0)

    def estimate_of(self, point: Lift) -> Estimate:
        """The nearest estimate to a point of rank d; if no scale is known, the first one is 1."""
        Q = so.project(point.rotations)
        s = np.einsum("nab,nab->n", Q, point.rotations) / self.d
        s = np.where(self.graph.free, s, 1.0)
        if not (s > 0.0).all():
            raise NumericalError("a scale is not positive")
        t = translations_of(point)
        if self.in_mean_unit:
            unit = s[self.held[0]]
            s, t = np.where(self.graph.free, s / unit, 1.0), t / unit
        return Estimate(Q, t, scales=s)

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph, or one whose known scales are others."""
        super().check(estimate)
        if estimate.scales is None:
            if self.graph.free.any():
                raise InputError("the estimate has no scales, but the graph's are unknown")
            return
        if self.in_mean_unit:
            return
        off = np.abs(estimate.scales[self.held] - 1.0) > 1e-9
        if off.any():
            node = int(self.held[np.argmax(off)])
            found = estimate.scales[node]
            raise InputError(f"node {node} has scale 1 in the graph, {found:g} in the estimate")

    # --- The cost ---------------------------------------------------------------------------------

    def edge_costs(self, point: Point) -> FloatArray:
        """(m,) terms of F, one per edge."""
        return self._sums.terms(self.blocks(point))

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of F, (n, r, d + 1): translation column, then A."""
        return self._sums.gradient(self.blocks(point))[0]

    def translation_residuals(self, point: Point) -> FloatArray:
        """(m, r) vectors t_j - t_i - A_i t_ij."""
        return operators.translation_residuals(self.form, self.blocks(point))

    def with_optimal_translations(self, point: AnyPoint) -> AnyPoint:
        """The point with the translations that minimise F for its rotations and scales."""
        t = translations_of(super().with_optimal_translations(self.blocks(point)))
        return point.with_translations(self._unit_of(point) * t)  # type: ignore[return-value]

    def _eliminated(self, point: Point) -> FloatArray:
        return super()._eliminated(self.blocks(point))

    def complete(self, rotations: FloatArray, scales: FloatArray | None = None) -> Estimate:
        """The estimate of these rotations and scales with optimal translations."""
        t = np.zeros(rotations.shape[:2])
        return self.with_optimal_translations(Estimate(rotations, t, scales=scales))

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) symmetric multipliers of trace zero at poses of unknown scale.

        Those traces are exactly >= 0, by a little, as they count s_i^2 >= 0 times in the cost.
        Where no scale is known, all traces are the cost over the number of poses, but for rounding.
        """
        here = self.blocks(point)
        return self.multipliers_at(here, self.gradient(here))

    def multipliers_at(self, point: Lift, gradient: FloatArray) -> FloatArray:
        """The same, of admissible blocks with half the gradient of F there."""
        A = point.rotations
        square = np.where(self.graph.free, self.sizes_of(A) ** 2, 1.0)
        square = np.maximum(square, np.finfo(float).tiny)
        Lam = operators.multipliers(gradient[:, :, 1:], A) / square[:, None, None]
        Lam[self.graph.is_point] = 0.0
        return self.admissible(Lam)

    def admissible(self, Lam: FloatArray) -> FloatArray:
        """Multipliers with other mean diagonals at poses of unknown scale; see `multipliers`."""
        free = np.flatnonzero(self.graph.free)
        own, d = Lam[free], np.arange(self.d)
        means = np.trace(own, axis1=1, axis2=2) / self.d
        common = float(means.mean()) if self.in_mean_unit else 0.0
        own[:, d, d] -= (means - common)[:, None]
        if not self.in_mean_unit:
            diagonal = own[:, d, d]
            size = np.abs(diagonal).sum(axis=1)
            trace = diagonal.sum(axis=1)  # within 2 U of the sizes
            own[:, -1, -1] += np.maximum(-trace, 0.0) + 4.0 * U * size + 2.0**-1000
        out = Lam.copy()
        out[free] = own
        return out

    def value_of(self, diagonals: FloatArray) -> float:
        """The bound by diagonals (k, d) of the multipliers at the `held` poses, rounded down."""
        if not self.in_mean_unit:
            return super().value_of(diagonals)
        least = min(math.fsum(row) for row in diagonals.tolist())
        product = math.nextafter(least, -math.inf) * len(diagonals)
        return math.nextafter(product, -math.inf)

    def first_order(self, estimate: Estimate) -> FirstOrder:
        """Cost, gradient, multipliers and stationarity at an estimate."""
        model = self.linearized(estimate)
        gradient = model.layout.unpack(model.gradient)
        Lam = self.multipliers_at(model.point, model.euclidean)
        return FirstOrder(model.cost, gradient, Lam, self.stationarity(estimate))

    def stationarity(self, estimate: Estimate) -> float:
        """The largest gradient over its curvature: radians, shares of scale and of lengths."""
        model = self.linearized(estimate)
        return model.stationarity(model.scale(model.gauss_newton))

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """Refused: there are no covariances of similarities."""
        raise InputError("covariances are for poses of known scale, not for similarities")

    @property
    def row_weights(self) -> FloatArray:
        """(N,) the size of each row of a certificate matrix."""
        return np.asarray(self.matrix.diagonal())

    def retracted(self, moved: FloatArray, A: FloatArray) -> FloatArray:
        """The nearest admissible blocks (n, r, d) of the scales of A to those moved from there."""
        scales = self.sizes_of(A)[:, None, None]
        return np.asarray(scales * so.orthonormal(moved / scales))

    def linearized(self, point: Point) -> SimilarityModel:
        """The quadratic model of F at a point of any rank."""
        return SimilarityModel(self, self.blocks(point))

    def layout(self, rank: int) -> Layout:
        """Of Hessians at points of that rank: translations, turns, and the logarithm of scale."""
        d = self.d
        return self.pattern.layout(rank + rank * d - d * (d + 1) // 2 + 1, rank)

    def scaled(self, factor: float) -> SimilarityProblem:
        """The same measurements with all weights times ``factor``."""
        return self.reweighted(np.full(self.graph.num_edges, factor))

    def reweighted(self, factors: FloatArray) -> SimilarityProblem:
        """The problem with weights times factors (m,)."""
        return self._shared(SimilarityProblem(self.graph.reweighted(factors), self.engine))

    # --- Rounding ---------------------------------------------------------------------------------

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on F of the estimate, for the rotations nearest to the stored."""
        s = self.scales_of(estimate)
        point = Lift(s[:, None, None] * estimate.rotations, estimate.translations)
        own = so.rotation_defect(estimate.rotations)
        low, high = enclosure(self.graph, self.form, point, s, own)
        if not self.in_mean_unit:
            return low, high
        mean = float(np.mean(np.square(s[self.held])))
        off = (len(self.held) + 16.0) * 2.0 * U
        return low / mean * (1.0 - off), high / mean * (1.0 + off)

    def entry_errors(self, multipliers: FloatArray, w: FloatArray) -> FloatArray:
        """(N,) row sums of the rounding in S's entries, weighted by w."""
        return entry_errors(self.graph, self.pattern, multipliers, w)

    # --- Starts -----------------------------------------------------------------------------------

    @property
    def root(self) -> int:
        """The heaviest pose of known scale, which starts hold."""
        return int(self.held[np.argmax(self.curvature[self.held])])

    def linear_start(self) -> Estimate:
        """The minimum of F over all matrices A and vectors t, one pose held, rounded.

        Raises
        ------
        NumericalError
            That is not unique, up to rounding, or a block has no rotation near it.
        """
        layout, d, root = self.pattern.layout_of(self.matrix), self.d, self.root
        rows = layout.first_row(root) + np.arange(d + 1)
        fixed = np.zeros((self.matrix.shape[0], d))
        fixed[rows[1:]] = np.eye(d)
        forces = -(self.matrix @ fixed)
        forces[rows] = 0.0
        A = pinned(self.matrix, rows)
        factor = self.symbolic(A).factor(A)
        if factor is None:
            raise NumericalError("the measurements leave a node free, up to rounding")
        X = layout.unpack(factor.solve(forces) + fixed)
        blocks = np.swapaxes(X[:, 1:], 1, 2)
        blocks[self.graph.is_point] = np.eye(d)
        return self.with_optimal_translations(self.estimate_of(Lift(blocks, X[:, 0])))
