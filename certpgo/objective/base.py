"""F as a quadratic form: the base of rotation and pose problems, with their analyses."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, TypeVar, cast

import numpy as np

from certpgo.errors import InputError, kind_of
from certpgo.graph import Estimate, Graph
from certpgo.graph.display import Brief
from certpgo.graph.relaxed_point import Lift, Point, require_nodes, rounded
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern, Layout, pinned
from certpgo.linalg.factor import Analysis, Factor, Symbolic
from certpgo.objective import operators
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.enclosure import edge_enclosures, enclosure
from certpgo.objective.minorants import Minorants
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.truncated import untruncated

#: What the cost of isotropic weights is called.
CHORDAL = "F"

#: Singular values of couplings, over the largest, below which a direction is not measured.
NONE = 1e-12

AnyPoint = TypeVar("AnyPoint", bound=Point)
AnyProblem = TypeVar("AnyProblem", bound="Quadratic")


@dataclass(frozen=True, eq=False, repr=False)
class FirstOrder(Brief):
    """Cost and first derivatives at an estimate.

    Attributes
    ----------
    cost : F
    tangent : (n, p) Riemannian gradient of F/2 in body-frame tangents, or (n, d + p) with the
        translations first
    multipliers : (n, d, d) blocks Lam_i = sym((M X^T)_{R_i} R_i), or sym((L R^T)_i R_i); Eriksson
        et al. eq. 16 is deg_i I - Lam_i. Their traces add up to F when the translations are
        optimal for the rotations
    stationarity : largest gradient of a node over its weight, radians: 0 at a stationary point.
        Translations are measured relative to the typical length of a measurement
    """

    cost: float
    tangent: FloatArray
    multipliers: FloatArray
    stationarity: float


class Quadratic(Objective, ABC):
    """F, a quadratic form of rotations and translations: the base of rotation and pose problems."""

    graph: Graph

    def _facts(self) -> Iterator[tuple[str, str]]:
        *measured, _ = self.graph._facts()
        yield "cost", "F, of residuals weighed by kappa and tau; problem.cost(estimate)"
        yield from measured
        yield "next", "certpgo.certify(problem, estimate); certpgo.solve(problem)"

    def first_order(self, estimate: Estimate) -> FirstOrder:
        """Cost, gradient, multipliers and stationarity at an estimate."""
        return FirstOrder(*self._sums.first_order(estimate, *self._stiffness))

    @property
    @abstractmethod
    def _stiffness(self) -> tuple[FloatArray, FloatArray | None]:
        """(n,) what gradients of rotations are divided by, and those of translations if they count.

        Infinite for points, which have no rotation.
        """

    @property
    @abstractmethod
    def curvature(self) -> FloatArray:
        """(n,) approximate curvature of F/2 in the rotation of one node, to scale gradients."""

    @property
    @abstractmethod
    def matrix(self) -> CSC:
        """M with F = tr(X M X^T)."""

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.graph)

    @property
    def title(self) -> str:
        """What the cost is."""
        return CHORDAL

    is_chordal = True
    #: Whether weights may be negative, and bounds below zero useful.
    is_signed: Any = False

    @property
    def chordal(self) -> Self:
        """The problem of the same measurements under F: this one."""
        return self

    @property
    def measured(self) -> Graph:
        """The measurements without distances: all of them."""
        return self.graph

    @property
    def eliminates(self) -> bool:
        """Whether translations are best for rotations where their equations are solved."""
        return True

    @abstractmethod
    def complete(self, rotations: FloatArray) -> Estimate:
        """The estimate of these rotations with the best translations."""

    def settled(self, estimate: Estimate) -> Estimate:
        """The estimate with its best translations: elsewhere, bounds are valid, but useless."""
        return self.complete(estimate.rotations)

    def nearest_estimates(self, point: Point) -> Iterator[Estimate]:
        """The nearest estimate to a point of higher rank."""
        yield self.complete(rounded(cast("Lift", point).subset(self.poses)).rotations)

    def surrogate(self, point: Point) -> Surrogate:
        """The cost itself."""
        return Surrogate(self)

    def minorants(self, point: Point) -> Minorants:
        """The terms themselves, wherever they touch, but for rounding."""
        return self._own_minorants

    @cached_property
    def _own_minorants(self) -> Minorants:
        return untruncated(self.graph)

    def isotropic_below(self, chosen: BoolArray) -> Graph:
        """The measurements among ``chosen`` (m,): their terms are F's."""
        return self.graph.with_edges(chosen)

    def shares(self, rank: int) -> tuple[float, ...]:
        """Shares of the multipliers to give up at points of this rank, until there is a bound."""
        return (0.0,)

    def tangents(self, point: Point) -> Iterator[tuple[Self, float]]:
        """The problem itself, which is its own tangent at any point; see `Surrogate.at`."""
        yield self, 0.0

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost; empty if there are."""
        if not self.graph.has_matrix_weights:
            return ""
        return (
            "the proof tier is for isotropic weights, not for edges with matrix weights, "
            "couplings or arms"
        )

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on F of an estimate, whose translations are taken as stored."""
        return enclosure(self.graph, estimate)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(m,) lower and upper bounds on the edges' terms, for isotropic weights."""
        return edge_enclosures(self.graph, estimate)

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each edge measures of a rotation, and of a translation."""
        # One direction, of rank 1, leaves turns about it; two leave none.
        ranks, d = self._ranks, self.d
        turned = np.where(ranks == 1, d - 1, so.tangent_dim(d) * (ranks > 0))
        return turned, d * self.graph.measures_translation

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts: twice for kappa |E|^2 in the plane."""
        if self.d == 3:
            return np.ones(self.graph.num_edges, dtype=np.intp)
        return np.maximum(self._ranks, 1)

    @property
    def _ranks(self) -> IntArray:
        """(m,) how many axes of the world the nodes see by each edge's rotation."""
        if self.graph.couplings is None:
            return self.d * self.graph.measures_rotation
        return np.asarray(np.linalg.matrix_rank(self.graph.couplings, rtol=NONE))

    def residual_lengths(self, estimate: Estimate) -> FloatArray | None:
        """(m,) norms of t_j - t_i - R_i t_ij, metres; None where only rotations are measured."""
        return None

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of F, (n, r, d); in the papers' notation X M by blocks.

        Of poses (n, r, d + 1): translation column, then rotation.
        """
        return self._sums.gradient(point)[0]

    def hessian(self, estimate: Estimate, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Blocks of the exact Riemannian Hessian of F/2; see `operators.hessian_diagonal`."""
        return self._sums.hessian(estimate.rotations, multipliers)

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """The Gauss-Newton matrix of F/2, for residuals in the frames of the edges' first nodes.

        It is the Hessian at an estimate that explains all measurements: motions of the world, which
        change no residual, are in its kernel.
        """
        explained = EdgeSums(operators.explained(self.graph, estimate))
        blocks = explained.hessian(estimate.rotations, np.zeros_like(estimate.rotations))
        return self.pattern.assemble(*blocks, self.d)

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) Lagrange multipliers; see `FirstOrder`."""
        if isinstance(point, Estimate):
            return self.first_order(point).multipliers
        return operators.multipliers(self.gradient(point)[:, :, -self.d :], point.rotations)

    def tangent_gradient(self, estimate: Estimate) -> FloatArray:
        """Riemannian gradient of F/2; see `FirstOrder`."""
        return self.first_order(estimate).tangent

    def stationarity(self, estimate: Estimate) -> float:
        """Distance from stationarity, radians; see `FirstOrder`."""
        return self.first_order(estimate).stationarity

    @cached_property
    def pattern(self) -> BlockPattern:
        """Sparsity pattern shared by all matrices of the graph."""
        return operators.pattern(self.graph)

    @cached_property
    def order(self) -> IntArray:
        """(n,) fill-reducing order of the nodes."""
        return factor.fill_reducing_order(self.pattern.indptr, self.pattern.indices)

    @cached_property
    def _analysis(self) -> Analysis:
        pattern = self.pattern.indptr, self.pattern.indices
        return factor.analyze(*pattern, order=self.order, engine=self.engine)

    @cached_property
    def _by_size(self) -> dict[int, Symbolic]:
        return {}

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a matrix of this graph's pattern; computed once per size."""
        known, size = self._by_size, A.shape[0]
        if size not in known:
            known[size] = self._analysis.blocks(self.pattern.layout_of(A).sizes)
        return known[size]

    def certificate_matrix(self, multipliers: FloatArray) -> CSC:
        """S = M - blkdiag(0, Lam), or L - blkdiag(Lam) for rotations, with the pattern of M."""
        return self.pattern.subtract(self.matrix, multipliers)

    @cached_property
    def rotation_rows(self) -> BoolArray:
        """(N,) which rows of the matrix belong to rotations."""
        return self.pattern.layout_of(self.matrix).trailing(self.d)

    @property
    def held(self) -> IntArray:
        """The nodes whose blocks have orthonormal columns: all poses, unless scales are unknown."""
        return self.poses

    @property
    def held_rows(self) -> BoolArray:
        """(N,) which rows of the matrix are of these blocks."""
        return self.rotation_rows

    def value_of(self, diagonals: FloatArray) -> float:
        """The bound by diagonals (k, d) of the multipliers at the `held` nodes, rounded down."""
        return math.nextafter(math.fsum(diagonals.ravel().tolist()), -math.inf)

    def admissible(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers (n, d, d) that bounds may have near given ones, which are symmetric."""
        return multipliers

    def frames_of(self, point: Point) -> FloatArray:
        """(n, r, d) the orthonormal blocks of a point."""
        return point.rotations

    def entry_errors(self, multipliers: FloatArray, w: FloatArray) -> FloatArray | None:
        """(N,) row sums of the rounding in S's entries, weighted by w; None for those of poses."""
        return None

    @property
    def tangent_layout(self) -> Layout:
        """Of Hessians and Gauss-Newton matrices: rows of translations, then of rotations."""
        d, q = self.d, so.tangent_dim(self.d)
        moved = self.graph.has_positions
        return self.pattern.layout(d + q, d) if moved else self.pattern.layout(q)

    @property
    def poses(self) -> IntArray:
        """The nodes that have a rotation, ascending: those that are no points."""
        return self.graph.pose_nodes

    @cached_property
    def anchor(self) -> int:
        """The pose at which the gauge is fixed: the heaviest, whatever the nodes are called.

        That is the world where positions are measured: if another one were fixed, the world would
        turn, and far positions move along arcs.
        """
        return int(self.poses[np.argmax(self.curvature[self.poses])])

    def grounded_factor(self, laplacian: CSC) -> Factor | None:
        """The factor of a graph Laplacian (n, n) without its first node; None if it fails."""
        grounded = pinned(laplacian, np.array([0]))
        return self.symbolic(grounded).factor(grounded)

    def _shared(self, other: AnyProblem) -> AnyProblem:
        """Another problem, which shares pattern, order and analyses if it has the same edges."""
        if other.graph.num_edges < self.graph.num_edges:
            return other
        shared = ("pattern", "order", "_analysis", "_by_size")
        other.__dict__.update((name, getattr(self, name)) for name in shared)
        return other

    def of_same_edges(self, graph: Graph) -> Self:
        """The problem of another graph with the same edges; pattern and order are shared."""
        return self._shared(type(self)(graph, self.engine))  # type: ignore[call-arg]

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph by an InputError."""
        if not isinstance(estimate, Estimate):
            raise InputError(
                f"an Estimate is expected, not {kind_of(estimate)}: certify_values takes "
                "GTSAM's Values, read_estimate reads files"
            )
        require_nodes(estimate, self.n, self.d)
        if self.graph.has_positions and estimate.translations is None:
            raise InputError("the estimate has no translations, but the graph measures them")
