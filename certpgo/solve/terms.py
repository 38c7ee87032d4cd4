"""The cost whose terms a session adds up: F, or an edge cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from certpgo.certify import certificate
from certpgo.errors import GraphError, InputError, SpecError
from certpgo.graph import Estimate, Graph, Instance, PoseGraph
from certpgo.graph.concatenate import joined
from certpgo.graph.graph import require_connected
from certpgo.graph.information import InformationGraph
from certpgo.graph.priors import require_determined
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import BoolArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, COSTS, edge_cost, own_cost, weighed_by
from certpgo.objective.enclosure import enclosure
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.problem import Problem, problem_of

#: The number of an edge that is no measurement, but puts a world somewhere.
ASSUMED = -1
#: Measurements with what their cost needs.
Part = Graph | InformationGraph


@dataclass(frozen=True)
class Terms:
    """A cost by name, for measurements that need not connect their nodes.

    Attributes
    ----------
    cost : ``"chordal"`` or the name of one of `certpgo.objective.costs`
    """

    cost: str

    @classmethod
    def chosen(cls, cost: str | None, first: Graph | Instance | None = None) -> Terms:
        """The cost of this name; by default an instance's `own_cost`, and F for graphs.

        Raises
        ------
        SpecError
            There is no such cost.
        """
        if cost is None:
            return cls(own_cost(first) if isinstance(first, Instance) else CHORDAL)
        if cost not in (CHORDAL, *COSTS):
            raise SpecError.unknown("cost", cost, [CHORDAL, *COSTS])
        return cls(cost)

    def part(self, measured: Graph | Instance) -> Part:
        """Measurements with what the cost needs.

        Raises
        ------
        InputError
            They have no information matrices, or some that are not positive definite.
        """
        graph = measured.graph if isinstance(measured, Instance) else measured
        if self.cost == CHORDAL:
            return graph
        information = measured.information if isinstance(measured, Instance) else None
        if information is None or not isinstance(graph, PoseGraph):
            needed = "poses with information matrices on every edge"
            raise InputError(f"cost={self.cost!r} needs {needed}, as certpgo.read gives them")
        bad = np.flatnonzero(~information.is_definite)
        if len(bad):
            i, j = graph.edges[bad[0]].tolist()
            ids = measured.ids if isinstance(measured, Instance) else np.arange(graph.num_nodes)
            raise InputError(
                f"the information matrix of {ids[i]}-{ids[j]} is not positive definite: the cost "
                f"of {self.cost} has no lower bound there, the chordal cost has"
            )
        options = measured.options if isinstance(measured, Instance) else {}
        return weighed_by(self.cost, graph, information, options)

    def upper(self, part: Part, estimate: Estimate) -> float:
        """The cost of an estimate, rounded up."""
        if isinstance(part, InformationGraph):
            return edge_cost(part, self.cost).enclosure(estimate)[1]
        return enclosure(part, estimate)[1]

    def problem(self, part: Part, named: Callable[[int], str]) -> Problem | InformationProblem:
        """The problem of measurements, of nodes that are called so.

        Raises
        ------
        GraphError
            They do not determine all nodes, or another program's cost is of positions alone.
        """
        if isinstance(part, InformationGraph):
            if not part.rotation.kappa.any():
                raise GraphError(f"cost={self.cost!r} needs relative poses, not positions alone")
            _require_determined(part.isotropic, named)
            return InformationProblem(edge_cost(part, self.cost))
        return chordal_problem(part, named)

    def title(self, parts: Sequence[Part]) -> str:
        """The cost in words."""
        own = [part for part in parts if isinstance(part, InformationGraph)]
        if not own:
            return certificate.CHORDAL
        with_positions = (part for part in own if not part.rotation.kappa.all())
        return edge_cost(next(with_positions, own[0]), self.cost).title


def measurements_of(part: Part) -> Graph:
    """The graph alone."""
    return part.isotropic if isinstance(part, InformationGraph) else part


def numbered_from(part: Part, first: int) -> list[int]:
    """Numbers of measurements, from the first one's; `ASSUMED` for edges that are none."""
    measured = measurements_of(part).is_measured
    numbers = np.where(measured, first + np.cumsum(measured) - 1, ASSUMED)
    return [int(number) for number in numbers]


def chordal_problem(graph: Graph, named: Callable[[int], str]) -> Problem:
    """The problem of F, of nodes that are called so."""
    _require_determined(graph, named)
    return problem_of(graph)


def _require_determined(graph: Graph, named: Callable[[int], str]) -> None:
    if isinstance(graph, PoseGraph) and graph.is_partial:
        require_connected(graph)
        require_determined(graph, named)


def with_measurements(part: Part, graph: Graph) -> Part:
    """The part with another graph of the same edges, perhaps without those that are assumed."""
    if graph.num_edges < part.num_edges:
        part = part.with_edges(measurements_of(part).is_measured)
    if isinstance(part, InformationGraph) and isinstance(graph, PoseGraph):
        return replace(part, isotropic=graph)
    return graph


def scale_of(part: Part) -> Scale:
    """What W is made of."""
    return part.scales if isinstance(part, InformationGraph) else Scale.of(part)


def gathered(
    parts: Sequence[Part],
    num_nodes: int,
    points: BoolArray | None = None,
    edges: Sequence[IntArray] | None = None,
) -> Part:
    """All measurements, see `certpgo.graph.concatenate.joined`."""
    graph = joined([measurements_of(part) for part in parts], num_nodes, points, edges)
    matrices = [part.information for part in parts if isinstance(part, InformationGraph)]
    if not (matrices and isinstance(graph, PoseGraph)):
        return graph
    return InformationGraph(graph, np.concatenate(matrices))
