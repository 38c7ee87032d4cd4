"""Measurement graphs: what is measured between nodes, a row each, with the weights of every cost.

Arrays are validated at construction and read-only afterwards. The convention everywhere: R_i is
world <- body i, an edge (i, j) measures R_ij ~ R_i^T R_j and t_ij ~ R_i^T (t_j - t_i).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from certpgo.errors import GraphError, InputError, require
from certpgo.graph import matrix_weights
from certpgo.graph.display import Speaking
from certpgo.graph.edges import (
    Keep,
    broadcast,
    check_matrices,
    check_weights,
    chosen_nodes,
    components_of,
    flags_of_nodes,
    induced,
    simple_edges,
)
from certpgo.graph.graph_data import GraphData
from certpgo.graph.information import Information
from certpgo.graph.kinds import Measurements, Node, places_world
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import (
    components_in_words,
    counted,
    listed,
    ranges_of_weights,
    size_in_words,
    solving,
)
from certpgo.graph.picture import circle_of, closures, drawn
from certpgo.graph.ranges import Ranges
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    chosen_rows,
    frozen_floats,
    frozen_indices,
)

#: What is computed of nodes and edges, whatever their weights.
_CONNECTIVITY = ("components", "component_sizes")
_OF_NODES = ("has_positions", "has_scales", "has_others", "is_point", "free", "pose_nodes")
_OF_WEIGHTS = ("measures_rotation", "measures_translation", "is_partial")
#: Attributes without a row for each edge.
_OF_ALL = ("nodes", "blocks", "is_signed")


@dataclass(frozen=True, eq=False, repr=False)
class Graph(Speaking, GraphData):
    """Relative rotations, poses or similarities between nodes, and what else is measured.

    `certpgo.RotationGraph`, `certpgo.PoseGraph` and `certpgo.SimilarityGraph` make one.

    Attributes
    ----------
    nodes : (n,) what each node is, see ``certpgo.graph.kinds.NODES``; all are rotations alone, or
        none
    edges : (m, 2) node pairs (i, j); parallel edges are allowed, their terms add
    rotations : (m, d, d) measured R_ij ~ R_i^T R_j, d = 2 or 3; a matrix of few digits is replaced
        by the nearest rotation
    kappa : (m,) rotational concentrations, between 2^-400 and 2^400; or 0 for an edge that measures
        the translation alone
    translations : (m, d) measured t_ij ~ R_i^T (t_j - t_i), metres; in the unit of a node of
        unknown scale
    tau : (m,) translational concentrations, 1/m^2, between 2^-400 and 2^400; or 0 for an edge that
        measures the rotation alone
    couplings : (m, d, d) matrices N of general edges, whose terms are tr(K) + tr(K') - 2 <N, Q>,
        Q = R_i^T R_j, with K and K' the symmetric polar factors of N; None for N = kappa R_ij,
        where that is kappa ||R_j - R_i R_ij||_F^2. See `with_matrix_weights`
    arms : (m, d) points a of general edges, in the frame of pose j, whose terms are
        tau |t_j + R_j a - t_i - R_i t_ij|^2; metres. None for zeros
    scales : (m,) measured s_ij ~ s_j / s_i, positive; by default ones
    assumed : (m,) which edges are no measurements, but put a world somewhere whose position nothing
        measures, or hold nodes in place; None for none
    absolute : (m,) which edges measure from a world, see `certpgo.with_priors`; None for none
    information : full information matrices, by which other programs weigh residuals; None without
        any, or with other weights. F has kappa and tau alone; a cost is a choice, see `solve`
    blocks : what else is measured between the nodes, such as `certpgo.Ranges`; one of a kind
    is_signed : whether tau may be negative, and edges may measure nothing, as in surrogates

    Raises
    ------
    GraphError
        An index out of range, a self-loop, a matrix not a rotation, a weight out of range, an array
        of another shape; an edge that measures nothing, or one that leaves a point or measures its
        rotation; weights that are not isotropic beside scales.

    Examples
    --------
    A graph says what it holds, and which nodes are what:

    >>> import numpy as np
    >>> import certpgo
    >>> rotation = certpgo.RotationGraph(3, [[0, 1], [1, 2]], [np.eye(2)] * 2, kappa=[1.0, 0.0])
    >>> steps, lamp = np.ones((2, 2)), np.array([False, False, True])
    >>> graph = certpgo.PoseGraph(rotation, steps, np.ones(2), points=lamp)
    >>> isinstance(graph, certpgo.Graph), graph.is_point.tolist(), graph.size_in_words
    (True, [False, False, True], '2 poses and 1 point, 2 edges, 2D')
    """

    @cached_property
    def rotations_alone(self) -> Graph:
        """The graph of the relative rotations."""
        if not self.has_positions:
            return self
        m, d = self.num_edges, self.d
        alone: Graph = object.__new__(Graph)
        alone.__dict__.update(
            nodes=frozen_indices(np.full(self.num_nodes, Node.ROTATION)),
            edges=self.edges,
            rotations=self.rotations,
            kappa=self.kappa,
            translations=frozen_floats(np.zeros((m, d))),
            tau=frozen_floats(np.zeros(m)),
            couplings=self.couplings,
            scales=frozen_floats(np.ones(m)),
            has_positions=False,
            has_scales=False,
        )
        return self.sharing(alone, "polar", "components")

    def sharing(self, other: Graph, *names: str) -> Graph:
        """Another graph of the same edges, with what was computed of this one."""
        known = {name: self.__dict__[name] for name in names if name in self.__dict__}
        other.__dict__.update(known)
        return other

    @classmethod
    def trusted(cls, **arrays: Any) -> Self:
        """The graph of arrays whose rows are known to be in order; how they go together is checked.

        Parameters
        ----------
        arrays : the attributes, but for those that have their defaults
        """
        for array in arrays.values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
        graph: Self = object.__new__(cls)
        defaults = {"couplings": None, "arms": None, "assumed": None, "absolute": None}
        graph.__dict__.update({**defaults, "information": None, "blocks": (), "is_signed": False})
        graph.__dict__.update(arrays)
        graph._check_scales()
        graph._check_besides()
        return graph

    def _with(self, **changed: Any) -> Self:
        """The graph with some attributes that are known to be in order."""
        other: Self = object.__new__(type(self))
        other.__dict__.update({one.name: getattr(self, one.name) for one in fields(self)})
        other.__dict__.update(changed)
        self.sharing(other, *_CONNECTIVITY, *_OF_NODES)
        return other

    def with_blocks(self, *given: Observations | None) -> Self:
        """The same edges with these measurements besides, or with none.

        An edge that assumes where a world is goes if one of them measures from that.
        """
        blocks = tuple(block for block in given if block is not None and len(block.edges))
        graph = self._with(blocks=blocks)
        graph._check_besides()
        if self.assumed is None or not blocks:
            return graph
        needless = places_world(self)
        of_blocks = [block.edges.ravel() for block in blocks if block.places]
        needless &= np.isin(self.edges[:, 0], np.concatenate([*of_blocks, []]))
        return graph.with_edges(~needless) if needless.any() else graph

    def with_ranges(self, ranges: Ranges | None) -> Self:
        """The same measurements with these distances, or with none."""
        require(ranges, Ranges | None, "distances, or None,")
        return self.with_blocks(*(of for of in self.blocks if type(of) is not Ranges), ranges)

    def with_information(self, information: Information | FloatArray | None) -> Self:
        """The same measurements, kappa and tau with other information matrices, or without.

        Parameters
        ----------
        information : as the attribute, or (m, p, p) matrices of no program's residuals
        """
        if information is not None and not isinstance(information, Information):
            information = Information.of(frozen_floats(information))
        graph = self._with(information=information)
        graph._check_besides()
        return graph

    def under(self, cost: str) -> Self:
        """The same measurements whose default cost, see `certpgo.solve`, is that of this name."""
        residual = None if cost == "chordal" else cost
        if self.information is None or self.information.residual == residual:
            return self
        other = self._with(information=self.information.of_residual(residual))
        self.sharing(other, *_OF_WEIGHTS)
        return other

    def with_weights(
        self, kappa: FloatArray | float | None = None, tau: FloatArray | float | None = None
    ) -> Self:
        """The same measurements with other concentrations; None keeps the current ones.

        Information matrices and couplings, which state others, are left out.
        """
        changed: dict[str, Any] = {}
        if kappa is not None:
            changed |= {"kappa": broadcast(kappa, self.num_edges), "couplings": None}
        if tau is not None:
            changed["tau"] = broadcast(tau, self.num_edges)
        return replace(self, **changed, information=None)

    def with_matrix_weights(self, W: FloatArray) -> Self:
        """The same measurements with terms tr(E W E^T).

        Parameters
        ----------
        W : of poses (m, d + 1, d + 1), of rotations alone (m, d, d), symmetric positive definite;
            see `certpgo.graph.matrix_weights`

        Raises
        ------
        GraphError
            One is not.
        InputError
            There are scales.
        """
        if self.has_positions:
            return matrix_weights.of_poses(self, W)
        return matrix_weights.of_rotations(self, W)

    def with_unknown_scales(self, free: BoolArray) -> Self:
        """The same measurements where these poses (n,) have an unknown scale, and no others.

        Raises
        ------
        GraphError
            There are more or fewer flags, or one is of a point.
        """
        free = flags_of_nodes("free", free, self.num_nodes)
        if (free & self.is_point).any():
            node = int(np.argmax(free & self.is_point))
            raise GraphError(f"node {node}: a point has no scale")
        nodes = np.where(free, Node.SCALED, np.where(self.free, Node.POSE, self.nodes))
        return replace(self, nodes=nodes)

    def in_units_of(self, scales: FloatArray) -> Self:
        """The measurements where node i has a unit s_i times its own, and kappa is in these units.

        Estimates of the two graphs differ by the scales alone. Of an estimate's scales, the unknown
        ones are then near 1, and a rotation's residual counts in the unit of node j, that of a
        translation in node i's: the weights are kappa / s_j^2 and tau / s_i^2 in the world's.

        Parameters
        ----------
        scales : (n,) positive, 1 for poses of known scale
        """
        i, j = self.edges.T
        return replace(
            self,
            translations=scales[i, None] * self.translations,
            tau=self.tau / scales[i] ** 2,
            scales=self.scales * scales[i] / scales[j],
        )

    def reweighted(self, factors: FloatArray) -> Self:
        """Concentrations and information times factors (m,); an edge with factor 0 is removed."""
        factors = broadcast(factors, self.num_edges)
        kept = factors != 0.0
        information = self.information and self.information.reweighted(factors)
        graph = self if kept.all() else self.with_information(None).with_edges(kept)
        return graph._weighed(factors[kept], information, graph.blocks)

    def scaled(self, factor: float) -> Self:
        """All concentrations, information and other weights times ``factor``, which is positive."""
        information = self.information and self.information.scaled(factor)
        blocks = tuple(block.scaled(factor) for block in self.blocks)
        return self._weighed(np.full(self.num_edges, factor), information, blocks)

    def _weighed(
        self,
        factors: FloatArray,
        information: Information | None,
        blocks: tuple[Observations, ...],
    ) -> Self:
        """Concentrations times positive factors (m,), with other information and blocks."""
        other = self._with(
            kappa=frozen_floats(factors * self.kappa),
            tau=frozen_floats(factors * self.tau),
            information=information,
            blocks=blocks,
        )
        if (N := self.couplings) is not None:
            N = frozen_floats(factors[:, None, None] * N)
            check_matrices("couplings", N, self.rotations.shape, self.edges)
            other = other._with(couplings=N)
        check_weights("kappa", other.kappa, other.edges, or_none=True)
        other._check_tau()
        return other

    def without_parallel_edges(self, keep: Keep) -> Self:
        """Keep ``"all"`` parallel edges, or the ``"first"`` or ``"last"`` of each pair {i, j}."""
        return self.with_edges(simple_edges(self.num_nodes, self.edges, keep))

    def with_edges(self, chosen: IntArray | BoolArray) -> Self:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return replace(self, **self._rows(chosen_rows(chosen, self.num_edges, "edges")))

    def subgraph(self, nodes: IntArray) -> Self:
        """The graph induced on ``nodes``, renumbered in that order."""
        nodes = chosen_nodes(nodes, self.num_nodes)
        edges, chosen = induced(self.num_nodes, self.edges, nodes)
        blocks = tuple(filter(None, (block.between(nodes) for block in self.blocks)))
        rows = self._rows(chosen) | {"edges": edges}
        return replace(self, **rows, nodes=self.nodes[nodes], blocks=blocks)

    def _rows(self, chosen: IntArray | BoolArray) -> dict[str, Any]:
        """Some rows of all arrays that have one for each edge."""
        names = (one.name for one in fields(self) if one.name not in _OF_ALL)
        arrays = {name: getattr(self, name) for name in names}
        return {name: values[chosen] for name, values in arrays.items() if values is not None}

    # --- Words ------------------------------------------------------------------------------------

    @property
    def size_in_words(self) -> str:
        """Such as ``216 poses and 30 points, 513 edges, 3D``."""
        poses, m = len(self.pose_nodes), self.num_measurements
        said = size_in_words(poses, self.num_nodes - poses, m, self.d, kind=self.kind)
        unknown = counted(int(self.free.sum()), "unknown scale{s}")
        return f"{said}, {unknown}" if self.has_scales else said

    @property
    def _headline(self) -> str:
        return f"{type(self).__name__}: {self.size_in_words}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from ranges_of_weights(
            self.kappa, self.tau, "square unit" if self.has_scales else "m^2"
        )
        if self.has_matrix_weights:
            yield "", "these are means: edges have matrix weights"
        if self.is_partial:
            yield "partial", "some edges measure a rotation or a translation alone"
        if self.has_scales:
            low, high = self.scales.min(), self.scales.max()
            yield "scales", f"relative scales {low:.4g} to {high:.4g}"
        if self.blocks:
            others = (counted(of.num_measurements, of.kind.phrase) for of in self.blocks)
            yield "measured", f"{listed([*others])}, besides the edges"
        sizes = np.bincount(components_of(self.num_nodes, self.pairs)).tolist()
        yield "connected", components_in_words(sizes)
        yield "next", solving(sizes)

    def _picture(self) -> str:
        from certpgo.graph.trees import tree_initialization

        draws = self.has_positions and self.is_connected and not self.is_partial
        reckoned = tree_initialization(self).translations if draws else None
        if reckoned is None:
            return circle_of(self.num_nodes, self.edges)
        return drawn(reckoned, closures(self.edges), self.pose_nodes)


def require_connected(graph: Graph | Measurements) -> None:
    """Refuse a disconnected graph by a GraphError with the component sizes, largest first."""
    if not graph.is_connected:
        sizes = tuple(sorted(graph.component_sizes, reverse=True))
        shown = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
        raise GraphError(
            f"the graph has {len(sizes)} components of {shown} nodes; it must be connected",
            component_sizes=sizes,
        )


def require_positions(graph: object) -> None:
    """Refuse anything but a graph whose nodes have positions, by an InputError."""
    require(graph, Graph, "a graph of poses")
    if isinstance(graph, Graph) and not graph.has_positions:
        raise InputError("a graph of poses expected, not of rotations alone")


def length_unit(graph: Graph) -> str:
    """The unit of lengths, in words: metres, but with nodes of unknown scale the map's own."""
    return "units" if graph.has_scales else "m"
