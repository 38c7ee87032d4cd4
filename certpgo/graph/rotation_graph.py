"""Graphs of relative rotations and their weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import GraphError, require
from certpgo.graph.display import Speaking
from certpgo.graph.edges import (
    Keep,
    Pairs,
    broadcast,
    check_edges,
    check_matrices,
    check_weights,
    chosen_nodes,
    edge_name,
    induced,
    polar_factors,
    simple_edges,
)
from certpgo.graph.kinds import kinds_of
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import components_in_words, ranges_of_weights, size_in_words, solving
from certpgo.graph.picture import circle_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    chosen_rows,
    frozen_flags,
    frozen_floats,
    frozen_indices,
)


@dataclass(frozen=True, eq=False, repr=False)
class RotationGraph(Speaking, Pairs):
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
        require(self.num_nodes, Integral, "a number of nodes")
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
        K : (m, d, d) symmetric positive definite matrices; or zeros for edges of kappa = 0

        Raises
        ------
        GraphError
            One is not.
        """
        K = np.asarray(K, dtype=np.float64)
        if K.shape != self.rotations.shape or (np.swapaxes(K, 1, 2) != K).any():
            raise GraphError(f"matrix weights must be {self.rotations.shape} and symmetric")
        unmeasured = ~self.measures_rotation & ~K.any(axis=(1, 2))
        indefinite = np.asarray(~(np.linalg.eigvalsh(K)[:, 0] > 0.0) & ~unmeasured)
        if indefinite.any():
            raise GraphError(f"{edge_name(self.edges, indefinite)}: K is not positive definite")
        kappa = np.trace(K, axis1=1, axis2=2) / self.d
        return replace(self, kappa=kappa, couplings=self.rotations @ K)

    @property
    def size_in_words(self) -> str:
        """Such as ``9 rotations, 12 edges, 3D``."""
        return size_in_words(self.num_nodes, 0, self.num_edges, self.d, kind=self.kind)

    @property
    def _headline(self) -> str:
        return f"{type(self).__name__}: {self.size_in_words}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from ranges_of_weights(self.kappa, None)
        if self.is_general:
            yield "", "these are means: edges have matrix weights"
        yield "connected", components_in_words(self.component_sizes)
        yield "next", solving(self.component_sizes)

    def _picture(self) -> str:
        return circle_of(self.num_nodes, self.edges)

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

    @property
    def is_measured(self) -> BoolArray:
        """(m,) which edges are measurements: all."""
        return np.ones(self.num_edges, dtype=bool)

    @property
    def num_measurements(self) -> int:
        """How many edges are measurements: all."""
        return self.num_edges

    @property
    def rotation(self) -> RotationGraph:
        """The graph of relative rotations: this one."""
        return self

    @cached_property
    def measures_rotation(self) -> BoolArray:
        """(m,) which edges measure a rotation."""
        return frozen_flags(self.kappa > 0.0)

    @cached_property
    def measures_translation(self) -> BoolArray:
        """(m,) which edges measure a translation: none."""
        return frozen_flags(np.zeros(self.num_edges))

    @cached_property
    def is_point(self) -> BoolArray:
        """(n,) which nodes are points: none."""
        return frozen_flags(np.zeros(self.num_nodes))

    #: What only graphs whose nodes have positions measure: nothing.
    has_positions: ClassVar[Literal[False]] = False
    has_scales: ClassVar[bool] = False
    is_partial: ClassVar[bool] = False
    information: ClassVar[None] = None
    ranges: ClassVar[None] = None
    blocks: ClassVar[tuple[Observations, ...]] = ()
    points: ClassVar[None] = None
    arms: ClassVar[None] = None
    assumed: ClassVar[None] = None
    absolute: ClassVar[None] = None

    @property
    def pairs(self) -> IntArray:
        """(m, 2) the nodes of all measurements: of the edges."""
        return self.edges

    @cached_property
    def tau(self) -> FloatArray:
        """(m,) translational concentrations: zeros."""
        return frozen_floats(np.zeros(self.num_edges))

    @cached_property
    def translations(self) -> FloatArray:
        """(m, d) measured translations: zeros, of no weight."""
        return frozen_floats(np.zeros((self.num_edges, self.d)))

    def under(self, cost: str) -> RotationGraph:
        """The same measurements, which have the cost F alone."""
        return self

    @property
    def pose_nodes(self) -> IntArray:
        """The nodes that are poses: all."""
        return np.arange(self.num_nodes)

    @property
    def from_world(self) -> BoolArray:
        """(m,) which edges are known to measure from a world: none."""
        return self.measures_translation

    @property
    def kinds(self) -> IntArray:
        """(m,) what each edge measures, a `certpgo.graph.kinds.Kind`."""
        return kinds_of(self, self.from_world)

    def with_weights(self, kappa: FloatArray | float) -> RotationGraph:
        """The same measurements with other concentrations (a scalar applies to all edges)."""
        return RotationGraph(
            self.num_nodes, self.edges, self.rotations, broadcast(kappa, self.num_edges)
        )

    def reweighted(self, factors: FloatArray) -> RotationGraph:
        """Concentrations times factors (m,); an edge with factor 0 is removed."""
        kept = factors != 0.0
        if not kept.all():
            return self.with_edges(kept).reweighted(factors[kept])
        kappa = frozen_floats(factors * self.kappa)
        check_weights("kappa", kappa, self.edges, or_none=True)
        couplings = self.couplings
        if couplings is not None:
            couplings = frozen_floats(factors[:, None, None] * couplings)
            check_matrices("couplings", couplings, self.rotations.shape, self.edges)
        # The rest was checked before.
        other: RotationGraph = object.__new__(RotationGraph)
        same = {name: getattr(self, name) for name in ("num_nodes", "edges", "rotations")}
        other.__dict__.update(same, kappa=kappa, couplings=couplings, components=self.components)
        return other

    def without_parallel_edges(self, keep: Keep) -> RotationGraph:
        """Keep ``"all"`` parallel edges, or the ``"first"`` or ``"last"`` of each pair {i, j}."""
        return self.with_edges(simple_edges(self.num_nodes, self.edges, keep))

    def with_edges(self, chosen: IntArray | BoolArray) -> RotationGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        chosen = chosen_rows(chosen, self.num_edges, "edges")
        return self._with(self.num_nodes, self.edges[chosen], chosen)

    def subgraph(self, nodes: IntArray) -> RotationGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        nodes = chosen_nodes(nodes, self.num_nodes)
        edges, chosen = induced(self.num_nodes, self.edges, nodes)
        return self._with(len(nodes), edges, chosen)

    def _with(self, num_nodes: int, edges: IntArray, chosen: IntArray | BoolArray) -> RotationGraph:
        couplings = None if self.couplings is None else self.couplings[chosen]
        return RotationGraph(
            num_nodes, edges, self.rotations[chosen], self.kappa[chosen], couplings
        )


class OfRotations:
    """What a graph of more than rotations has of that of its relative rotations."""

    rotation: RotationGraph
    blocks: tuple[Observations, ...]

    @property
    def pairs(self) -> IntArray:
        """(m + k, 2) the nodes of all measurements: of the edges, then of the blocks."""
        if not self.blocks:
            return self.edges
        return np.concatenate([self.edges, *(block.edges for block in self.blocks)])

    @property
    def rotations(self) -> FloatArray:
        """(m, d, d) measured rotations R_ij ~ R_i^T R_j."""
        return self.rotation.rotations

    @property
    def measures_rotation(self) -> BoolArray:
        """(m,) which edges measure a rotation."""
        return self.rotation.measures_rotation

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
