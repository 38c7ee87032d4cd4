"""The sums over all edges of which every iteration consists, compiled where possible.

`certpgo.objective.operators` and `residuals` have the formulas in NumPy, which serve without the
compiled kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.display import Brief
from certpgo.graph.relaxed_point import Point, require_nodes, translations_of
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.compiled import LARGEST_RANK
from certpgo.objective import operators, residuals


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


class EdgeSums:
    """Derivatives of the cost of a graph."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        poses = graph if graph.has_positions else None
        measured, K = graph.rotations, None
        if graph.has_couplings:
            measured, K, _ = graph.polar
        moved = (None, None, None) if poses is None else (poses.tau, poses.translations, poses.arms)
        arrays = graph.edges, measured, K, graph.kappa, *moved
        self.edges = tuple(None if x is None else np.ascontiguousarray(x) for x in arrays)
        # Without matrix weights and arms.
        alone = graph.edges, graph.rotations, None, graph.kappa
        self._measured = *alone, *moved[:2], None

    def gradient(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Half the Euclidean gradient and the edges' terms, as `operators.gradient`."""
        require_nodes(point, self._graph.num_nodes, self._graph.d)
        n, r, d = point.rotations.shape
        if not compiled.AVAILABLE or r > LARGEST_RANK:
            return operators.gradient(self._graph, point)
        G = np.zeros((n, r, d + self._poses))
        return G, self._compiled(point, G)

    def terms(self, point: Point) -> FloatArray:
        """(m,) the edges' terms."""
        require_nodes(point, self._graph.num_nodes, self._graph.d)
        if not compiled.AVAILABLE or point.rotations.shape[1] > LARGEST_RANK:
            return operators.gradient(self._graph, point)[1]
        return self._compiled(point, None)

    @property
    def _poses(self) -> bool:
        return self._graph.has_positions

    def _compiled(self, point: Point, G: FloatArray | None) -> FloatArray:
        (_, r, d), t = point.rotations.shape, None
        if self._poses:
            t = np.ascontiguousarray(translations_of(point))
        terms = np.empty(self._graph.num_edges)
        R = np.ascontiguousarray(point.rotations)
        compiled.kernel.gradient(self.edges, d, r, R, t, G, terms)
        return terms

    def first_order(
        self, point: Estimate, turning: FloatArray, moving: FloatArray | None
    ) -> tuple[float, FloatArray, FloatArray, float]:
        """As `operators.first_order`."""
        if not compiled.AVAILABLE:
            return operators.first_order(self._graph, point, turning, moving)
        (n, d, _), t = point.rotations.shape, None
        if self._poses:
            t = np.ascontiguousarray(translations_of(point))
        R = np.ascontiguousarray(point.rotations)
        tangent, multipliers = np.empty((n, self._tangent_dim)), np.empty((n, d, d))
        terms = np.empty(self._graph.num_edges)
        stationarity = compiled.kernel.first_order(
            self.edges, d, R, t, turning, moving, tangent, multipliers, terms
        )
        return float(terms.sum()), tangent, multipliers, stationarity

    def hessian(self, R: FloatArray, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Hessian, as `operators.hessian_diagonal` and `operators.couplings`."""
        of = self.node_sums
        if not compiled.AVAILABLE:
            diagonal = operators.hessian_diagonal(of, R, multipliers)
            return diagonal, operators.couplings(self._graph, R)
        b = self._tangent_dim
        diagonal, upper = np.empty((len(R), b, b)), np.empty((self._graph.num_edges, b, b))
        R, multipliers = np.ascontiguousarray(R), np.ascontiguousarray(multipliers)
        graph, nodes = (self.edges, self._graph.d), (of.first, of.degree)
        compiled.kernel.hessian(*graph, R, multipliers, of.spread, *nodes, diagonal, upper)
        return diagonal, upper

    def angles(self, R: FloatArray) -> FloatArray:
        """As `residuals.residual_angles`."""
        if not compiled.AVAILABLE:
            return residuals.residual_angles(self._graph, R)
        angles = np.empty(self._graph.num_edges)
        compiled.kernel.angles(self._measured, self._graph.d, np.ascontiguousarray(R), angles)
        return angles

    def residuals(self, estimate: Estimate) -> tuple[FloatArray, FloatArray | None]:
        """As `residuals.residual_norms`."""
        if not compiled.AVAILABLE:
            return residuals.residual_norms(self._graph, estimate)
        turned, moved, t = np.empty(self._graph.num_edges), None, estimate.translations
        if self._poses and t is not None:
            moved, t = np.empty_like(turned), np.ascontiguousarray(t)
        R = np.ascontiguousarray(estimate.rotations)
        compiled.kernel.residuals(self._measured, self._graph.d, R, t, turned, moved)
        return turned, moved

    @cached_property
    def node_sums(self) -> operators.NodeSums:
        """The sums at its nodes."""
        return operators.NodeSums.of(self._graph)

    @property
    def _tangent_dim(self) -> int:
        d = self._graph.d
        return so.tangent_dim(d) + (d if self._poses else 0)
