"""The costs of other programs, edge by edge, and their minorants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from certpgo.errors import InputError, SpecError, refuse, require
from certpgo.graph import Graph, Instance
from certpgo.graph.dataset import graph_of
from certpgo.graph.kinds import Kind
from certpgo.graph.phrases import counted
from certpgo.graph.priors import require_determined, require_held
from certpgo.objective.chordal_cost import ChordalCost
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.problem import SCALED, Problem, problem_of
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_problem import TruncatedProblem

#: What estimates are certified for.
Certifiable = Problem | InformationProblem
#: What they are judged for, with rejections among them.
Judged = Certifiable | TruncatedProblem

__all__ = [
    "CHORDAL",
    "COSTS",
    "Certifiable",
    "InformationProblem",
    "Judged",
    "SimilarityProblem",
    "Surrogate",
    "certifiable",
    "costs_of",
    "edge_cost",
    "information_problem",
    "own_cost",
    "problem_under",
    "similarity_problem",
]


def own_cost(measured: Graph | Instance, *, more: bool = False) -> str:
    """The cost that the program of a graph's file minimises, if it can be certified.

    That is ``"g2o"`` for a g2o file whose information matrices are all positive definite where they
    state something, ``"gtsam"`` for such a JSON Robot Log, and ``"chordal"`` otherwise.

    Parameters
    ----------
    more : whether others are to come, so that these may be positions alone
    """
    require(measured, Instance | Graph, "a graph or an instance")
    graph = graph_of(measured)
    own = None if graph.information is None else graph.information.residual
    return own if own is not None and own in COSTS and _takes(graph, own, more=more) else CHORDAL


def costs_of(instance: Instance) -> tuple[str, ...]:
    """The costs that an instance can be certified under, that of `own_cost` first."""
    require(instance, Instance, "an Instance")
    own, graph = own_cost(instance), instance.graph
    known = (CHORDAL, *(cost for cost in COSTS if _takes(graph, cost)))
    return own, *(cost for cost in known if cost != own)


def _takes(graph: Graph, cost: str, *, more: bool = False) -> bool:
    """Whether a graph has poses and definite information matrices alone, and the cost takes it."""
    if not graph.has_positions:
        return False
    return bool(graph.is_definite.all()) and not _unknown_to(cost, graph, more=more)


def _unknown_to(cost: str, graph: Graph, *, more: bool = False) -> str:
    """What is measured that the cost of another program does not know; or empty."""
    if not more and not graph.kappa.any():
        return f"--cost {cost} needs relative poses, not positions alone"
    if COSTS[cost].decoupled:  # minorants have no arms of their own: their sum with others is exact
        return ""
    if graph.arms is not None:
        said = f"the cost of {cost} knows no sensors apart from their bodies, and no held poses"
        return f"{said} (--cost g2o and chordal do)"
    if alone := int(np.count_nonzero(graph.kinds == Kind.TRANSLATION)):
        measured = counted(alone, Kind.TRANSLATION.phrase)
        return f"the cost of {cost} needs rotations with its {measured}"
    return ""


def problem_under(
    posed: Graph | Instance | Problem | InformationProblem, cost: str | None = None
) -> Problem | InformationProblem:
    """The problem under a cost: ``"chordal"``, or see `information_problem`.

    Parameters
    ----------
    posed : a graph or an instance; or a problem, which has its cost already and takes no other
    cost : by default that of `own_cost`

    Raises
    ------
    InputError
        A cost of another program, and a problem that has its own, or no information matrices; or an
        instance with measurements of other kinds, which are `certifiable`'s.
    """
    if cost is not None:
        require(cost, str, "the name of a cost")
    said = source_of(posed)
    unposed = _graph_of(posed)
    if unposed.blocks:
        others = unposed.blocks[0].kind.plural
        for_these = "for certpgo solve, certify and merge, and sessions, alone"
        raise InputError(f"{said}graphs with {others} are {for_these}")
    if unposed.has_scales:
        raise InputError(f"{said}{SCALED}")
    if isinstance(posed, Objective):
        if cost not in (None, posed.cost_name):
            own = f"this problem has {posed.cost_name!r}"
            raise InputError(f"cost={cost!r} is a choice for graphs: {own}")
        if len(posed.rejected):
            raise InputError("a truncated cost is certified, not solved: take its `whole`")
        return posed
    graph = graph_of(posed)
    if isinstance(posed, Instance) and graph.is_partial:
        require_determined(graph, posed.named)
    chosen = own_cost(graph) if cost is None else cost
    if chosen not in (CHORDAL, *COSTS):
        raise SpecError.unknown("cost", chosen, [CHORDAL, *COSTS])
    return problem_of(graph) if chosen == CHORDAL else information_problem(posed, chosen)


def certifiable(
    posed: Graph | Instance | Certifiable | SimilarityProblem, cost: str | None = None
) -> Certifiable:
    """The problem as of `problem_under`, of measurements of any kinds."""
    if isinstance(posed, SimilarityProblem):
        return posed
    graph = _graph_of(posed)
    if graph.has_scales:
        return similarity_problem(posed, cost)
    if graph.blocks:
        return _problem_of_blocks(cast("Graph | Instance", posed), cost)
    return problem_under(posed, cost)


def _problem_of_blocks(measured: Graph | Instance, cost: str | None) -> Certifiable:
    """The problem of measurements of several kinds."""
    chosen, graph = own_cost(measured) if cost is None else cost, graph_of(measured)
    if chosen not in (CHORDAL, *COSTS):
        raise SpecError.unknown("cost", chosen, [CHORDAL, *COSTS])
    if chosen != CHORDAL:
        return information_problem(measured, chosen)
    if isinstance(measured, Instance):
        require_held(graph, measured.named)
    if graph.has_couplings:
        lacks = "are for isotropic weights, not for matrix weights or directions alone"
        raise InputError(f"{source_of(measured)}measured {graph.blocks[0].kind.plural} {lacks}")
    return InformationProblem(edge_cost(graph, CHORDAL))


def _graph_of(posed: object) -> Any:
    graph = getattr(posed, "graph", posed)
    require(graph, Graph, "a graph, an instance or a problem")
    return graph


def similarity_problem(
    posed: Graph | Instance | Certifiable | SimilarityProblem, cost: str | None = None
) -> SimilarityProblem:
    """The problem of a graph with nodes of unknown scale, or of an instance with one.

    Raises
    ------
    InputError
        No scale is unknown; it has distances too; or a cost of another program.
    """
    source = source_of(posed)
    if cost not in (None, CHORDAL):
        said = "with nodes of unknown scale the cost is F (--cost chordal) or, of certpgo solve "
        said += "--scales-within, that of logarithms"
        raise InputError(f"{source}{said}")
    if isinstance(posed, SimilarityProblem):
        return posed
    graph = _graph_of(posed)
    if not graph.has_scales:
        raise InputError(f"{source}no nodes of unknown scale")
    if isinstance(posed, Instance) and graph.is_partial:
        require_determined(graph, posed.named)
    return SimilarityProblem(graph)


def information_problem(measured: Graph | Instance, cost: str) -> InformationProblem:
    """The problem of measurements under the cost of another program.

    Parameters
    ----------
    measured : with information matrices, as read from a file that has some
    cost : the name of one of `COSTS`, such as ``"g2o"`` or ``"gtsam"``

    Raises
    ------
    SpecError
        An unknown cost.
    InputError
        There are no poses or no information matrices, or some are not positive definite.
    """
    require(measured, Instance | Graph, "a graph or an instance")
    require(cost, str, "the name of a cost")
    if cost not in COSTS:
        raise SpecError.unknown("cost", cost, list(COSTS))
    graph = informed(measured, cost)
    if said := _unknown_to(cost, graph):
        raise InputError(f"{source_of(measured)}{said}")
    graph = weighed_by(cost, graph)
    problem = InformationProblem(edge_cost(graph, cost))
    # No path, as tables keep it.
    refuse(problem.unbounded, measured.name if isinstance(measured, Instance) else "")
    return problem


def weighed_by(cost: str, graph: Graph) -> Graph:
    """Measurements with the kappa of a cost, which knows what rotational information is about.

    That is so whatever was said when the file was read.
    """
    information, about = graph.information, COSTS[cost].rotation_information
    if graph.d == 2 or information is None or information.about == about:
        return graph
    factors = np.full(graph.num_edges, 0.25 if about == "quaternion" else 4.0)
    stated = replace(information, about=about)
    return replace(graph, kappa=factors * graph.kappa, information=stated)


def edge_cost(graph: Graph, cost: str) -> EdgeCost:
    """The cost of that name in `COSTS`, for measurements of poses, positions or rotations."""
    if not (graph.is_partial or graph.blocks):
        return COSTS[cost](graph)
    return Sum(graph, ChordalCost if cost == CHORDAL else COSTS[cost])


def source_of(posed: object) -> str:
    """Where an instance is from, to begin a message; empty for anything else."""
    return f"{posed.source or posed.name}: " if isinstance(posed, Instance) else ""


def informed(measured: Graph | Instance, cost: str) -> Graph:
    """The graph, if it has poses and their information matrices.

    Raises
    ------
    InputError
        It has none.
    """
    graph = graph_of(measured)
    if graph.information is not None:
        return graph
    options = measured.options if isinstance(measured, Instance) else {}
    needed = f"--cost {cost} needs poses with information matrices on every edge"
    raise InputError(f"{source_of(measured)}{needed}; {_lack(graph, options)}")


def _lack(graph: Graph, options: Mapping[str, str]) -> str:
    """Why a graph, read with these options, has no information matrices."""
    if not graph.has_positions:
        return "these are rotations alone"
    if options.get("weights", "file") != "file":
        return "other weights were chosen"
    if options.get("rotation_information") == "rpy":
        return "those of this format are about roll, pitch and yaw"
    return "not all edges have one"
