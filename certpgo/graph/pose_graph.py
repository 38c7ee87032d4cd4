"""Graphs of relative poses, and of points that poses see."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np

from certpgo.errors import GraphError, require
from certpgo.graph.display import Speaking
from certpgo.graph.edges import (
    Keep,
    broadcast,
    check_matrices,
    check_weights,
    chosen_nodes,
    edge_name,
    induced,
    simple_edges,
    symmetric,
)
from certpgo.graph.information import Information
from certpgo.graph.kinds import Kind, kinds_of, places_world
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import components_in_words, ranges_of_weights, size_in_words, solving
from certpgo.graph.picture import circle_of, closures, drawn
from certpgo.graph.ranges import Ranges
from certpgo.graph.rotation_graph import OfRotations, RotationGraph
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_flags, frozen_floats


@dataclass(frozen=True, eq=False, repr=False)
class PoseGraph(Speaking, OfRotations):
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
    points : (n,) which nodes are points, such as landmarks, rather than poses; None for none. Edges
        lead to points, have kappa = 0, and measure where the point is in the frame of node i
    assumed : (m,) which edges are no measurements, but put a world somewhere whose position nothing
        measures, or hold nodes in place; None for none
    absolute : (m,) which edges measure from a world, see `certpgo.with_priors`; None for none
    information : full information matrices, by which other programs weigh residuals; None without
        any, or with other weights. F has kappa and tau alone; a cost is a choice, see `solve`
    blocks : what else is measured between the nodes, such as `certpgo.Ranges`; one of a kind

    Raises
    ------
    GraphError
        As `RotationGraph`; or translations that are not (m, d) and finite, an edge that measures
        nothing, or one that leaves a point or measures its rotation.

    Examples
    --------
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
    has_positions: ClassVar[Literal[True]] = True
    has_scales: ClassVar[bool] = False
    is_signed: ClassVar[bool] = False  # tau may be negative, as in surrogates

    rotation: RotationGraph
    translations: FloatArray
    tau: FloatArray
    arms: FloatArray | None = None
    points: BoolArray | None = None
    assumed: BoolArray | None = None
    absolute: BoolArray | None = None
    information: Information | None = None
    blocks: tuple[Observations, ...] = ()

    _area: ClassVar[str] = "m^2"

    def __post_init__(self) -> None:
        require(self.rotation, RotationGraph, "a RotationGraph of the relative rotations")
        object.__setattr__(self, "translations", frozen_floats(self.translations))
        object.__setattr__(self, "tau", frozen_floats(self.tau))
        expected = (self.rotation.num_edges, self.rotation.d)
        if self.translations.shape != expected:
            raise GraphError(f"translations must be {expected}, not {self.translations.shape}")
        if not np.isfinite(self.translations).all():
            bad = np.asarray(~np.isfinite(self.translations).all(axis=1))
            raise GraphError(f"{edge_name(self.edges, bad)}: translation is not finite")
        self._check_tau()
        if self.arms is not None:
            object.__setattr__(self, "arms", frozen_floats(self.arms))
            check_matrices("arms", self.arms, expected, self.edges)
        if self.points is not None:
            object.__setattr__(self, "points", frozen_flags(self.points))
            self._check_points(self.points)
        for name in ("assumed", "absolute"):
            self._check_flags(name)
        self._check_besides()

    def _check_tau(self) -> None:
        check_weights("tau", self.tau, self.edges, or_none=True)
        nothing = ~self.measures_translation & ~self.measures_rotation
        if nothing.any():
            raise GraphError(f"{edge_name(self.edges, nothing)}: kappa and tau are 0")

    def _check_flags(self, name: str) -> None:
        given = getattr(self, name)
        if given is None:
            return
        flags = frozen_flags(given)
        if flags.shape != (self.num_edges,):
            raise GraphError(f"{name} must be {self.num_edges} flags, one per edge")
        object.__setattr__(self, name, flags if flags.any() else None)

    def _check_points(self, points: BoolArray) -> None:
        if points.shape != (self.num_nodes,):
            raise GraphError(f"points must be {self.num_nodes} flags, one per node")
        # From where it is, a point measures nothing but distances.
        leaving = points[self.edges[:, 0]] & self.translations.any(axis=1)
        if leaving.any():
            raise GraphError(f"{edge_name(self.edges, leaving)}: edges lead to points, not from")
        turned = points[self.edges].any(axis=1) & self.measures_rotation
        if self.arms is not None:
            turned |= points[self.edges[:, 1]] & self.arms.any(axis=1)
        if turned.any():
            raise GraphError(f"{edge_name(self.edges, turned)}: a point has no rotation")

    def _check_besides(self) -> None:
        """Refuse information matrices and distances of another graph."""
        if self.information is not None:
            self.information.require_size(self.num_edges, self.d)
            if self.rotation.is_general:
                raise GraphError("edges have matrix weights or information matrices, not both")
        for block in self.blocks:
            require(block, Observations, "measurements of a kind")
            if block.num_nodes != self.num_nodes:
                said = f"are of {block.num_nodes} nodes, the graph has {self.num_nodes}"
                raise GraphError(f"{block.kind.plural} {said}")
        if len({type(block) for block in self.blocks}) < len(self.blocks):
            raise GraphError("measurements of one kind are given together")

    def _with_besides(self, **changed: Information | tuple[Observations, ...] | None) -> Self:
        """The graph with other information or blocks; what else there is was checked."""
        other = copy(self)
        other.__dict__.update(changed)
        other._check_besides()
        return other

    def with_blocks(self, *given: Observations | None) -> Self:
        """The same edges with these measurements besides, or with none.

        An edge that assumes where a world is goes if one of them measures from that.
        """
        blocks = tuple(block for block in given if block is not None and len(block.edges))
        graph = self._with_besides(blocks=blocks)
        if self.assumed is None or not blocks:
            return graph
        needless = places_world(self)
        needless &= np.isin(self.edges[:, 0], np.concatenate([block.edges for block in blocks]))
        return graph.with_edges(~needless) if needless.any() else graph  # type: ignore[return-value]

    def with_ranges(self, ranges: Ranges | None) -> Self:
        """The same measurements with these distances, or with none."""
        require(ranges, Ranges | None, "distances, or None,")
        return self.with_blocks(*(of for of in self.blocks if type(of) is not Ranges), ranges)

    @property
    def ranges(self) -> Ranges | None:
        """The distances; None for none."""
        return next((block for block in self.blocks if type(block) is Ranges), None)

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

    def with_information(self, information: Information | FloatArray | None) -> Self:
        """The same measurements, kappa and tau with other information matrices, or without.

        Parameters
        ----------
        information : as the attribute, or (m, p, p) matrices of no program's residuals
        """
        if isinstance(information, np.ndarray):
            information = Information.of(information)
        return self._with_besides(information=information)

    def under(self, cost: str) -> Self:
        """The same measurements whose default cost, see `certpgo.solve`, is that of this name."""
        if self.information is None:
            return self
        residual = None if cost == "chordal" else cost
        return self.with_information(replace(self.information, residual=residual))

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
        return replace(
            self,
            rotation=rotation,
            translations=self.translations + turned,
            tau=tau,
            arms=arms,
            information=None,
        )

    @property
    def size_in_words(self) -> str:
        """Such as ``216 poses and 30 points, 513 edges, 3D``."""
        poses = len(self.pose_nodes)
        return size_in_words(poses, self.num_nodes - poses, self.num_measurements, self.d)

    @property
    def _headline(self) -> str:
        return f"{type(self).__name__}: {self.size_in_words}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from ranges_of_weights(self.rotation.kappa, self.tau, self._area)
        if self.arms is not None or self.rotation.is_general:
            yield "", "these are means: edges have matrix weights"
        if self.is_partial:
            yield "partial", "some edges measure a rotation or a translation alone"
        yield "connected", components_in_words(self.component_sizes)
        yield "next", solving(self.component_sizes)

    def _picture(self) -> str:
        from certpgo.graph.trees import tree_initialization

        connected = self.is_connected and not self.is_partial
        reckoned = tree_initialization(self).translations if connected else None
        if reckoned is None:
            return circle_of(self.num_nodes, self.edges)
        return drawn(reckoned, closures(self.edges), self.pose_nodes)

    @property
    def num_nodes(self) -> int:
        """Number n of poses and points."""
        return self.rotation.num_nodes

    @cached_property
    def is_point(self) -> BoolArray:
        """(n,) which nodes are points."""
        return self.rotation.is_point if self.points is None else self.points

    @cached_property
    def pose_nodes(self) -> IntArray:
        """The nodes that are poses, ascending."""
        return np.flatnonzero(~self.is_point)

    @cached_property
    def measures_translation(self) -> BoolArray:
        """(m,) which edges measure a translation."""
        return frozen_flags(self.tau != 0.0)

    @property
    def steps(self) -> FloatArray:
        """(m, d) from node i to j in the frame of i, as the measured rotations have it."""
        if self.arms is None:
            return self.translations
        turned = (self.rotation.rotations @ self.arms[:, :, None])[:, :, 0]
        return np.asarray(self.translations - turned)

    @property
    def from_world(self) -> BoolArray:
        """(m,) which edges are known to measure from a world, see `certpgo.with_priors`."""
        return self.rotation.from_world if self.absolute is None else self.absolute

    @cached_property
    def kinds(self) -> IntArray:
        """(m,) what each edge measures, a `certpgo.graph.kinds.Kind`."""
        return np.where(self.is_measured, kinds_of(self, self.from_world), Kind.ASSUMED)

    @property
    def is_measured(self) -> BoolArray:
        """(m,) which edges are measurements: all that are not `assumed`."""
        return self.rotation.is_measured if self.assumed is None else ~self.assumed

    @property
    def num_measurements(self) -> int:
        """How many edges are measurements."""
        return int(np.count_nonzero(self.is_measured))

    def with_weights(
        self, kappa: FloatArray | float | None = None, tau: FloatArray | float | None = None
    ) -> PoseGraph:
        """The same measurements with other concentrations; None keeps the current ones.

        Information matrices, which state others, are left out.
        """
        rotation = self.rotation if kappa is None else self.rotation.with_weights(kappa)
        new_tau = self.tau if tau is None else broadcast(tau, self.num_edges)
        return replace(self, rotation=rotation, tau=new_tau, information=None)

    def reweighted(self, factors: FloatArray) -> PoseGraph:
        """Concentrations and information times factors (m,); an edge with factor 0 is removed."""
        factors = broadcast(factors, self.num_edges)
        kept = factors != 0.0
        information = self.information and self.information.reweighted(factors)
        graph = self if kept.all() else self.with_information(None).with_edges(kept)
        factors = factors[kept]
        return replace(
            graph,
            rotation=graph.rotation.reweighted(factors),
            tau=factors * graph.tau,
            information=information,
        )

    def scaled(self, factor: float) -> PoseGraph:
        """All concentrations, information and other weights times ``factor``."""
        graph = self.with_information(None).reweighted(np.full(self.num_edges, factor))
        graph = graph.with_information(self.information and self.information.scaled(factor))
        return graph.with_blocks(*(block.scaled(factor) for block in self.blocks))

    def without_parallel_edges(self, keep: Keep) -> PoseGraph:
        """Keep ``"all"`` parallel edges, or the ``"first"`` or ``"last"`` of each pair {i, j}."""
        return self.with_edges(simple_edges(self.num_nodes, self.edges, keep))

    def with_edges(self, chosen: IntArray | BoolArray) -> PoseGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return self._with(self.rotation.with_edges(chosen), chosen, self.points, self.blocks)

    def subgraph(self, nodes: IntArray) -> PoseGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        nodes = chosen_nodes(nodes, self.num_nodes)
        rotation = self.rotation.subgraph(nodes)
        _, chosen = induced(self.num_nodes, self.edges, nodes)
        points = None if self.points is None else self.points[nodes]
        blocks = (block.between(nodes) for block in self.blocks)
        return self._with(rotation, chosen, points, tuple(filter(None, blocks)))

    def _with(
        self,
        rotation: RotationGraph,
        chosen: IntArray | BoolArray,
        points: BoolArray | None,
        blocks: tuple[Observations, ...],
    ) -> PoseGraph:
        arms = None if self.arms is None else self.arms[chosen]
        flags = self.assumed, self.absolute
        assumed, absolute = (None if f is None else f[chosen] for f in flags)
        t, tau = self.translations[chosen], self.tau[chosen]
        information = self.information and self.information.subset(chosen)
        return type(self)(rotation, t, tau, arms, points, assumed, absolute, information, blocks)

    @property
    def is_general(self) -> bool:
        """Whether edges have arms or couplings, or measure only a rotation or a translation."""
        return self.arms is not None or self.rotation.is_general or self.is_partial

    @cached_property
    def is_partial(self) -> bool:
        """Whether some edges measure only a rotation or only a translation."""
        return not (self.measures_rotation & self.measures_translation).all()
