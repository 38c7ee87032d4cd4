"""F as a quadratic form of a graph's measurements: edges, pattern, operators, elimination, sums.

Costs and gradients are computed from edge residuals, never from tr(X M X^T), which loses nine
digits to cancellation if translations are large.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from certpgo.errors import GraphError, InputError, kind_of, require
from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import edge_name
from certpgo.graph.graph import require_connected
from certpgo.graph.priors import require_determined, rotations_are_apart
from certpgo.graph.relaxed_point import Lift, Point, main_subspace, require_nodes, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.factor import default_engine
from certpgo.objective import operators
from certpgo.objective.edge_operators import EdgeOperators
from certpgo.objective.edge_sums import FirstOrder
from certpgo.objective.elimination import EliminatedTranslations
from certpgo.objective.enclosure import enclosure
from certpgo.objective.lifting import REAL, Lifting
from certpgo.objective.manifold_model import ManifoldModel
from certpgo.objective.manifolds import Kinds
from certpgo.objective.objective import Surrogate
from certpgo.objective.scales import SHARES, Scales

#: What the cost of isotropic weights is called.
CHORDAL = "F"
#: Why unknown scales are refused, and what takes them.
NO_SCALES = (
    "nodes of unknown scale (similarities) are not taken here, but by certpgo.solve, certify, "
    "prove, reweigh and fit_logarithms"
)
AnyPoint = TypeVar("AnyPoint", bound=Point)


@dataclass(frozen=True, eq=False, repr=False)
class Quadratic(EdgeOperators):
    """The problem of a graph under F: rotation averaging, or pose-graph optimization.

    Of relative rotations, F(R) = sum kappa ||R_j - R_i R_ij||_F^2 over SO(d)^n; of relative poses
    F(R, t) = that + sum tau ||t_j - t_i - R_i t_ij||^2 over SE(d)^n, the problem of Rosen et al.
    (SE-Sync, IJRR 2019). Points among the nodes have only t; the rotations that estimates hold for
    them mean nothing. Nodes of unknown scale have s R instead of R, see `certpgo.SimilarityGraph`.

    Attributes
    ----------
    graph : n nodes and m measurements R_ij ~ R_i^T R_j, t_ij ~ R_i^T (t_j - t_i), metres, with
        concentrations kappa and tau
    engine : factorization engine, see `certpgo.linalg.factor.engines`
    lifting : the dimensions that points of the relaxation rise into
    is_part : whether the edges are a part of a problem, of any sign, and need not determine nodes
    roundings : units by which the edges' numbers may be off; bounds are on the cost of exact ones

    Raises
    ------
    GraphError
        The graph is disconnected; a measurement of rotations alone has weight 0; or a node is left
        free by edges that measure only a rotation or a translation.
    InputError
        It is not a graph, or has measurements of other kinds; or one of ``nodes`` has scales.

    Examples
    --------
    Five identities measured around a cycle, and rotations that wind around it once: each residual
    angle is 72 degrees, and F = 8 n sin^2(pi / n).

    >>> import numpy as np
    >>> from certpgo import Quadratic
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(5, 0.0, 1)
    >>> problem = Quadratic(instance.graph)
    >>> print(f"{problem.cost(around):.6f}")
    13.819660
    >>> print(np.degrees(problem.residual_angles(around)).round(6))
    [72. 72. 72. 72. 72.]
    """

    graph: Graph
    engine: str = field(default_factory=default_engine)
    lifting: Lifting = REAL
    is_part: bool = False
    roundings: float = 0.0

    is_chordal = True
    most_steps, polished = 300, 1e-11

    def __post_init__(self) -> None:
        require(self.graph, Graph, "a graph")
        if self.is_signed:
            return  # the edges of a surrogate need not determine the nodes
        graph = self.graph
        if graph.blocks:
            found = graph.blocks[0].kind.plural
            raise InputError(f"F has no {found}: certpgo.solve takes them, or graph.with_blocks()")
        require_connected(graph)
        if graph.has_positions:
            if graph.is_partial:
                require_determined(graph)
        elif not graph.measures_rotation.all():
            raise GraphError(
                f"{edge_name(graph.edges, ~graph.measures_rotation)}: kappa is 0; only edges of a "
                "pose graph can do without"
            )

    def _facts(self) -> Iterator[tuple[str, str]]:
        *measured, _ = self.graph._facts()
        yield "cost", "F, of residuals weighed by kappa and tau; problem.cost(estimate)"
        yield from measured
        yield "next", "certpgo.certify(problem, estimate); certpgo.solve(problem)"

    # --- What the graph is ------------------------------------------------------------------------

    @property
    def title(self) -> str:
        """What the cost is."""
        if not self.takes_scales:
            return CHORDAL
        unit = "root mean square scale" if self.kinds.in_mean_unit else "poses of known scale"
        return f"{CHORDAL} over similarities, in the unit of the {unit}"

    @property
    def is_signed(self) -> bool:
        """Whether weights may be negative, and bounds below zero useful."""
        return self.is_part or (self.has_positions and self.graph.is_signed)

    @property
    def chordal(self) -> Quadratic:
        """The problem of the same measurements under F: this one."""
        return self

    @cached_property
    def rotation(self) -> Quadratic:
        """The rotations alone; shares pattern and ordering unless there are points."""
        if not self.has_positions:
            return self
        rotations = Quadratic(self.graph.rotations_alone, self.engine, is_part=True)
        return rotations if self.graph.is_point.any() else self._shared(rotations)

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost; empty if there are."""
        if self.graph.has_others:
            return "the proof tier knows no nodes of other kinds than the graph's own"
        return ""

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph, or one whose known scales are others."""
        if not isinstance(estimate, Estimate):
            raise InputError(
                f"an Estimate is expected, not {kind_of(estimate)}: certify_values takes "
                "GTSAM's Values, read_estimate reads files"
            )
        require_nodes(estimate, self.n, self.d)
        if self.has_positions and estimate.translations is None:
            raise InputError("the estimate has no translations, but the graph measures them")
        if self.takes_scales:
            self.scales.check(estimate)

    def scaled(self, factor: float) -> Quadratic:
        """The same measurements with all weights times ``factor``; pattern and order are shared."""
        return self.of_same_edges(self.graph.scaled(factor))

    def reweighted(self, factors: FloatArray) -> Quadratic:
        """The problem with weights times factors (m,); an edge with factor 0 is removed."""
        return self.of_same_edges(self.graph.reweighted(factors))

    def with_unit_weights(self) -> Quadratic:
        """The same measurements with kappa = tau = 1, as the thesis weighs them; 0 stays 0."""
        tau = np.sign(self.graph.tau) if self.has_positions else None
        return replace(self, graph=self.graph.with_weights(np.sign(self.graph.kappa), tau))

    def of_same_edges(self, graph: Any) -> Quadratic:
        """The problem of another graph; pattern and order are shared if it has the same edges."""
        return self._shared(replace(self, graph=graph))

    def _shared(self, other: Quadratic) -> Quadratic:
        if other.graph.num_edges == self.graph.num_edges:
            other.__dict__["analyses"] = self.analyses
        return other

    # --- Kinds of nodes ---------------------------------------------------------------------------

    @cached_property
    def kinds(self) -> Kinds:
        """The kinds of nodes."""
        return Kinds.in_graph(self.graph, self.lifting.pose)

    @cached_property
    def takes_scales(self) -> bool:  # type: ignore[override]
        """Whether scales of nodes may be unknown."""
        return bool(self.graph.has_scales)

    @cached_property
    def scales(self) -> Scales:
        """The nodes' scales, where some may be unknown."""
        return Scales(self.graph, self.kinds.scaled, self.kinds.in_mean_unit)

    @cached_property
    def form(self) -> Any:
        """The measurements, as edges between `blocks` where scales are unknown."""
        return self.scales.form if self.takes_scales else self.graph

    def blocks(self, point: Any) -> Any:
        """The point with blocks s_i R_i in place of rotations, in the unit of the cost."""
        return self.scales.blocks(point) if self.takes_scales else point

    def sizes_of(self, blocks: FloatArray) -> FloatArray:
        """(n,) scales of blocks (n, r, d); ones where they are known."""
        return self.scales.sizes(blocks) if self.takes_scales else np.ones(len(blocks))

    def estimate_of(self, point: Any) -> Estimate:
        """The nearest estimate to a point of rank d."""
        R = self.kinds.apply("rounded", point.rotations)
        if self.takes_scales:
            return self.scales.estimate(point, R)
        return self.as_estimate(R, point.translations)

    def as_estimate(
        self,
        rotations: FloatArray,
        translations: FloatArray | None,
        scales: FloatArray | None = None,
    ) -> Estimate:
        """An estimate, whose blocks need not be rotations where kinds of nodes are others."""
        make = Estimate.trusted if self.graph.has_others else Estimate
        return make(rotations, translations, scales=scales)

    def nearest_estimates(self, point: Point) -> Iterator[Estimate]:
        """The projections to the main subspace of a point: of either handedness, of scales."""
        if self.takes_scales:
            yield from map(self.with_optimal_translations, self.projections(point))
            return
        among = cast("Lift", point).subset(self.poses)
        basis = main_subspace(among)
        reflected = so.is_mostly_reflected(np.swapaxes(basis.T @ among.rotations, 1, 2))
        B = self.lifting.frames(basis)[int(reflected)]
        yield self.complete(self.kinds.apply("rounded", B.T @ point.rotations))

    def projections(self, point: Point) -> Iterator[Estimate]:
        """The same of blocks with scales, and of the point's translations."""
        s = self.sizes_of(point.rotations)
        for B in self.lifting.frames(main_subspace(cast("Lift", point).subset(self.poses))):
            R = self.kinds.apply("rounded", B.T @ point.rotations)
            yield self.as_estimate(R, translations_of(point) @ B, s)

    # --- The cost ---------------------------------------------------------------------------------

    def first_order(self, estimate: Estimate) -> FirstOrder:
        """Cost, gradient, multipliers and stationarity at an estimate."""
        if self.kinds.turn:
            return FirstOrder(*self._sums.first_order(estimate, *self._stiffness))
        model = self.linearized(estimate)
        stationarity = model.stationarity(model.scale(model.gauss_newton))
        tangent = model.layout.unpack(model.gradient)
        return FirstOrder(model.cost, tangent, model.multipliers, stationarity)

    def stationarity(self, estimate: Estimate) -> float:
        """Distance from stationarity, radians; see `FirstOrder`."""
        return self.first_order(estimate).stationarity

    def linearized(self, point: Point) -> ManifoldModel:
        """The quadratic model of F at a point of any rank."""
        return ManifoldModel(self, self.blocks(point))

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on F of an estimate, whose translations are taken as stored."""
        if self.takes_scales:
            return self.scales.enclosure(estimate)
        return enclosure(self.graph, estimate)

    @cached_property
    def matrix(self) -> CSC:
        """The quadratic form: M with F = tr(X M X^T), (N, N); of rotations L, (dn, dn).

        M is interleaved, and N = (d + 1) n, less d rows of each point.

        Raises
        ------
        NumericalError
            It is of rotations alone, and the measured ones leave some free.
        """
        if self.has_positions:
            return self.lifting.data_matrix(self.pattern, self.form, self._sums.node_sums)
        self.require_joined()
        return operators.connection_laplacian(self.pattern, self.graph)

    # --- Best translations ------------------------------------------------------------------------

    @cached_property
    def elimination(self) -> EliminatedTranslations:
        """The equations of the translations."""
        return EliminatedTranslations(self)

    @property
    def eliminates(self) -> bool:
        """Whether translations are best for rotations where their equations are solved.

        Not at once with scales, nor where negative weights leave them without a minimum.
        """
        if self.has_positions and self.is_signed and self.elimination.factor is None:
            return False
        return self.kinds.turn

    def with_optimal_translations(self, point: AnyPoint) -> AnyPoint:
        """The point with the translations that minimise F for its blocks, if nodes have any."""
        if not self.has_positions:
            return point.with_translations(None)  # type: ignore[return-value]
        t = self.elimination.best(self.blocks(point))
        if self.takes_scales:
            t = self.scales.unit(point) * t
        return point.with_translations(t)  # type: ignore[return-value]

    def complete(self, rotations: FloatArray, scales: FloatArray | None = None) -> Estimate:
        """The estimate of these rotations and scales with optimal translations, the first at zero.

        Parameters
        ----------
        rotations : (n, d, d), or those of the poses alone
        """
        if not self.has_positions:
            return self.as_estimate(rotations, None)
        if len(rotations) < self.n:
            of_poses, rotations = rotations, np.tile(np.eye(self.d), (self.n, 1, 1))
            rotations[self.poses] = of_poses
        return self.with_optimal_translations(
            self.as_estimate(rotations, np.zeros(rotations.shape[:2]), scales)
        )

    def settled(self, estimate: Estimate) -> Estimate:
        """The estimate with its best translations: elsewhere, bounds are valid, but useless."""
        if estimate.scales is None:
            return self.complete(estimate.rotations)
        return self.with_optimal_translations(estimate)

    # --- Bounds -----------------------------------------------------------------------------------

    @property
    def held(self) -> IntArray:
        """The nodes whose multipliers count in bounds: all poses, unless scales are unknown."""
        return self.kinds.held

    @property
    def root(self) -> int:
        """The heaviest pose of known scale, which starts over similarities hold."""
        return int(self.held[np.argmax(self.curvature[self.held])])

    def multipliers(self, point: Point) -> FloatArray:
        """(n, d, d) Lagrange multipliers at a point of any rank; see `FirstOrder`."""
        compiled = self.kinds.turn and not (self.has_positions and self.is_signed)
        if compiled and isinstance(point, Estimate):
            return self.first_order(point).multipliers
        here = self.blocks(point)
        return self.constrained(self.gradient(here)[:, :, -self.d :], here.rotations)

    def constrained(self, gradient: FloatArray, blocks: FloatArray) -> FloatArray:
        """(n, d, d) multipliers of blocks (n, r, d), by half the gradient there."""
        Lam = operators.multipliers(gradient, blocks)
        if self.kinds.turn:
            return Lam
        if self.takes_scales:
            square = np.maximum(self.sizes_of(blocks) ** 2, np.finfo(float).tiny)
            Lam /= square[:, None, None]
        return self.kinds.apply("constrained", Lam)

    def surrogate(self, point: Point) -> Surrogate:
        """The cost itself."""
        return Surrogate(self)

    def tangents(self, point: Point) -> Iterator[tuple[Quadratic, float]]:
        """The problem itself, which is its own tangent at any point; see `Surrogate.at`."""
        yield self, 0.0

    def shares(self, rank: int) -> tuple[float, ...]:
        """Shares of the multipliers to give up at points of this rank, until there is a bound.

        Some are where rounding has no other compensation: at points of higher rank, whose kernel
        need not meet the poses of known scale, nor where positions alone join others to these.
        """
        if not self.takes_scales or self.kinds.in_mean_unit:
            return (0.0,)
        if rank > self.d:
            return SHARES
        return (0.0, *SHARES) if rotations_are_apart(self.graph) else (0.0,)

    @property
    def climbs(self) -> bool:
        """Whether there are descents at points of higher rank."""
        return self.eliminates or not self.kinds.turn
