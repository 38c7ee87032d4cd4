"""Measurement graphs: relative measurements between nodes, and their weights.

Arrays are validated at construction and read-only afterwards. The convention everywhere: R_i is
world <- body i, an edge (i, j) measures R_ij ~ R_i^T R_j and t_ij ~ R_i^T (t_j - t_i).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import GraphError, InputError
from certpgo.graph.edges import (
    Keep,
    broadcast,
    check_edges,
    check_matrices,
    check_weights,
    components_of,
    edge_name,
    induced,
    polar_factors,
    simple_edges,
    symmetric,
)
from certpgo.linalg import so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_indices


@dataclass(frozen=True, eq=False)
class RotationGraph:
    """Relative rotations between nodes.

    Attributes
    ----------
    kind : ``"rotations"``, what is measured
    num_nodes : number n of nodes, numbered 0 ... n-1
    edges : (m, 2) node pairs (i, j); parallel edges are allowed, their terms add
    rotations : (m, d, d) measured R_ij ~ R_i^T R_j, d = 2 or 3; a matrix of few digits is replaced
        by the nearest rotation
    kappa : (m,) rotational concentrations, between 2^-400 and 2^400; or 0 for an edge of a pose
        graph that measures the translation alone
    couplings : (m, d, d) matrices N of general edges, whose terms are tr(K) + tr(K') - 2 <N, Q>,
        Q = R_i^T R_j, with K and K' the symmetric polar factors of N; None for N = kappa R_ij,
        where that is kappa ||R_j - R_i R_ij||_F^2. See `with_matrix_weights`

    Raises
    ------
    GraphError
        An index out of range, a self-loop, a matrix not a rotation, a weight out of range.

    Examples
    --------
    Three nodes, each measured a quarter turn from the one before:

    >>> import numpy as np
    >>> from certpgo import RotationGraph
    >>> turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> edges = np.array([[0, 1], [1, 2], [2, 0]])
    >>> graph = RotationGraph(3, edges, np.array([turn] * 3), kappa=np.ones(3))
    >>> graph.num_edges, graph.d, graph.is_connected
    (3, 2, True)
    """

    kind: ClassVar[Literal["poses", "rotations"]] = "rotations"

    num_nodes: int
    edges: IntArray
    rotations: FloatArray
    kappa: FloatArray
    couplings: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", frozen_indices(self.edges))
        object.__setattr__(self, "rotations", frozen_floats(self.rotations))
        object.__setattr__(self, "kappa", frozen_floats(self.kappa))
        m = len(self.edges)
        if self.num_nodes < 1:
            raise GraphError("a graph needs at least one node")
        if self.edges.shape != (m, 2) or m == 0:
            raise GraphError(f"edges must be a non-empty (m, 2) array, not {self.edges.shape}")
        if self.rotations.shape not in {(m, 2, 2), (m, 3, 3)}:
            raise GraphError(
                f"rotations must be ({m}, d, d) with d = 2 or 3, not {self.rotations.shape}"
            )
        check_edges(self.edges, self.num_nodes)
        check_weights("kappa", self.kappa, self.edges, or_none=True)
        worst, defect = so.worst_defect(self.rotations)
        if not defect <= so.DEFECT_TOLERANCE:
            i, j = self.edges[worst]
            raise GraphError(f"edge ({i}, {j}): {so.shortfall(self.rotations[worst], defect)}")
        if defect > so.ROUNDING_DEFECT:
            cleaned = frozen_floats(so.nearest_to_rounding(self.rotations))
            object.__setattr__(self, "rotations", cleaned)
        if self.couplings is not None:
            object.__setattr__(self, "couplings", frozen_floats(self.couplings))
            check_matrices("couplings", self.couplings, (m, self.d, self.d), self.edges)

    @staticmethod
    def of_couplings(
        num_nodes: int, edges: IntArray, rotations: FloatArray, couplings: FloatArray
    ) -> RotationGraph:
        """The graph of general edges; kappa is tr(K) / d, for methods that weigh by a number."""
        polar = polar_factors(np.asarray(couplings, dtype=np.float64))
        kappa = np.trace(polar[1], axis1=1, axis2=2) / couplings.shape[-1]
        graph = RotationGraph(num_nodes, edges, rotations, kappa, couplings)
        graph.__dict__["polar"] = polar
        return graph

    def with_matrix_weights(self, K: FloatArray) -> RotationGraph:
        """The same measurements with terms tr(E K E^T), E = R_j - R_i R_ij.

        Weights act on the right, in the frame of node j. With tangent information O_R, that is
        4 sin^2(theta/2) n^T O_R n for a residual angle theta about n, for K = tr(O_R)/2 I - O_R.

        Parameters
        ----------
        K : (m, d, d) symmetric positive definite matrices

        Raises
        ------
        GraphError
            One is not.
        """
        K = np.asarray(K, dtype=np.float64)
        if K.shape != self.rotations.shape or (np.swapaxes(K, 1, 2) != K).any():
            raise GraphError(f"matrix weights must be {self.rotations.shape} and symmetric")
        indefinite = np.asarray(~(np.linalg.eigvalsh(K)[:, 0] > 0.0))
        if indefinite.any():
            raise GraphError(f"{edge_name(self.edges, indefinite)}: K is not positive definite")
        kappa = np.trace(K, axis1=1, axis2=2) / self.d
        return replace(self, kappa=kappa, couplings=self.rotations @ K)

    @property
    def is_general(self) -> bool:
        """Whether edges have couplings."""
        return self.couplings is not None

    @cached_property
    def polar(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Factors P, K and K' (m, d, d) of the couplings: N = P K = K' P, P orthogonal, K >= 0."""
        if self.couplings is None:
            K = self.kappa[:, None, None] * np.eye(self.d)
            return self.rotations, K, K
        return polar_factors(self.couplings)

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.rotations.shape[-1])

    @property
    def num_edges(self) -> int:
        """Number m of edges, parallel ones counted."""
        return len(self.edges)

    @cached_property
    def components(self) -> IntArray:
        """(n,) label of each node's connected component; labels count from 0."""
        return components_of(self.num_nodes, self.edges)

    @cached_property
    def component_sizes(self) -> tuple[int, ...]:
        """Nodes in each component, in the order of the labels."""
        return tuple(int(k) for k in np.bincount(self.components))

    @property
    def is_connected(self) -> bool:
        """Whether there is one component."""
        return len(self.component_sizes) == 1

    def with_weights(self, kappa: FloatArray | float) -> RotationGraph:
        """The same measurements with other concentrations (a scalar applies to all edges)."""
        return RotationGraph(
            self.num_nodes, self.edges, self.rotations, broadcast(kappa, self.num_edges)
        )

    def reweighted(self, factors: FloatArray) -> RotationGraph:
        """Concentrations times factors (m,); an edge with factor 0 is removed."""
        kept = factors != 0.0
        graph = self if kept.all() else self.with_edges(kept)
        factors = factors[kept]
        couplings = graph.couplings
        if couplings is not None:
            couplings = factors[:, None, None] * couplings
        return replace(graph, kappa=factors * graph.kappa, couplings=couplings)

    def without_parallel_edges(self, keep: Keep) -> RotationGraph:
        """Keep ``"all"`` parallel edges, or the ``"first"`` or ``"last"`` of each pair {i, j}."""
        return self.with_edges(simple_edges(self.num_nodes, self.edges, keep))

    def with_edges(self, chosen: IntArray | BoolArray) -> RotationGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return self._with(self.num_nodes, self.edges[chosen], chosen)

    def subgraph(self, nodes: IntArray) -> RotationGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        edges, chosen = induced(self.num_nodes, self.edges, nodes)
        return self._with(len(nodes), edges, chosen)

    def _with(self, num_nodes: int, edges: IntArray, chosen: IntArray | BoolArray) -> RotationGraph:
        couplings = None if self.couplings is None else self.couplings[chosen]
        return RotationGraph(
            num_nodes, edges, self.rotations[chosen], self.kappa[chosen], couplings
        )


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Relative poses between nodes.

    Attributes
    ----------
    kind : ``"poses"``, what is measured
    rotation : the graph of relative rotations
    translations : (m, d) measured t_ij ~ R_i^T (t_j - t_i), metres
    tau : (m,) translational concentrations, 1/m^2, between 2^-400 and 2^400; or 0 for an edge that
        measures the rotation alone
    arms : (m, d) points a of general edges, in the frame of pose j, whose terms are
        tau |t_j + R_j a - t_i - R_i t_ij|^2; metres. None for zeros

    Raises
    ------
    GraphError
        As `RotationGraph`; or translations that are not (m, d) and finite, or an edge that measures
        nothing.

    Examples
    --------
    Around a square, each step one metre forward and a quarter turn:

    >>> import numpy as np
    >>> from certpgo import PoseGraph, RotationGraph
    >>> turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> rotation = RotationGraph(4, edges, np.array([turn] * 4), kappa=np.ones(4))
    >>> graph = PoseGraph(rotation, np.array([[1.0, 0.0]] * 4), tau=np.full(4, 25.0))
    >>> graph.num_nodes, graph.translations.shape
    (4, (4, 2))
    """

    kind: ClassVar[Literal["poses", "rotations"]] = "poses"

    rotation: RotationGraph
    translations: FloatArray
    tau: FloatArray
    arms: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "translations", frozen_floats(self.translations))
        object.__setattr__(self, "tau", frozen_floats(self.tau))
        expected = (self.rotation.num_edges, self.rotation.d)
        if self.translations.shape != expected:
            raise GraphError(f"translations must be {expected}, not {self.translations.shape}")
        bad = np.asarray(~np.isfinite(self.translations).all(axis=1))
        if bad.any():
            raise GraphError(f"{edge_name(self.edges, bad)}: translation is not finite")
        check_weights("tau", self.tau, self.edges, or_none=True)
        nothing = (self.tau == 0.0) & (self.rotation.kappa == 0.0)
        if nothing.any():
            raise GraphError(f"{edge_name(self.edges, nothing)}: kappa and tau are 0")
        if self.arms is not None:
            object.__setattr__(self, "arms", frozen_floats(self.arms))
            check_matrices("arms", self.arms, expected, self.edges)

    def with_matrix_weights(self, W: FloatArray) -> PoseGraph:
        """The same measurements with terms tr(E W E^T), E = X_j - X_i [[1, 0], [t_ij, R_ij]].

        X = [t R] interleaved: the translation comes first. A positive semidefinite W is the second
        moment of a point cloud, and the term its point-to-point registration.

        Parameters
        ----------
        W : (m, d + 1, d + 1) symmetric positive definite matrices

        Raises
        ------
        GraphError
            One is not.
        """
        W, d = np.asarray(W, dtype=np.float64), self.d
        if W.shape != (self.num_edges, d + 1, d + 1) or (np.swapaxes(W, 1, 2) != W).any():
            raise GraphError(f"matrix weights must be {(self.num_edges, d + 1, d + 1)}, symmetric")
        tau, k = W[:, 0, 0], W[:, 0, 1:]
        check_weights("tau", tau, self.edges)
        # tau |E_t + E_R k / tau|^2 + tr(E_R (K - k k^T / tau) E_R^T)
        arms = k / tau[:, None]
        K = W[:, 1:, 1:] - k[:, :, None] * arms[:, None, :]
        rotation = self.rotation.with_matrix_weights(symmetric(K))
        # Arms move the measured points at both ends; those that the graph has are replaced.
        moved = arms if self.arms is None else arms - self.arms
        turned = (rotation.rotations @ moved[:, :, None])[:, :, 0]
        return PoseGraph(rotation, self.translations + turned, tau, arms)

    @property
    def num_nodes(self) -> int:
        """Number n of poses."""
        return self.rotation.num_nodes

    @property
    def num_edges(self) -> int:
        """Number m of edges, parallel ones counted."""
        return self.rotation.num_edges

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.rotation.d

    @property
    def edges(self) -> IntArray:
        """(m, 2) node pairs (i, j)."""
        return self.rotation.edges

    @property
    def components(self) -> IntArray:
        """(n,) label of each node's connected component."""
        return self.rotation.components

    @property
    def component_sizes(self) -> tuple[int, ...]:
        """Nodes in each component, in the order of the labels."""
        return self.rotation.component_sizes

    @property
    def is_connected(self) -> bool:
        """Whether there is one component."""
        return self.rotation.is_connected

    def with_weights(
        self, kappa: FloatArray | float | None = None, tau: FloatArray | float | None = None
    ) -> PoseGraph:
        """The same measurements with other concentrations; None keeps the current ones."""
        rotation = self.rotation if kappa is None else self.rotation.with_weights(kappa)
        new_tau = self.tau if tau is None else broadcast(tau, self.num_edges)
        return PoseGraph(rotation, self.translations, new_tau, self.arms)

    def reweighted(self, factors: FloatArray) -> PoseGraph:
        """Concentrations times factors (m,); an edge with factor 0 is removed."""
        kept = factors != 0.0
        graph = self if kept.all() else self.with_edges(kept)
        factors = factors[kept]
        return replace(graph, rotation=graph.rotation.reweighted(factors), tau=factors * graph.tau)

    def without_parallel_edges(self, keep: Keep) -> PoseGraph:
        """Keep ``"all"`` parallel edges, or the ``"first"`` or ``"last"`` of each pair {i, j}."""
        return self.with_edges(simple_edges(self.num_nodes, self.edges, keep))

    def with_edges(self, chosen: IntArray | BoolArray) -> PoseGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return self._with(self.rotation.with_edges(chosen), chosen)

    def subgraph(self, nodes: IntArray) -> PoseGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        _, chosen = induced(self.num_nodes, self.edges, nodes)
        return self._with(self.rotation.subgraph(nodes), chosen)

    def _with(self, rotation: RotationGraph, chosen: IntArray | BoolArray) -> PoseGraph:
        arms = None if self.arms is None else self.arms[chosen]
        return PoseGraph(rotation, self.translations[chosen], self.tau[chosen], arms)

    @property
    def is_general(self) -> bool:
        """Whether edges have arms or couplings, or measure only a rotation or a translation."""
        return self.arms is not None or self.rotation.is_general or self.is_partial

    @cached_property
    def is_partial(self) -> bool:
        """Whether some edges measure only a rotation or only a translation."""
        return bool((self.rotation.kappa == 0.0).any() or (self.tau == 0.0).any())


Graph = RotationGraph | PoseGraph


def require_connected(graph: Graph) -> None:
    """Refuse a disconnected graph by a GraphError with the component sizes, largest first."""
    if not graph.is_connected:
        sizes = tuple(sorted(graph.component_sizes, reverse=True))
        shown = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
        raise GraphError(
            f"the graph has {len(sizes)} components of {shown} nodes; it must be connected",
            component_sizes=sizes,
        )


def require_isotropic(graph: Graph) -> None:
    """Refuse a graph whose weights are not kappa and tau alone, by an InputError."""
    if isinstance(graph, PoseGraph) and graph.is_partial:
        raise InputError("this method takes edges that measure both rotation and translation")
    if graph.is_general:
        raise InputError(
            "this method takes the weights kappa and tau alone, not edges with matrix weights, "
            "couplings or arms"
        )
