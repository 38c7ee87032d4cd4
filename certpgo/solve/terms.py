"""The cost whose terms a session adds up: F, or an edge cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from certpgo.certify import certificate
from certpgo.errors import GraphError, InputError, SpecError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.capabilities import FEATURES
from certpgo.graph.dataset import graph_of
from certpgo.graph.graph import require_connected
from certpgo.graph.kinds import Node
from certpgo.graph.priors import require_determined
from certpgo.graph.ranges import Ranges
from certpgo.graph.scale import Scale
from certpgo.objective.choose_cost import (
    CHORDAL,
    COSTS,
    OF_SCALES,
    informed,
    own_cost,
    source_of,
    weighed_by,
)
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.enclosure import enclosure
from certpgo.objective.exact_fit import fits_exactly, meets, meets_blocks
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.similarity_sum import IN_KNOWN_UNIT, NO_UNIT, SimilaritySum
from certpgo.objective.sum import Sum
from certpgo.objective.term import term_of
from certpgo.objective.terms import (
    Placed,
    edges_under,
    enclosure_of,
    scale_of,
    terms_of,
    title_of,
    with_rows,
)
from certpgo.solve.odometry import Track

#: What there is not beside nodes of unknown scale.
NOT_SCALED = "matrix weights", "arms"


@dataclass(frozen=True)
class Terms:
    """A cost by name, for measurements that need not connect their nodes.

    Attributes
    ----------
    cost : the name of one of `certpgo.objective.costs`
    features : of the measurements so far, see `certpgo.graph.capabilities.FEATURES`
    """

    cost: str
    features: frozenset[str] = frozenset()

    @classmethod
    def chosen(cls, cost: str | None, first: Graph | Instance | None = None) -> Terms:
        """The cost of this name; by default `own_cost` of the first measurements.

        Raises
        ------
        SpecError
            There is no such cost.
        """
        if cost is None:
            return cls(CHORDAL if first is None else own_cost(first, more=True))
        if cost not in COSTS:
            raise SpecError.unknown("cost", cost, list(COSTS))
        return cls(cost)

    def part(self, measured: Graph | Instance, track: Track | None = None) -> Graph:
        """The measurements, if they have what the cost needs.

        Parameters
        ----------
        track : the nodes of those before

        Raises
        ------
        InputError
            They have no information matrices, or some that are not positive definite; or there are
            nodes of unknown scale, and what is not taken with them.
        """
        if said := self._unscaled(graph_of(measured), track):
            raise InputError(f"{source_of(measured)}{said}")
        if self.cost == CHORDAL:
            graph = graph_of(measured)
            _ = self._terms(graph)  # refuses what has none
            return graph.under(CHORDAL)
        graph = informed(measured, self.cost)
        bad, information = np.flatnonzero(~graph.is_definite), graph.information
        if len(bad) and information is not None:
            i, j = graph.edges[bad[0]].tolist()
            ids = measured.ids if isinstance(measured, Instance) else np.arange(graph.num_nodes)
            raise InputError(
                f"{source_of(measured)}the information matrix of {ids[i]}-{ids[j]} is "
                f"{information.indefinite}: the cost of {self.cost} has no lower bound "
                "there, the chordal cost has"
            )
        return weighed_by(self.cost, graph.under(self.cost))

    def after(self, graph: Graph) -> Terms:
        """The same cost, when these measurements have come."""
        others = FEATURES.keys() - self.features
        found = {name for name in others if FEATURES[name].is_in(graph)}
        return replace(self, features=self.features | found) if found else self

    def _unscaled(self, graph: Graph, track: Track | None) -> str:
        """What does not go with nodes of unknown scale, in a sentence; or empty."""
        if not graph.has_scales and "scales" not in self.features:
            return ""
        found = self.after(graph).features
        if self.cost != CHORDAL:
            return OF_SCALES
        if found & {"distances", "own kinds"} and not _has_unit(graph, track):
            return NO_UNIT
        for block in graph.blocks:
            if not isinstance(block, Ranges) and graph.free[block.edges[:, 0]].any():
                return f"{term_of(block).plural} are measured in a frame of unknown scale"
        others = [FEATURES[name].called for name in NOT_SCALED if name in found]
        return f"nodes of unknown scale do not go with {others[0]}" if others else ""

    def upper(self, graph: Graph, estimate: Estimate) -> float:
        """The cost of an estimate, rounded up."""
        terms = self._terms(graph)
        if terms is None:
            return _enclosure(graph, estimate)[1]
        if not graph.has_scales:
            return enclosure_of(terms, estimate)[1]
        own, m = _enclosure(graph.with_blocks(), estimate)[1], graph.num_edges
        others = [Placed(rows - m, term) for rows, term in terms if rows[0] >= m]
        return math.nextafter(own + enclosure_of(others, estimate)[1], math.inf)

    def fits(self, graph: Graph, estimate: Estimate) -> bool:
        """Whether an estimate meets all measurements, so that its cost is rounding."""
        if not graph.has_scales:
            return meets(graph, estimate)
        of_edges = Quadratic(graph.with_blocks(), is_part=True)
        return fits_exactly(of_edges, estimate) and meets_blocks(graph, estimate)

    def problem(self, graph: Graph, named: Callable[[int], str]) -> Quadratic | Sum:
        """The problem of measurements, of nodes that are called so.

        Raises
        ------
        GraphError
            They do not determine all nodes, or another program's cost is of positions alone.
        """
        if self._is_quadratic(graph):
            return chordal_problem(graph, named)
        if self.cost != CHORDAL and not graph.kappa.any():
            needed = "needs relative poses, not positions alone, which cost='chordal' takes"
            raise GraphError(f"cost={self.cost!r} {needed}")
        _require_determined(with_rows(graph), named)
        return (SimilaritySum if graph.has_scales else Sum)(graph, COSTS[self.cost])

    def scale(self, graph: Graph) -> Scale:
        """What W is made of."""
        terms = self._terms(graph)
        return Scale.of(graph) if terms is None else scale_of(terms)

    def title(self, graphs: Sequence[Graph]) -> str:
        """The cost in words."""
        if not graphs:
            return certificate.CHORDAL
        # the first with most kinds of measurements
        most = max(graphs, key=lambda of: (len(of.blocks), not of.kappa.all()))
        if not self._is_quadratic(most):
            title = title_of(self._of_edges(most), most.blocks)
            return f"{title}{IN_KNOWN_UNIT}" if "scales" in self.features else title
        scaled = next((graph for graph in graphs if graph.has_scales), None)
        return certificate.CHORDAL if scaled is None else Quadratic(scaled, is_part=True).title

    def _is_quadratic(self, graph: Graph) -> bool:
        """Whether the cost of measurements is F, of poses alone."""
        return not graph.has_positions or (self.cost == CHORDAL and not graph.blocks)

    def _of_edges(self, graph: Graph) -> EdgeCost:
        return edges_under(graph, COSTS[self.cost])

    def _terms(self, graph: Graph) -> tuple[Placed, ...] | None:
        """Those of measurements; None for F of poses alone."""
        if self._is_quadratic(graph):
            return None
        return terms_of(self._of_edges(graph), graph.blocks)


def _has_unit(graph: Graph, track: Track | None) -> bool:
    """Whether some pose has a known scale, of these measurements or of those before."""
    kinds = graph.nodes[np.unique(graph.pairs)]
    known = bool(np.isin(kinds, (Node.SCALED, Node.POINT), invert=True).any())
    return known or (track is not None and not track.mean_over)


def _enclosure(graph: Graph, estimate: Estimate) -> tuple[float, float]:
    """Bounds on F, in the unit of these measurements where scales are unknown."""
    if graph.has_scales:
        return Quadratic(graph, is_part=True).enclosure(estimate)
    return enclosure(graph, estimate)


def chordal_problem(graph: Graph, named: Callable[[int], str]) -> Quadratic:
    """The problem of F, of nodes that are called so."""
    _require_determined(graph, named)
    return Quadratic(graph)


def _require_determined(graph: Graph, named: Callable[[int], str]) -> None:
    if graph.is_partial:
        require_connected(graph)
        require_determined(graph, named)
