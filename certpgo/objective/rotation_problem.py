"""A graph of rotations with its operators, objective and residuals."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import GraphError, InputError, NumericalError, require
from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import components_of, edge_name
from certpgo.graph.graph import require_connected
from certpgo.graph.relaxed_point import Point, require_nodes
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.factor import default_engine
from certpgo.objective import operators
from certpgo.objective.base import AnyPoint, Quadratic


@dataclass(frozen=True, eq=False, repr=False)
class RotationProblem(Quadratic):
    """Rotation averaging: minimise F(R) = sum kappa ||R_j - R_i R_ij||_F^2 over SO(d)^n.

    Attributes
    ----------
    graph : n nodes and m measured rotations R_ij ~ R_i^T R_j, with concentrations kappa
    engine : factorization engine, see `certpgo.linalg.factor.engines`

    Raises
    ------
    GraphError
        The graph is disconnected, or a measurement has weight 0.
    InputError
        Nodes have positions: take `Graph.rotations_alone`.

    Examples
    --------
    Five identities measured around a cycle, and rotations that wind around it once: each residual
    angle is 72 degrees, and F = 8 n sin^2(pi / n).

    >>> import numpy as np
    >>> from certpgo import RotationProblem
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(5, 0.0, 1)
    >>> problem = RotationProblem(instance.graph)
    >>> print(f"{problem.cost(around):.6f}")
    13.819660
    >>> print(np.degrees(problem.residual_angles(around)).round(6))
    [72. 72. 72. 72. 72.]
    """

    graph: Graph
    engine: str = field(default_factory=default_engine)

    #: Whether nodes have positions.
    has_positions: ClassVar[Literal[False]] = False

    def __post_init__(self) -> None:
        require(self.graph, Graph, "a graph of rotations")
        if self.graph.has_positions:
            raise InputError("of a graph of poses take RotationProblem(graph.rotations_alone)")
        require_connected(self.graph)
        unmeasured = ~self.graph.measures_rotation
        if unmeasured.any():
            raise GraphError(
                f"{edge_name(self.graph.edges, unmeasured)}: kappa is 0; only edges of a pose "
                "graph can do without"
            )

    @property
    def rotation(self) -> RotationProblem:
        """The problem of the rotations alone: this one."""
        return self

    def require_joined(self) -> None:
        """Refuse rotations that are not all measured relative to one another.

        Raises
        ------
        NumericalError
            One is not, as in a pose graph with points or positions.
        """

    @cached_property
    def scale(self) -> float:
        """W = sum(kappa), the scale of the objective in absolute tolerances."""
        return Scale.of(self.graph).total

    @cached_property
    def connection_laplacian(self) -> CSC:
        """L with F(R) = tr(R L R^T), (dn, dn)."""
        return operators.connection_laplacian(self.pattern, self.graph)

    @cached_property
    def laplacian(self) -> CSC:
        """The graph Laplacian weighted by kappa, (n, n)."""
        return operators.laplacian(self.pattern, self.graph.kappa)

    @property
    def matrix(self) -> CSC:
        """The objective's matrix: the connection Laplacian."""
        return self.connection_laplacian

    def residuals(self, R: FloatArray) -> FloatArray:
        """(m, r, d) matrices R_j - R_i R_ij, for rotations (n, r, d); R_j - R_i P if N = P K."""
        return operators.rotation_residuals(self.graph, R)

    def edge_costs(self, point: Point) -> FloatArray:
        """(m,) terms of F, one per edge."""
        return self._sums.terms(point)

    def residual_angles(self, estimate: Estimate) -> FloatArray:
        """(m,) angles between R_i R_ij and R_j, radians; 0 where no rotation is measured."""
        require_nodes(estimate, self.n, self.d)
        return self._sums.angles(estimate.rotations)

    def with_optimal_translations(self, point: AnyPoint) -> AnyPoint:
        """The point's rotations; there are no translations to optimize."""
        return point.with_translations(None)  # type: ignore[return-value]

    def complete(self, rotations: FloatArray) -> Estimate:
        """The estimate of these rotations."""
        return Estimate(rotations)

    @cached_property
    def node_weights(self) -> FloatArray:
        """(n,) sums of kappa at each node: approximately the curvature of F/2 in its rotation."""
        return operators.degrees(self.graph.edges, self.graph.kappa, self.n)

    @property
    def median_kappa(self) -> float:
        """The median concentration of the edges that measure a rotation; 0 if none does."""
        known = self.graph.kappa[self.graph.measures_rotation]
        return float(np.median(known)) if len(known) else 0.0

    @property
    def curvature(self) -> FloatArray:
        """(n,) sums of kappa at each node."""
        return self.node_weights

    @cached_property
    def _stiffness(self) -> tuple[FloatArray, None]:
        return self.curvature, None

    def scaled(self, factor: float) -> RotationProblem:
        """The same measurements with all weights times ``factor``; pattern and order are shared."""
        return self.reweighted(np.full(self.graph.num_edges, factor))

    def reweighted(self, factors: FloatArray) -> RotationProblem:
        """The problem with weights times factors (m,); an edge with factor 0 is removed."""
        return self._shared(RotationProblem(self.graph.reweighted(factors), self.engine))

    def with_unit_weights(self) -> RotationProblem:
        """The same measurements with kappa = 1, as the thesis weighs them."""
        return RotationProblem(self.graph.with_weights(1.0), self.engine)


class RotationsOfPoses(RotationProblem):
    """The rotations of a pose graph, of which some measurements may have weight 0, or less."""

    is_signed = True

    def __post_init__(self) -> None:
        pass  # what determines the nodes is the pose problem's affair

    @cached_property
    def connection_laplacian(self) -> CSC:
        """L with F(R) = tr(R L R^T), (dn, dn).

        Raises
        ------
        NumericalError
            The rotations that are measured leave some free.
        """
        self.require_joined()
        return operators.connection_laplacian(self.pattern, self.graph)

    @cached_property
    def laplacian(self) -> CSC:
        """The graph Laplacian weighted by kappa, (n, n); raises as `connection_laplacian`."""
        self.require_joined()
        return operators.laplacian(self.pattern, self.graph.kappa)

    def require_joined(self) -> None:
        """As in the base class."""
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

    @property
    def curvature(self) -> FloatArray:
        """(n,) sums of kappa at each node; 1 where no rotation is measured."""
        return np.where(self.node_weights > 0.0, self.node_weights, 1.0)
