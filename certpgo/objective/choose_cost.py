"""The costs of other programs, edge by edge, and their minorants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.errors import InputError, SpecError
from certpgo.graph import Graph, Instance, PoseGraph
from certpgo.graph.information import Information, InformationGraph
from certpgo.graph.kinds import Kind
from certpgo.graph.phrases import counted
from certpgo.graph.priors import require_determined, require_held
from certpgo.graph.similarity_graph import SimilarityGraph
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.information_problem import InformationProblem, Surrogate, surrogate
from certpgo.objective.position_costs import WithPositions
from certpgo.objective.problem import SCALED, Problem, problem_of
from certpgo.objective.range_problem import RangeProblem
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.objective.truncated_problem import TruncatedProblem

#: What estimates are certified for.
Certifiable = Problem | InformationProblem | RangeProblem
#: What they are judged for, with rejections among them.
Judged = Certifiable | TruncatedProblem

__all__ = [
    "CHORDAL",
    "COSTS",
    "Certifiable",
    "InformationProblem",
    "Judged",
    "RangeProblem",
    "SimilarityProblem",
    "Surrogate",
    "certifiable",
    "costs_of",
    "edge_cost",
    "information_problem",
    "own_cost",
    "problem_under",
    "range_problem",
    "similarity_problem",
    "surrogate",
]


def own_cost(instance: Instance) -> str:
    """The cost that the program of an instance's file minimises, if it can be certified.

    That is ``"g2o"`` for a g2o file whose information matrices are all positive definite where they
    state something, ``"gtsam"`` for such a JSON Robot Log, and ``"chordal"`` otherwise.
    """
    own = None if instance.information is None else instance.information.residual
    return own if own is not None and own in COSTS and _takes(instance, own) else CHORDAL


def costs_of(instance: Instance) -> tuple[str, ...]:
    """The costs that an instance can be certified under, that of `own_cost` first."""
    own = own_cost(instance)
    others = COSTS if instance.ranges is None else ()
    known = (CHORDAL, *(cost for cost in others if _takes(instance, cost)))
    return own, *(cost for cost in known if cost != own)


def _takes(instance: Instance, cost: str) -> bool:
    """Whether an instance has poses and definite information matrices alone, and the cost both."""
    information, graph = instance.information, instance.graph
    if information is None or not isinstance(graph, PoseGraph):
        return False
    return bool(information.is_definite.all()) and not _unknown_to(cost, instance, graph)


def _unknown_to(cost: str, instance: Instance, graph: PoseGraph) -> str:
    """What is measured that the cost of another program does not know; or empty."""
    if not graph.rotation.kappa.any():
        return f"--cost {cost} needs relative poses, not positions alone"
    if COSTS[cost].decoupled:  # minorants have no arms of their own: their sum with others is exact
        return ""
    if graph.arms is not None:
        said = f"the cost of {cost} knows no sensors apart from their bodies, and no held poses"
        return f"{said} (--cost g2o and chordal do)"
    if alone := int(instance.measurements.are(Kind.TRANSLATION).sum()):
        measured = counted(alone, Kind.TRANSLATION.phrase)
        return f"the cost of {cost} needs rotations with its {measured}"
    return ""


def problem_under(
    posed: Graph | Instance | InformationProblem, cost: str | None = None
) -> Problem | InformationProblem:
    """The problem under a cost: ``"chordal"``, or see `information_problem`.

    Parameters
    ----------
    posed : a graph or an instance; or a problem, which has its cost already and takes no other
    cost : by default that of `own_cost` for an instance, and ``"chordal"`` for a graph

    Raises
    ------
    InputError
        A cost of another program, and no instance; or an instance with distances, which is
        `range_problem`'s.
    """
    if isinstance(posed, Instance) and posed.ranges is not None:
        raise InputError(
            f"{posed.source or posed.name}: graphs with distances are for certpgo solve and "
            "certify alone, in the cost F"
        )
    if isinstance(_graph_of(posed), SimilarityGraph):
        said = f"{posed.source or posed.name}: " if isinstance(posed, Instance) else ""
        raise InputError(f"{said}{SCALED}")
    if isinstance(posed, Instance):
        cost = own_cost(posed) if cost is None else cost
        if isinstance(posed.graph, PoseGraph) and posed.graph.is_partial:
            require_determined(posed.graph, posed.named)
    if cost not in (None, CHORDAL):
        if cost not in COSTS:
            raise SpecError.unknown("cost", str(cost), [CHORDAL, *COSTS])
        if not isinstance(posed, Instance):
            said = f"cost={cost!r} needs the instance that was read, with its information"
            raise InputError(said)
        return information_problem(posed, cost)
    if isinstance(posed, InformationProblem):
        return posed
    return problem_of(posed.graph if isinstance(posed, Instance) else posed)


def certifiable(
    posed: Graph | Instance | InformationProblem | RangeProblem | SimilarityProblem,
    cost: str | None = None,
) -> Certifiable:
    """The problem as of `problem_under`, `range_problem` or `similarity_problem`."""
    if isinstance(posed, RangeProblem | SimilarityProblem):
        return posed
    if isinstance(_graph_of(posed), SimilarityGraph):
        return similarity_problem(posed, cost)
    if isinstance(posed, Instance) and posed.ranges is not None:
        return range_problem(posed, cost)
    return problem_under(posed, cost)


def _graph_of(
    posed: Graph | Instance | InformationProblem | RangeProblem | SimilarityProblem,
) -> object:
    return getattr(posed, "graph", posed)


def similarity_problem(
    posed: Graph | Instance | InformationProblem | RangeProblem | SimilarityProblem,
    cost: str | None = None,
) -> SimilarityProblem:
    """The problem of a graph with nodes of unknown scale, or of an instance with one.

    Raises
    ------
    InputError
        No scale is unknown; it has distances too; or a cost of another program.
    """
    source = f"{posed.source or posed.name}: " if isinstance(posed, Instance) else ""
    if isinstance(posed, Instance) and posed.ranges is not None:
        raise InputError(f"{source}distances are not for nodes of unknown scale")
    if cost not in (None, CHORDAL):
        said = "with nodes of unknown scale the cost is F (--cost chordal) or, of certpgo solve "
        said += "--scales-within, that of logarithms"
        raise InputError(f"{source}{said}")
    if isinstance(posed, SimilarityProblem):
        return posed
    graph = _graph_of(posed)
    if not isinstance(graph, SimilarityGraph):
        raise InputError(f"{source}no nodes of unknown scale")
    if isinstance(posed, Instance) and graph.is_partial:
        require_determined(graph, posed.named)
    return SimilarityProblem(graph)


def range_problem(instance: Instance, cost: str | None = None) -> RangeProblem:
    """The problem of an instance with distances.

    Raises
    ------
    InputError
        It has none, or measures rotations alone; or a cost of another program.
    """
    source = instance.source or instance.name
    if instance.ranges is None or not isinstance(instance.graph, PoseGraph):
        raise InputError(f"{source}: no distances between poses")
    if cost not in (None, CHORDAL):
        raise InputError(f"{source}: with distances there is only the cost F (--cost chordal)")
    require_held(instance.graph, instance.named)
    return RangeProblem(instance.graph, instance.ranges)


def information_problem(instance: Instance, cost: str) -> InformationProblem:
    """The problem of an instance under the cost of another program.

    Parameters
    ----------
    instance : as read from a file with information matrices
    cost : the name of one of `COSTS`, such as ``"g2o"`` or ``"gtsam"``

    Raises
    ------
    SpecError
        An unknown cost.
    InputError
        There are no poses or no information matrices, or some are not positive definite.
    """
    if cost not in COSTS:
        raise SpecError.unknown("cost", cost, list(COSTS))
    source = instance.source or instance.name
    if not isinstance(instance.graph, PoseGraph) or instance.information is None:
        needed = f"--cost {cost} needs poses with information matrices on every edge"
        raise InputError(f"{source}: {needed}; {_lack(instance)}")
    if said := _unknown_to(cost, instance, instance.graph):
        raise InputError(f"{source}: {said}")
    graph = weighed_by(cost, instance.graph, instance.information, instance.options)
    problem = InformationProblem(edge_cost(graph, cost))
    problem.refuse_indefinite(instance.name)  # no path, as tables keep it
    return problem


def weighed_by(
    cost: str, graph: PoseGraph, information: Information, options: Mapping[str, Any]
) -> InformationGraph:
    """Measurements with the weights of a cost, which knows what rotational information is of.

    So does its kappa, whatever was said when the file was read.

    Parameters
    ----------
    options : with which the file was read
    """
    if graph.d == 3:
        read = options.get("rotation_information", "tangent")
        halved = [one == "quaternion" for one in (read, COSTS[cost].rotation_information)]
        factors = np.full(graph.num_edges, 4.0 ** (halved[0] - halved[1]))
        graph = replace(graph, rotation=graph.rotation.reweighted(factors))
    return InformationGraph(graph, information.matrices)


def edge_cost(graph: InformationGraph, cost: str) -> EdgeCost:
    """The cost of that name in `COSTS`, for measurements of poses, positions or rotations."""
    if not graph.isotropic.is_partial:
        return COSTS[cost](graph)
    return WithPositions(graph, COSTS[cost])


def _lack(instance: Instance) -> str:
    """Why an instance has no information matrices."""
    options = instance.options
    if not isinstance(instance.graph, PoseGraph):
        return "these are rotations alone"
    if options.get("weights", "file") != "file":
        return "other weights were chosen"
    if options.get("rotation_information") == "rpy":
        return "those of this format are about roll, pitch and yaw"
    return "not all edges have one"
