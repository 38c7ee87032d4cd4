"""The sums and matrices of a graph's edges."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import components_of
from certpgo.graph.relaxed_point import Point, require_nodes
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern, Layout, pinned, scatter_sum
from certpgo.linalg.factor import Factor, Symbolic
from certpgo.objective import operators, residuals
from certpgo.objective.analyses import Analyses
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.enclosure import edge_enclosures
from certpgo.objective.minorants import Minorants
from certpgo.objective.normal_equations import NO_SCALES
from certpgo.objective.objective import Objective
from certpgo.objective.truncated import untruncated


class EdgeOperators(Objective):
    """What F has of its edges alone, whatever kinds their nodes are of."""

    graph: Graph
    engine: str
    #: The form's matrix, (N, N).
    matrix: Any

    @property
    def measured(self) -> Any:
        """The measurements without distances: all of them."""
        return self.graph

    @cached_property
    def has_positions(self) -> bool:
        """Whether nodes have positions."""
        return self.graph.has_positions

    @property
    def poses(self) -> IntArray:
        """The nodes that have a rotation, ascending: those that are no points."""
        nodes: IntArray = self.graph.pose_nodes
        return nodes

    @cached_property
    def anchor(self) -> int:
        """The pose at which the gauge is fixed: the heaviest, whatever the nodes are called.

        That is the world where positions are measured: if another one were fixed, the world would
        turn, and far positions move along arcs.
        """
        return int(self.poses[np.argmax(self.curvature[self.poses])])

    @cached_property
    def scale(self) -> float:
        """W = sum(kappa) + sum(tau |t_ij|^2), the scale of the objective.

        Positions count less, see `certpgo.graph.scale`.
        """
        return Scale.of(self.graph).total

    @cached_property
    def node_weights(self) -> FloatArray:
        """(n,) sums of kappa at each node: approximately the curvature of F/2 in its rotation."""
        return operators.degrees(self.graph.edges, self.graph.kappa, self.n)

    @property
    def median_kappa(self) -> float:
        """The median concentration of the edges that measure a rotation; 0 if none does."""
        known = self.graph.kappa[self.graph.measures_rotation]
        return float(np.median(known)) if len(known) else 0.0

    @cached_property
    def lever_weights(self) -> FloatArray:
        """(n,) sums of tau |t_ij|^2 over the edges that leave each node, and of tau |a|^2."""
        ends = zip(self.graph.edges.T, operators.levers(self.graph), strict=False)
        return sum((scatter_sum(*end, self.n) for end in ends), np.zeros(self.n))

    @cached_property
    def translation_weights(self) -> FloatArray:
        """(n,) sums of tau at each node: the curvature of F/2 in its translation."""
        return operators.degrees(self.graph.edges, self.graph.tau, self.n)

    @cached_property
    def curvature(self) -> FloatArray:
        """(n,) approximate curvature of F/2 in the rotation of one node; 1 where it is zero."""
        weights = self.node_weights
        if self.has_positions:
            weights = weights + self.lever_weights
        return np.where(weights > 0.0, weights, 1.0)

    @cached_property
    def _stiffness(self) -> tuple[FloatArray, FloatArray | None]:
        """(n,) what gradients of rotations are divided by, and those of translations if they count.

        Infinite for points, which have no rotation.
        """
        turning = np.where(self.graph.is_point, np.inf, self.curvature)
        if not self.has_positions:
            return turning, None
        length = np.sqrt(self.lever_weights.sum() / self.graph.tau.sum())
        return turning, self.translation_weights * length if length > 0.0 else None

    @cached_property
    def analyses(self) -> Analyses:
        """The order and the symbolic factorizations of the matrices."""
        return Analyses(operators.pattern(self.graph), self.engine)

    @property
    def pattern(self) -> BlockPattern:
        """Sparsity pattern shared by all matrices of the graph."""
        return self.analyses.pattern

    @property
    def order(self) -> IntArray:
        """(n,) fill-reducing order of the nodes."""
        return self.analyses.order

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a matrix of this graph's pattern; computed once per size."""
        return self.analyses.symbolic(A)

    @cached_property
    def laplacian(self) -> CSC:
        """The graph Laplacian weighted by kappa, (n, n); raises as `matrix`."""
        self.require_joined()
        return operators.laplacian(self.pattern, self.graph.kappa)

    def require_joined(self) -> None:
        """Refuse rotations that are not all measured relative to one another.

        Raises
        ------
        NumericalError
            One is not, as in a pose graph with points or positions.
        """
        turned = self.graph.measures_rotation
        if turned.all():  # the graph is connected
            return
        labels = components_of(self.n, self.graph.edges[turned])
        if labels.any():
            apart = self.n - int(np.bincount(labels).max())
            raise NumericalError(
                f"rotations cannot be averaged alone: {apart} of {self.n} are not measured "
                "relative to the others"
            )

    def grounded_factor(self, laplacian: CSC) -> Factor | None:
        """The factor of a graph Laplacian (n, n) without its first node; None if it fails."""
        grounded = pinned(laplacian, np.array([0]))
        return self.symbolic(grounded).factor(grounded)

    @cached_property
    def _sums(self) -> EdgeSums:
        return EdgeSums(self.form)

    def hessian(self, estimate: Estimate, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Blocks of the exact Riemannian Hessian of F/2; see `operators.hessian_diagonal`."""
        return self._sums.hessian(estimate.rotations, multipliers)

    def hessian_blocks(
        self, point: Point, basis: FloatArray, multipliers: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Riemannian Hessian of F/2 at a point of any rank.

        Of the Gauss-Newton matrix without multipliers; see `operators.lifted_hessian`.
        """
        return operators.lifted_hessian(self.form, basis, multipliers)

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """The Gauss-Newton matrix of F/2, for residuals in the frames of the edges' first nodes.

        It is the Hessian at an estimate that explains all measurements: motions of the world, which
        change no residual, are in its kernel.

        Raises
        ------
        InputError
            Scales are unknown.
        """
        return self.pattern.assemble(*self.gauss_newton_blocks(estimate), self.d)

    def gauss_newton_blocks(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Its blocks of the nodes, and those of each edge between its nodes.

        Raises
        ------
        InputError
            Scales are unknown.
        """
        if self.takes_scales:
            raise InputError(NO_SCALES)
        explained = EdgeSums(operators.explained(self.graph, estimate))
        return explained.hessian(estimate.rotations, np.zeros_like(estimate.rotations))

    @property
    def tangent_layout(self) -> Layout:
        """Of Hessians and Gauss-Newton matrices: rows of translations, then of rotations."""
        d, q = self.d, so.tangent_dim(self.d)
        return self.pattern.layout(d + q, d) if self.has_positions else self.pattern.layout(q)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(m,) lower and upper bounds on the edges' terms, for isotropic weights."""
        return edge_enclosures(self.graph, estimate)

    def residuals(self, R: FloatArray) -> FloatArray:
        """(m, r, d) matrices R_j - R_i R_ij, for rotations (n, r, d); R_j - R_i P if N = P K."""
        return operators.rotation_residuals(self.graph, R)

    def residual_angles(self, estimate: Estimate) -> FloatArray:
        """(m,) angles between R_i R_ij and R_j, radians; 0 where no rotation is measured."""
        require_nodes(estimate, self.n, self.d)
        return np.where(self.graph.is_measured, self._sums.angles(estimate.rotations), 0.0)

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each edge measures of a rotation, and of a translation."""
        return residuals.numbers(self.graph)

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts: twice for kappa |E|^2 in the plane."""
        return residuals.double(self.graph)

    def edge_costs(self, point: Point) -> FloatArray:
        """(m,) terms of F, one per edge."""
        return self._sums.terms(self.blocks(point))

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of F, (n, r, d); in the papers' notation X M by blocks.

        Of poses (n, r, d + 1): translation column, then rotation.
        """
        return self._sums.gradient(self.blocks(point))[0]

    def translation_residuals(self, point: Point) -> FloatArray:
        """(m, r) vectors t_j - t_i - R_i t_ij, plus R_j a where an edge has an arm a."""
        return operators.translation_residuals(self.form, self.blocks(point))

    def residual_lengths(self, estimate: Estimate) -> FloatArray | None:
        """(m,) norms of the translation residuals, metres; None of rotations alone."""
        if not self.has_positions:
            return None
        return np.asarray(np.linalg.norm(self.translation_residuals(estimate), axis=1))

    def certificate_matrix(self, multipliers: FloatArray) -> CSC:
        """S = M - blkdiag(0, Lam), or L - blkdiag(Lam) for rotations, with the pattern of M."""
        return self.pattern.subtract(self.matrix, multipliers)

    @cached_property
    def rotation_rows(self) -> BoolArray:
        """(N,) which rows of the matrix belong to rotations."""
        return self.pattern.layout_of(self.matrix).trailing(self.d)

    def minorants(self, point: Point) -> Minorants:
        """The terms themselves, wherever they touch, but for rounding."""
        return self._own_minorants

    @cached_property
    def _own_minorants(self) -> Minorants:
        return untruncated(self.graph)

    def isotropic_below(self, chosen: BoolArray) -> Any:
        """The measurements among ``chosen`` (m,): their terms are F's."""
        return self.graph.with_edges(chosen)
