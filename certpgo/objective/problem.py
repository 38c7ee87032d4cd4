"""A graph with its operators, objective and residuals.

Costs and gradients are computed from edge residuals, never from tr(X M X^T), which loses nine
digits to cancellation if translations are large.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import InputError, NumericalError, require
from certpgo.graph import Estimate, Graph
from certpgo.graph.graph import require_connected
from certpgo.graph.priors import require_determined
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg import scalar_least_squares as network
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.factor import Factor, default_engine
from certpgo.objective import operators
from certpgo.objective.base import AnyPoint, Quadratic
from certpgo.objective.objective import Objective
from certpgo.objective.rotation_problem import RotationProblem, RotationsOfPoses

#: Why unknown scales are refused, and what takes them.
SCALED = (
    "nodes of unknown scale (similarities) are not taken here, but by certpgo.solve, certify, "
    "prove, reweigh and fit_logarithms"
)

__all__ = ["PoseProblem", "Problem", "RotationProblem", "problem_of"]


@dataclass(frozen=True, eq=False, repr=False)
class PoseProblem(Quadratic):
    """Pose-graph optimization: minimise F(R, t) over SE(d)^n.

    F(R, t) = sum kappa ||R_j - R_i R_ij||_F^2 + sum tau ||t_j - t_i - R_i t_ij||^2.
    That is the problem of Rosen et al. (SE-Sync, IJRR 2019). Points among the nodes have only t;
    the rotations that estimates hold for them mean nothing.

    Attributes
    ----------
    graph : n poses and m measurements R_ij ~ R_i^T R_j, t_ij ~ R_i^T (t_j - t_i), metres, with
        concentrations kappa and tau
    engine : factorization engine, see `certpgo.linalg.factor.engines`

    Raises
    ------
    GraphError
        The graph is disconnected, or a node is left free by edges that measure only a rotation or
        a translation.
    InputError
        Nodes have no positions: take `certpgo.RotationProblem`.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import PoseProblem
    >>> from certpgo.io.datasets.synthetic import helix
    >>> instance = helix(3, np.random.default_rng(0))
    >>> problem = PoseProblem(instance.graph)
    >>> best = problem.complete(instance.truth.rotations)  # the optimal t for these rotations
    >>> problem.cost(best) < problem.cost(instance.truth)
    True
    """

    graph: Graph
    engine: str = field(default_factory=default_engine)

    #: Whether nodes have positions.
    has_positions: ClassVar[Literal[True]] = True

    #: Dimensions by which points of the relaxation rise.
    dimensions: ClassVar[int] = 1

    def __post_init__(self) -> None:
        require(self.graph, Graph, "a graph of poses")
        if not self.graph.has_positions:
            raise InputError("rotations alone have no translations: RotationProblem(graph)")
        if self.graph.is_signed:
            return  # the edges of a surrogate need not determine the nodes
        if self.graph.has_scales and not self.takes_scales:
            raise InputError(SCALED)
        if self.graph.blocks:
            found = self.graph.blocks[0].kind.plural
            raise InputError(f"F has no {found}: certpgo.solve takes them, or graph.with_blocks()")
        require_connected(self.graph)
        if self.graph.is_partial:
            require_determined(self.graph)

    @cached_property
    def rotation(self) -> RotationProblem:
        """The rotations alone; shares pattern and ordering unless there are points."""
        rotations = RotationsOfPoses(self.graph.rotations_alone, self.engine)
        return rotations if self.graph.is_point.any() else self._shared(rotations)

    @cached_property
    def scale(self) -> float:
        """W = sum(kappa) + sum(tau |t_ij|^2), the scale of the objective.

        Positions count less, see `certpgo.graph.scale`.
        """
        return Scale.of(self.graph).total

    @cached_property
    def data_matrix(self) -> CSC:
        """M with F(R, t) = tr(X M X^T), interleaved, (N, N).

        N = (d + 1) n, less d rows of each point.
        """
        return operators.data_matrix(self.pattern, self.graph, self._sums.node_sums)

    @property
    def is_signed(self) -> bool:
        """Whether weights may be negative, and bounds below zero useful."""
        return self.graph.is_signed

    @property
    def eliminates(self) -> bool:
        """Whether translations are best for rotations where their equations are solved.

        Not where negative weights leave them without a minimum.
        """
        return not self.graph.is_signed or self._translation_factor is not None

    @property
    def matrix(self) -> CSC:
        """The objective's matrix: the data matrix."""
        return self.data_matrix

    def position_rows(self, t: FloatArray) -> FloatArray:
        """(n, p, r) what translations (n, r) are in the p rows of positions in the matrix."""
        return t[:, None]

    def loose_rows(self, point: Point, pin: int) -> FloatArray:
        """(k, r) rows of X^T whose lengths no constraint fixes, the pinned pose at the origin."""
        t = translations_of(point)
        return self.position_rows(t - t[pin]).reshape(-1, t.shape[1])

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) Lagrange multipliers at a point of any rank; see `FirstOrder`."""
        if isinstance(point, Estimate) and not self.is_signed:
            return self.first_order(point).multipliers
        return self.constrained(self.gradient(point)[:, :, -self.d :], point.rotations)

    def constrained(self, gradient: FloatArray, Y: FloatArray) -> FloatArray:
        """(n, d, d) multipliers of rotations Y (n, r, d), by half the gradient there."""
        return operators.multipliers(gradient, Y)

    def tangent_basis(self, Y: FloatArray) -> FloatArray:
        """(n, q, r, d) orthonormal bases of the tangents at the rotations of a point."""
        return so.tangent_basis(Y)

    def tangent_dim(self, rank: int) -> int:
        """Number q of these."""
        return rank * self.d - self.d * (self.d + 1) // 2

    def frames(self, basis: FloatArray) -> tuple[FloatArray, ...]:
        """(r, d) frames of the subspace of an orthonormal basis, one of each handedness."""
        return basis, basis * np.r_[-1.0, np.ones(self.d - 1)]

    def rising(self, rows: FloatArray) -> Lift:
        """The move into new dimensions along (n, b) rows of the certificate matrix."""
        return Lift(rows[:, None, -self.d :], rows[:, :1])

    @cached_property
    def translation_laplacian(self) -> CSC:
        """The graph Laplacian weighted by tau, (n, n)."""
        return operators.laplacian(self.pattern, self.graph.tau)

    @cached_property
    def _translation_factor(self) -> Factor | None:
        return self.grounded_factor(self.translation_laplacian)

    def solve_translations(self, forces: FloatArray) -> FloatArray:
        """(n, d) solution of (translation Laplacian) t = forces, with the first node at zero.

        Raises
        ------
        NumericalError
            The weights are too uneven for a factorization.
        """
        if self._translation_factor is None:
            raise NumericalError("the translation Laplacian could not be factorized")
        grounded = forces.copy()
        grounded[0] = 0.0
        return self._translation_factor.solve(grounded)

    def with_optimal_translations(self, point: AnyPoint) -> AnyPoint:
        """The point with the translations that minimise F for its rotations.

        Solves for a correction, so that rounding is relative to it.
        """
        if self._translation_factor is None:  # the weights are too uneven
            return point.with_translations(self._eliminated(point))  # type: ignore[return-value]
        forces = np.ascontiguousarray(self.gradient(point)[:, :, 0])
        t = translations_of(point) - self.solve_translations(forces)
        return point.with_translations(t)  # type: ignore[return-value]

    def _eliminated(self, point: Point) -> FloatArray:
        graph = self.graph
        steps = operators.steps(graph, point)
        known = graph.measures_translation
        measured = graph.edges[known], graph.tau[known], steps[known]
        t = network.positions(self.n, *measured, self.order)
        return np.asarray(t - t[0])

    def complete(self, rotations: FloatArray) -> Estimate:
        """The estimate of these rotations with optimal translations, the first at zero.

        Parameters
        ----------
        rotations : (n, d, d), or those of the poses alone
        """
        if len(rotations) < self.n:
            of_poses, rotations = rotations, np.tile(np.eye(self.d), (self.n, 1, 1))
            rotations[self.poses] = of_poses
        return self.with_optimal_translations(Estimate(rotations, np.zeros(rotations.shape[:2])))

    def translation_residuals(self, point: Point) -> FloatArray:
        """(m, r) vectors t_j - t_i - R_i t_ij, plus R_j a where an edge has an arm a."""
        return operators.translation_residuals(self.graph, point)

    def residual_lengths(self, estimate: Estimate) -> FloatArray:
        """(m,) norms of the translation residuals, metres."""
        return np.asarray(np.linalg.norm(self.translation_residuals(estimate), axis=1))

    def edge_costs(self, point: Point) -> FloatArray:
        """(m,) terms of F, one per edge."""
        return self._sums.terms(point)

    def residual_angles(self, estimate: Estimate) -> FloatArray:
        """(m,) angles between R_i R_ij and R_j, radians."""
        return self.rotation.residual_angles(estimate)

    @cached_property
    def curvature(self) -> FloatArray:
        """(n,) sums of kappa and of tau |t_ij|^2 at each node."""
        return self.rotation.node_weights + self.lever_weights

    @cached_property
    def _stiffness(self) -> tuple[FloatArray, FloatArray | None]:
        turning = np.where(self.graph.is_point, np.inf, self.curvature)
        length = np.sqrt(self.lever_weights.sum() / self.graph.tau.sum())
        return turning, self.translation_weights * length if length > 0.0 else None

    @cached_property
    def translation_weights(self) -> FloatArray:
        """(n,) sums of tau at each node: the curvature of F/2 in its translation."""
        return operators.degrees(self.graph.edges, self.graph.tau, self.n)

    @cached_property
    def lever_weights(self) -> FloatArray:
        """(n,) sums of tau |t_ij|^2 over the edges that leave each node, and of tau |a|^2."""
        ends = zip(self.graph.edges.T, operators.levers(self.graph), strict=False)
        return sum((scatter_sum(*end, self.n) for end in ends), np.zeros(self.n))

    def scaled(self, factor: float) -> PoseProblem:
        """The same measurements with all weights times ``factor``; pattern and order are shared."""
        return self.reweighted(np.full(self.graph.num_edges, factor))

    def reweighted(self, factors: FloatArray) -> PoseProblem:
        """The problem with weights times factors (m,); an edge with factor 0 is removed."""
        return self._shared(PoseProblem(self.graph.reweighted(factors), self.engine))

    def with_unit_weights(self) -> PoseProblem:
        """The same measurements with kappa = tau = 1, as the thesis weighs them; 0 stays 0."""
        kappa, tau = (np.sign(w) for w in (self.graph.kappa, self.graph.tau))
        return PoseProblem(self.graph.with_weights(kappa, tau), self.engine)


Problem = RotationProblem | PoseProblem


def problem_of(graph: Graph, engine: str | None = None) -> Problem:
    """The problem of a graph."""
    engine = engine or default_engine()
    if graph.has_positions:
        return PoseProblem(graph, engine)
    return RotationProblem(graph, engine)


def cost_upper(problem: Objective, estimate: Estimate) -> float:
    """An upper bound on the cost of the estimate, whose translations are taken as stored."""
    return problem.enclosure(estimate)[1]
