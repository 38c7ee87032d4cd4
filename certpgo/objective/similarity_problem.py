"""Poses of unknown scale: F over similarities A_i = s_i R_i, t_i.

F is a quadratic form of A and t, the same matrix M as that of poses but for measured scales. A pose
of known scale has A^T A = I; one of unknown scale has A^T A = s^2 I for any s. So its multiplier is
symmetric of trace zero, and the bound is the trace over the poses of known scale:

    tr(X M X^T) = tr(X S X^T) + sum_i <A_i^T A_i, Lam_i>,   S = M - blkdiag(0, Lam),

where the last sum is the constant sum of tr(Lam_i) over poses of known scale, plus s_i^2 tr(Lam_i)
of the others. See docs/similarities.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.graph.similarity_graph import SimilarityGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import Layout, pinned
from certpgo.linalg.factor import Factor
from certpgo.objective import operators
from certpgo.objective.base import FirstOrder
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.problem import PoseProblem
from certpgo.objective.quadratic_model import ROUNDING, largest_step
from certpgo.objective.similarity_rounding import enclosure, entry_errors

#: What the cost is called.
SIMILAR = "F over similarities, in the unit of the poses of known scale"
#: Damping that fixes the gauge, and the least after a step that fails, relative to the diagonal.
GAUGE, DAMPING = 1e-12, 1e-4
#: Share of a solved scale below which that of a start is not taken.
SMALLEST = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class SimilarityProblem(PoseProblem):
    """Minimise F over similarities and points; see `certpgo.SimilarityGraph`.

    Points of its relaxation are `Lift`s whose blocks Y_i have Y_i^T Y_i = s_i^2 I. Estimates have
    scales; without any they are ones.

    Raises
    ------
    GraphError
        The graph is disconnected, or a node is left free.
    InputError
        It is not a SimilarityGraph.
    """

    graph: SimilarityGraph

    def __post_init__(self) -> None:
        if not isinstance(self.graph, SimilarityGraph):
            raise InputError("SimilarityProblem takes a SimilarityGraph")
        super().__post_init__()

    title = SIMILAR
    cost_name = "similarity"
    takes_scales = True

    @cached_property
    def form(self) -> PoseGraph:
        """The measurements as edges whose residuals are A_j - A_i s_ij R_ij."""
        graph, rotation = self.graph, self.graph.rotation
        P = graph.scales[:, None, None] * rotation.rotations
        kappa, one = rotation.kappa[:, None, None], np.eye(self.d)
        N = kappa * P
        general = RotationGraph(self.n, graph.edges, rotation.rotations, rotation.kappa, N)
        K = kappa * one
        general.__dict__["polar"] = P, K, graph.scales[:, None, None] ** 2 * K
        flags = graph.points, graph.assumed, graph.absolute
        return PoseGraph(general, graph.translations, graph.tau, None, *flags)

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.form)

    @cached_property
    def data_matrix(self) -> CSC:
        """M with F = tr(X M X^T), interleaved."""
        return operators.data_matrix(self.pattern, self.form, self._sums.node_sums)

    # --- Points -----------------------------------------------------------------------------------

    @cached_property
    def held(self) -> IntArray:
        """The poses of known scale."""
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
        if isinstance(point, Lift):
            return point
        A = point.rotations
        if point.scales is not None:
            A = self.scales_of(point)[:, None, None] * A
        return Lift(A, point.translations)

    def scales_of(self, estimate: Estimate) -> FloatArray:
        """(n,) the scales of an estimate: 1 where they are known, and without any."""
        if estimate.scales is None:
            return np.ones(self.n)
        return np.where(self.graph.free, estimate.scales, 1.0)

    def estimate_of(self, point: Lift) -> Estimate:
        """The nearest estimate to a point of rank d, at its translations."""
        Q = so.project(point.rotations)
        s = np.einsum("nab,nab->n", Q, point.rotations) / self.d
        s = np.where(self.graph.free, s, 1.0)
        if not (s > 0.0).all():
            raise NumericalError("a scale is not positive")
        return Estimate(Q, point.translations, scales=s)

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph, or one whose known scales are others."""
        super().check(estimate)
        if estimate.scales is None:
            if self.graph.free.any():
                raise InputError("the estimate has no scales, but the graph's are unknown")
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

    def _eliminated(self, point: Point) -> FloatArray:
        return super()._eliminated(self.blocks(point))

    def complete(self, rotations: FloatArray, scales: FloatArray | None = None) -> Estimate:
        """The estimate of these rotations and scales with optimal translations."""
        t = np.zeros(rotations.shape[:2])
        return self.with_optimal_translations(Estimate(rotations, t, scales=scales))

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) symmetric multipliers, whose traces at poses of unknown scale are exactly >= 0.

        Those traces are zero but for rounding: they count s_i^2 >= 0 times in the cost.
        """
        return self._multipliers(self.blocks(point), self.gradient(point))

    def _multipliers(self, point: Lift, gradient: FloatArray) -> FloatArray:
        A, free = point.rotations, self.graph.free
        square = np.einsum("nra,nra->n", A, A) / self.d
        square = np.where(free, np.maximum(square, np.finfo(float).tiny), 1.0)
        Lam = operators.multipliers(gradient[:, :, 1:], A) / square[:, None, None]
        Lam[self.graph.is_point] = 0.0
        return self.admissible(Lam)

    def admissible(self, Lam: FloatArray) -> FloatArray:
        """Multipliers without their mean diagonals at poses of unknown scale, the trace >= 0."""
        free = np.flatnonzero(self.graph.free)
        own, d = Lam[free], np.arange(self.d)
        own[:, d, d] -= (np.trace(own, axis1=1, axis2=2) / self.d)[:, None]
        diagonal = own[:, d, d]
        size = np.abs(diagonal).sum(axis=1)
        trace = diagonal.sum(axis=1)  # within 2 U of the sizes
        own[:, -1, -1] += np.maximum(-trace, 0.0) + 4.0 * U * size + 2.0**-1000
        out = Lam.copy()
        out[free] = own
        return out

    def first_order(self, estimate: Estimate) -> FirstOrder:
        """Cost, gradient, multipliers and stationarity at an estimate."""
        model = self.linearized(estimate)
        gradient = model.layout.unpack(model.gradient)
        Lam = self._multipliers(model.point, model.euclidean)
        return FirstOrder(model.cost, gradient, Lam, self.stationarity(estimate))

    def stationarity(self, estimate: Estimate) -> float:
        """The largest gradient over its curvature: radians, shares of scale and of lengths."""
        model = self.linearized(estimate)
        return model.stationarity(model.scale(model.gauss_newton))

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """Refused: there are no covariances of similarities."""
        raise InputError("covariances are for poses of known scale, not for similarities")

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
        graph = self.graph.reweighted(factors)
        if not isinstance(graph, SimilarityGraph):
            raise InputError("SimilarityProblem takes a SimilarityGraph")
        return self._shared(SimilarityProblem(graph, self.engine))

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost."""
        return "the proof tier is not for similarities"

    # --- Rounding ---------------------------------------------------------------------------------

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on F of the estimate, for the rotations nearest to the stored."""
        point, s = self.blocks(estimate), self.scales_of(estimate)
        return enclosure(self.graph, self.form, point, s, so.rotation_defect(estimate.rotations))

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


class SimilarityModel:
    """F near a point of rank r, a `QuadraticModel` over translations, turns and log-scales."""

    def __init__(self, problem: SimilarityProblem, point: Lift) -> None:
        self.problem, self.point = problem, point
        self.cost = float(problem._sums.terms(point).sum())
        self.rank = point.rotations.shape[1]
        self.layout = problem.layout(self.rank)

    @cached_property
    def gauge(self) -> FloatArray:
        """(N,) a little everywhere, which holds motions of the whole."""
        return np.full(self.layout.size, GAUGE)

    @property
    def rounding(self) -> float:
        """A decrease of the cost that may be lost in rounding."""
        return ROUNDING * self.cost

    @cached_property
    def euclidean(self) -> FloatArray:
        """Half the Euclidean gradient, (n, r, d + 1)."""
        return self.problem.gradient(self.point)

    @cached_property
    def _basis(self) -> FloatArray:
        """(n, q + 1, r, d) tangents: turns by a radian, then growth by a factor of e."""
        A, free = self.point.rotations, self.problem.graph.free
        s = np.sqrt(np.einsum("nra,nra->n", A, A) / self.problem.d)
        s[self.problem.graph.is_point] = 1.0
        turns = math.sqrt(2.0) * so.tangent_basis(A / s[:, None, None])
        growth = np.where(free[:, None, None], A, 0.0)
        return np.concatenate([s[:, None, None, None] * turns, growth[:, None]], axis=1)

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of F."""
        G = self.euclidean
        turn = np.einsum("nqrd,nrd->nq", self._basis, G[:, :, 1:])
        return self.layout.pack(np.concatenate([G[:, :, 0], turn], axis=1))

    def _hessian(self, measured: PoseGraph, multipliers: FloatArray) -> CSC:
        problem = self.problem
        diagonal, upper = operators.lifted_hessian(measured, self._basis, multipliers)
        known = ~problem.graph.free
        diagonal[known, -1, -1] = 1.0 + np.abs(diagonal[known, self.rank, self.rank])
        return problem.pattern.assemble(diagonal, upper, self.rank)

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of F/2."""
        return self._hessian(self.problem.form, np.zeros((self.problem.n,) + (self.problem.d,) * 2))

    @cached_property
    def hessian(self) -> CSC:
        """The Riemannian Hessian of F/2."""
        Lam = self.problem._multipliers(self.point, self.euclidean)
        return self._hessian(self.problem.form, Lam)

    def scale(self, H: CSC) -> FloatArray:
        """(N,) the diagonal, positive, and one number for each position."""
        size, r = self.layout.unpack(np.abs(H.diagonal())), self.rank
        largest = np.repeat([size[:, :r].max(), size[:, r:].max()], [r, size.shape[1] - r])
        size[:, :r] = size[:, :r].mean(axis=1, keepdims=True)
        return self.layout.pack(np.maximum(size, 1e-12 * largest))

    def raised(self, damping: float) -> float:
        """The damping after a failed step."""
        return max(10.0 * damping, DAMPING)

    def stationarity(self, scale: FloatArray) -> float:
        """The largest gradient over ``scale``, radians and shares of scales and lengths."""
        unpack, graph = self.layout.unpack, self.problem.graph
        steps = operators.steps(self.problem.form, self.point)
        moved = float(graph.tau @ np.einsum("ma,ma->m", steps, steps)) / float(graph.tau.sum())
        length = math.sqrt(moved) or 1.0
        return largest_step(unpack(self.gradient), unpack(scale), self.rank, length)

    def factor(self, A: CSC) -> Factor | None:
        """The factor of a matrix with the same pattern."""
        return self.problem.symbolic(A).factor(A)

    def moved(self, x: FloatArray) -> SimilarityModel:
        """The model after a step x (N,): the nearest admissible blocks, scales by exponentials."""
        step, r, problem = self.layout.unpack(x), self.rank, self.problem
        A, t = self.point.rotations, translations_of(self.point) + step[:, :r]
        s = np.sqrt(np.einsum("nra,nra->n", A, A) / problem.d)
        s[problem.graph.is_point] = 1.0
        turn = np.einsum("nq,nqrd->nrd", step[:, r:-1], self._basis[:, :-1])
        Q = so.orthonormal((A + turn) / s[:, None, None])
        growth = np.where(problem.graph.free, np.clip(step[:, -1], -3.0, 3.0), 0.0)
        grown = np.where(problem.graph.free, s * np.exp(growth), 1.0)
        return SimilarityModel(problem, Lift(grown[:, None, None] * Q, t))
