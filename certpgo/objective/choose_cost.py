"""Which cost a graph has: F, or that of another program, and what it knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from certpgo.errors import InputError, SpecError, refuse, require
from certpgo.graph import Graph, Instance
from certpgo.graph.capabilities import lacking
from certpgo.graph.dataset import graph_of
from certpgo.graph.information import Information
from certpgo.graph.priors import require_determined, require_held
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.objective.costs.chordal import ChordalCost
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.quadratic import NO_SCALES, Quadratic
from certpgo.objective.similarity_sum import SimilaritySum
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_cost import TruncatedCost

if TYPE_CHECKING:
    from certpgo.objective.kernels import Kernel

#: What estimates are certified for.
Certifiable = Quadratic | Sum
#: What they are judged for, with rejections among them.
Judged = Certifiable | TruncatedCost

#: What is said of other costs there.
OF_SCALES = (
    "with nodes of unknown scale the cost is F (--cost chordal) or, of certpgo solve "
    "--scales-within, that of logarithms"
)

__all__ = [
    "CHORDAL",
    "COSTS",
    "Certifiable",
    "Judged",
    "Surrogate",
    "Sum",
    "costs_of",
    "objective_of",
    "own_cost",
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
    return own, *(cost for cost in COSTS if cost != own and _takes(graph, cost))


def _takes(graph: Graph, cost: str, *, more: bool = False) -> bool:
    """Whether a graph has what the cost needs: of F alone, no definite information matrices."""
    if cost == CHORDAL:
        return True
    if graph.information is None:
        return not (graph.has_positions or graph.has_couplings)
    return bool(graph.is_definite.all()) and not _unknown_to(cost, graph, more=more)


def _unknown_to(cost: str, graph: Graph, *, more: bool = False) -> str:
    """What is measured that the cost of another program does not know; or empty."""
    if not more and not graph.kappa.any():
        return f"--cost {cost} needs relative poses, not positions alone"
    return ""


def objective_of(
    posed: Graph | Instance | Certifiable,
    cost: str | None = None,
    kernel: Kernel | str | None = None,
) -> Certifiable:
    """What is minimised of measurements: F where it is a quadratic form, else a sum of terms.

    Parameters
    ----------
    posed : a graph or an instance; or an objective, which has its cost already and takes no other
    cost : the name of one of `COSTS`; by default that of `own_cost`
    kernel : a robust kernel of the costs of edges, or what `Kernel.parse` takes; None for none

    Raises
    ------
    SpecError
        An unknown cost, or kernel.
    InputError
        A cost of another program, and an objective that has its own, or measurements that the cost
        does not know; there are no poses or no information matrices, or some are not positive
        definite.
    """
    if cost is not None:
        require(cost, str, "the name of a cost")
    if isinstance(posed, Objective):
        if kernel is not None:
            raise InputError("a kernel is a choice for graphs: this problem has its cost already")
        return _of_own_cost(posed, cost)
    graph, said = _graph_of(posed), source_of(posed)
    if graph.has_scales and cost not in (None, CHORDAL):
        raise InputError(f"{said}{OF_SCALES}")
    chosen = own_cost(graph) if cost is None else cost
    if chosen not in COSTS:
        raise SpecError.unknown("cost", chosen, list(COSTS))
    if kernel is not None:
        return _robust(posed, chosen, kernel)
    return _under_f(posed) if chosen == CHORDAL else _under(chosen, posed)


def _robust(posed: Graph | Instance, cost: str, kernel: Kernel | str) -> Sum:
    """The sum of terms with a kernel of the costs of edges."""
    from certpgo.objective.kernels import AppliedKernel, Kernel
    from certpgo.objective.robust import RobustSum

    require(kernel, Kernel | str, "a kernel, or its name and scale such as huber:1.5,")
    chosen = Kernel.parse(kernel) if isinstance(kernel, str) else kernel
    refuse(lacking(graph_of(posed), "kernel"), source_of(posed).removesuffix(": "))
    plain = _under_f(posed) if cost == CHORDAL else _under(cost, posed)
    measured = plain.measured
    whole = Sum(measured, ChordalCost) if isinstance(plain, Quadratic) else plain
    return RobustSum.of(whole, AppliedKernel(chosen, chosen.squares(measured)))


def _under_f(measured: Graph | Instance) -> Certifiable:
    """F, a sum of terms where it is no quadratic form."""
    graph: Any = graph_of(measured)
    named = measured.named if isinstance(measured, Instance) else None
    if named is not None and graph.blocks:
        require_held(graph, named)
    elif named is not None and graph.is_partial:
        require_determined(graph, named)
    if not graph.blocks:
        return Quadratic(graph)
    return (SimilaritySum if graph.has_scales else Sum)(graph, ChordalCost)


def _of_own_cost(posed: Certifiable, cost: str | None) -> Certifiable:
    """The objective itself, unless another cost is asked for."""
    if cost not in (None, posed.cost_name):
        own = f"this problem has {posed.cost_name!r}"
        raise InputError(f"cost={cost!r} is a choice for graphs: {own}")
    if len(posed.rejected):
        raise InputError("a truncated cost is certified, not solved: take its `whole`")
    return posed


def _under(cost: str, measured: Graph | Instance) -> Sum:
    """The sum of terms with another program's cost of relative poses."""
    graph = informed(measured, cost)
    if said := _unknown_to(cost, graph):
        raise InputError(f"{source_of(measured)}{said}")
    if isinstance(measured, Instance) and graph.is_partial and not graph.blocks:
        require_determined(graph, measured.named)
    problem = Sum(weighed_by(cost, graph), COSTS[cost])
    # No path, as tables keep it.
    refuse(problem.unbounded, measured.name if isinstance(measured, Instance) else "")
    return problem


