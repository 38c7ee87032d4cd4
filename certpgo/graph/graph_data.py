"""The arrays of a graph, checked: what its nodes are, and what is measured between them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from certpgo.errors import GraphError, require
from certpgo.graph.edges import (
    Pairs,
    check_edges,
    check_flags,
    check_matrices,
    check_weights,
    edge_name,
    polar_factors,
)
from certpgo.graph.estimate import check_scales
from certpgo.graph.information import Information
from certpgo.graph.kinds import NODES, Kind, Node, kinds_of
from certpgo.graph.observations import Observations
from certpgo.graph.ranges import Ranges
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_flags,
    frozen_floats,
    frozen_indices,
)


@dataclass(frozen=True, eq=False, repr=False)
class GraphData(Pairs):
    """What is measured between nodes: relative rotations, poses or similarities, and what else.

    Its attributes are those of `certpgo.Graph`.
    """

    nodes: IntArray
    edges: IntArray
    rotations: FloatArray
    kappa: FloatArray
    translations: FloatArray
    tau: FloatArray
    couplings: FloatArray | None = None
    arms: FloatArray | None = None
    scales: FloatArray = field(default_factory=lambda: np.ones(0))
    assumed: BoolArray | None = None
    absolute: BoolArray | None = None
    information: Information | None = None
    blocks: tuple[Observations, ...] = ()
    is_signed: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("nodes", "edges"):
            object.__setattr__(self, name, frozen_indices(getattr(self, name)))
        if not np.size(self.scales):
            object.__setattr__(self, "scales", np.ones(len(self.edges)))
        for name in ("rotations", "kappa", "translations", "tau", "scales", "couplings", "arms"):
            given = getattr(self, name)
            if given is not None or name not in ("couplings", "arms"):
                object.__setattr__(self, name, frozen_floats(given))
        m = len(self.edges)
        self._check_nodes()
        if self.edges.shape != (m, 2) or m == 0:
            raise GraphError(f"edges must be a non-empty (m, 2) array, not {self.edges.shape}")
        if self.rotations.shape not in {(m, 2, 2), (m, 3, 3)}:
            raise GraphError(
                f"rotations must be ({m}, d, d) with d = 2 or 3, not {self.rotations.shape}"
            )
        check_edges(self.edges, self.num_nodes)
        check_weights("kappa", self.kappa, self.edges, or_none=True)
        self._clean_rotations()
        if self.couplings is not None:
            check_matrices("couplings", self.couplings, (m, self.d, self.d), self.edges)
        self._check_translations()
        for name in ("assumed", "absolute"):
            flags = check_flags(name, getattr(self, name), m)
            object.__setattr__(self, name, flags)
        self._check_scales()
        self._check_besides()

    def _check_nodes(self) -> None:
        nodes = self.nodes
        if not self.num_nodes:
            raise GraphError("a graph needs at least one node")
        if nodes.ndim != 1 or not 0 <= nodes.min() <= nodes.max() < len(NODES):
            raise GraphError("nodes must be (n,) kinds, see certpgo.graph.kinds.NODES")
        alone = nodes == Node.ROTATION
        if alone.any() and not alone.all():
            raise GraphError(
                f"node {int(np.argmin(alone))}: all nodes are rotations alone, or none"
            )

    def _clean_rotations(self) -> None:
        worst, defect = so.worst_defect(self.rotations)
        if not defect <= so.DEFECT_TOLERANCE:
            i, j = self.edges[worst]
            raise GraphError(f"edge ({i}, {j}): {so.shortfall(self.rotations[worst], defect)}")
        if defect > so.ROUNDING_DEFECT:
            cleaned = frozen_floats(so.nearest_to_rounding(self.rotations))
            object.__setattr__(self, "rotations", cleaned)

    def _check_translations(self) -> None:
        expected = (self.num_edges, self.d)
        if self.translations.shape != expected:
            raise GraphError(f"translations must be {expected}, not {self.translations.shape}")
        if not np.isfinite(self.translations).all():
            bad = np.asarray(~np.isfinite(self.translations).all(axis=1))
            raise GraphError(f"{edge_name(self.edges, bad)}: translation is not finite")
        self._check_tau()
        if self.arms is not None:
            check_matrices("arms", self.arms, expected, self.edges)
        if self.is_point.any():
            self._check_points(self.is_point)

    def _check_tau(self) -> None:
        if self.is_signed:
            if not np.isfinite(self.tau).all():
                raise GraphError("weights of translations must be finite")
            return
        check_weights("tau", self.tau, self.edges, or_none=True)
        if not self.has_positions:
            if self.measures_translation.any():
                raise GraphError("rotations alone measure no translations")
            return
        nothing = ~self.measures_translation & ~self.measures_rotation
        if nothing.any():
            raise GraphError(f"{edge_name(self.edges, nothing)}: kappa and tau are 0")

    def _check_points(self, points: BoolArray) -> None:
        # From where it is, a point measures nothing but distances.
        leaving = points[self.edges[:, 0]] & self.translations.any(axis=1)
        if leaving.any():
            raise GraphError(f"{edge_name(self.edges, leaving)}: edges lead to points, not from")
        turned = points[self.edges].any(axis=1) & self.measures_rotation
        if self.arms is not None:
            turned |= points[self.edges[:, 1]] & self.arms.any(axis=1)
        if turned.any():
            raise GraphError(f"{edge_name(self.edges, turned)}: a point has no rotation")

    def _check_scales(self) -> None:
        check_scales("edge", self.scales, self.num_edges)
        if self.has_scales and self.has_matrix_weights:
            raise GraphError("similarities have isotropic weights, without arms and couplings")

    def _check_besides(self) -> None:
        """Refuse information matrices and other measurements of another graph."""
        if self.information is not None:
            if self.has_scales:
                raise GraphError("similarities have isotropic weights, no information matrices")
            self.information.require_size(self.num_edges, self.d)
            if self.couplings is not None:
                raise GraphError("edges have matrix weights or information matrices, not both")
        for block in self.blocks:
            require(block, Observations, "measurements of a kind")
            if block.num_nodes != self.num_nodes:
                said = f"are of {block.num_nodes} nodes, the graph has {self.num_nodes}"
                raise GraphError(f"{block.kind.plural} {said}")
        if len({type(block) for block in self.blocks}) < len(self.blocks):
            raise GraphError("measurements of one kind are given together")

    # --- Nodes ------------------------------------------------------------------------------------

    @property
    def num_nodes(self) -> int:  # type: ignore[override]
        """Number n of nodes, numbered 0 ... n-1."""
        return len(self.nodes)

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.rotations.shape[-1])

    @cached_property
    def has_positions(self) -> bool:
        """Whether nodes have positions, as all have that are no rotations alone."""
        return not (self.nodes == Node.ROTATION).all()

    @cached_property
    def has_scales(self) -> bool:
        """Whether some scales are unknown, or measured to differ."""
        return bool(self.free.any() or (self.scales != 1.0).any())

    @property
    def kind(self) -> Literal["poses", "rotations"]:
        """What is measured."""
        return "poses" if self.has_positions else "rotations"

    @cached_property
    def is_point(self) -> BoolArray:
        """(n,) which nodes are points, such as landmarks."""
        return frozen_flags(self.nodes == Node.POINT)

    @cached_property
    def free(self) -> BoolArray:
        """(n,) which nodes have an unknown scale."""
        return frozen_flags(self.nodes == Node.SCALED)

    @cached_property
    def has_others(self) -> bool:
        """Whether some nodes are of kinds that this package has none of, see `is_other`."""
        return bool(self.nodes.max() > Node.SCALED)

    @property
    def is_other(self) -> BoolArray:
        """(n,) which nodes are of kinds that this package has none of."""
        return frozen_flags(self.nodes > Node.SCALED)

    @cached_property
    def pose_nodes(self) -> IntArray:
        """The nodes that are no points, ascending."""
        return np.flatnonzero(~self.is_point)

    @property
    def in_mean_unit(self) -> bool:
        """Whether no pose has a known scale, and the unit is the root mean square of all."""
        return self.has_scales and bool(self.free[self.pose_nodes].all())

    # --- Measurements -----------------------------------------------------------------------------

    @property
    def num_edges(self) -> int:
        """Number m of edges, parallel ones counted."""
        return len(self.edges)

    @property
    def pairs(self) -> IntArray:
        """(m + k, 2) the nodes of all measurements: of the edges, then of the blocks."""
        if not self.blocks:
            return self.edges
        return np.concatenate([self.edges, *(block.edges for block in self.blocks)])

    @property
    def ranges(self) -> Ranges | None:
        """The distances; None for none."""
        return next((block for block in self.blocks if type(block) is Ranges), None)

    @cached_property
    def measures_rotation(self) -> BoolArray:
        """(m,) which edges measure a rotation."""
        return frozen_flags(self.kappa > 0.0)

    @cached_property
    def measures_translation(self) -> BoolArray:
        """(m,) which edges measure a translation."""
        return frozen_flags(self.tau != 0.0)

    @property
    def from_world(self) -> BoolArray:
        """(m,) which edges are known to measure from a world, see `certpgo.with_priors`."""
        return np.zeros(self.num_edges, dtype=bool) if self.absolute is None else self.absolute

    @property
    def world(self) -> int | None:
        """The only node that is known to be measured from as a world; None without one."""
        worlds = np.unique(self.edges[self.from_world, 0])
        return int(worlds[0]) if len(worlds) == 1 else None

    @property
    def is_measured(self) -> BoolArray:
        """(m,) which edges are measurements: all that are not `assumed`."""
        return np.ones(self.num_edges, dtype=bool) if self.assumed is None else ~self.assumed

    @property
    def num_measurements(self) -> int:
        """How many edges are measurements."""
        return int(np.count_nonzero(self.is_measured))

    @cached_property
    def kinds(self) -> IntArray:
        """(m,) what each edge measures, a `certpgo.graph.kinds.Kind`."""
        return np.where(self.is_measured, kinds_of(self, self.from_world), Kind.ASSUMED)

    @cached_property
    def is_partial(self) -> bool:
        """Whether nodes have positions, and some edges measure a rotation or translation alone."""
        both = self.measures_rotation & self.measures_translation
        return self.has_positions and not both.all()

    @property
    def has_couplings(self) -> bool:
        """Whether edges have couplings."""
        return self.couplings is not None

    @property
    def has_matrix_weights(self) -> bool:
        """Whether edges have couplings or arms, as those with matrix weights do."""
        return self.arms is not None or self.couplings is not None

    @property
    def is_general(self) -> bool:
        """Whether edges have arms or couplings, or measure only a rotation or a translation."""
        return self.has_matrix_weights or self.is_partial

    @cached_property
    def polar(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Factors P, K and K' (m, d, d) of the couplings: N = P K = K' P, P orthogonal, K >= 0."""
        if self.couplings is None:
            K = self.kappa[:, None, None] * np.eye(self.d)
            return self.rotations, K, K
        return polar_factors(self.couplings)

    @property
    def coupled(self) -> FloatArray:
        """(m, d, d) couplings N: kappa R_ij where edges are isotropic."""
        if self.couplings is None:
            return np.asarray(self.kappa[:, None, None] * self.rotations)
        return self.couplings

    @property
    def own_arms(self) -> FloatArray:
        """(m, d) arms, zeros where there are none."""
        return np.zeros((self.num_edges, self.d)) if self.arms is None else self.arms

    @property
    def steps(self) -> FloatArray:
        """(m, d) from node i to j in the frame of i, as the measured rotations have it."""
        if self.arms is None:
            return self.translations
        turned = (self.rotations @ self.arms[:, :, None])[:, :, 0]
        return np.asarray(self.translations - turned)

    @property
    def information_matrices(self) -> FloatArray:
        """(m, p, p) the information matrices of the edges; a GraphError if there are none."""
        if self.information is None:
            raise GraphError("these measurements have no information matrices")
        return self.information.matrices

    @property
    def is_definite(self) -> BoolArray:
        """(m,) which information matrices are proven to be positive definite, without zero rows."""
        if self.information is None:
            return frozen_flags(np.zeros(self.num_edges))
        return self.information.is_definite