def require_poses_alone(posed: Graph | Instance) -> None:
    """Refuse, by an InputError, what is for `certpgo.solve` and `certify` alone.

    That is: blocks of other measurements, and nodes of unknown scale.
    """
    graph, said = _graph_of(posed), source_of(posed)
    if graph.blocks:
        others = graph.blocks[0].kind.plural
        for_these = "for certpgo solve, certify and merge, and sessions, alone"
        raise InputError(f"{said}graphs with {others} are {for_these}")
    if graph.has_scales:
        raise InputError(f"{said}{NO_SCALES}")


def require_scales(posed: Graph | Instance | Objective) -> None:
    """Refuse, by an InputError, what has no nodes of unknown scale, or measurements besides."""
    graph = posed.measured if isinstance(posed, Objective) else _graph_of(posed)
    if not graph.has_scales:
        raise InputError(f"{source_of(posed)}no nodes of unknown scale")
    if graph.blocks:
        others = graph.blocks[0].kind.plural
        said = "with nodes of unknown scale are for certpgo solve and certify"
        raise InputError(f"{source_of(posed)}{others} {said}")


def _graph_of(posed: object) -> Any:
    if isinstance(posed, Objective):
        return posed.graph
    require(posed, Instance | Graph, "a graph, an instance or a problem")
    return graph_of(posed)  # type: ignore[arg-type]


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


def source_of(posed: object) -> str:
    """Where an instance is from, to begin a message; empty for anything else."""
    return f"{posed.source or posed.name}: " if isinstance(posed, Instance) else ""


def informed(measured: Graph | Instance, cost: str) -> Graph:
    """The graph, if it has the information matrices of its edges.

    Of rotations alone kappa states them, as a variance of the turn about each axis does.

    Raises
    ------
    InputError
        It has none.
    """
    graph = graph_of(measured)
    if graph.information is not None:
        return graph
    if not (graph.has_positions or graph.has_couplings):
        about = COSTS[cost].rotation_information
        return graph.with_information(
            Information.isotropic(graph.kappa, 0.0 * graph.kappa, graph.d, None, about)
        )
    if graph is measured and graph.has_positions:
        given = "graph.with_information(matrices) of every edge"
        raise InputError(f"cost={cost!r} needs information: {given}")
    options = measured.options if isinstance(measured, Instance) else {}
    needed = f"--cost {cost} needs poses with information matrices on every edge"
    raise InputError(f"{source_of(measured)}{needed}; {_lack(graph, options)}")


def _lack(graph: Graph, options: Mapping[str, str]) -> str:
    """Why a graph, read with these options, has no information matrices."""
    if options.get("weights", "file") != "file":
        return "other weights were chosen"
    if options.get("rotation_information") == "rpy":
        return "those of this format are about roll, pitch and yaw"
    return "not all edges have one"
