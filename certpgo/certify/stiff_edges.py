"""Measurements that are no stiffer than bounds need.

The measurement of a bridge is met exactly at the optimum, whatever its weight, and one of huge
weight in a cycle is almost. So a smaller weight changes the optimum by nothing, or next to nothing,
and the cost is nowhere above what it was: a bound on it is one on the given cost. Rounding in the
certificate matrix, which is relative to the weights of a node, then is that of the measurements
that disagree.
"""

from __future__ import annotations

from typing import Any, TypeVar, cast

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.bridges import bridges
from certpgo.graph.scale import typical
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.truncated_cost import TruncatedCost

#: How many times the typical weight of other measurements a bridge may have, and one in a cycle,
#: which then loses about one over that of the cost.
BRIDGE, IN_CYCLE = 2.0**10, 2.0**21

AnyProblem = TypeVar("AnyProblem", bound=Any)


def eased(problem: AnyProblem, *, cycles: bool = True) -> AnyProblem:
    """The problem with the weights of stiff measurements lowered by powers of two; often itself.

    Parameters
    ----------
    cycles : whether also in cycles, which moves the optimum a little
    """
    if isinstance(problem, TruncatedCost):
        # Not its surrogate: minorants may be below zero, and lower weights would raise these, were
        # it by rounding.
        whole = eased(problem.whole, cycles=cycles)
        same = whole is problem.whole
        return problem if same else cast("AnyProblem", TruncatedCost(whole, problem.prices))
    if problem.takes_scales:
        return problem
    graph = problem.graph
    weights = graph.kappa, graph.tau
    if not any(_may_be_stiff(w[w > 0.0], graph.num_nodes) for w in weights):
        return problem
    pair, cut = np.array([graph.num_nodes, 1]), bridges(graph)
    is_bridge = np.isin(np.sort(graph.edges, axis=1) @ pair, cut @ pair)
    stiffness = np.zeros(graph.num_edges)
    for w in weights:
        others = w[~is_bridge]
        usual = typical(others if (others > 0.0).any() else w)
        stiffness = np.maximum(stiffness, w / usual)
    most = np.where(is_bridge, BRIDGE, IN_CYCLE if cycles else np.inf)
    # Lower negative weights would be larger.
    stiff = (stiffness > most) & np.all([w >= 0.0 for w in weights], axis=0)
    if not stiff.any():
        return problem
    factors, left = np.ones(graph.num_edges), np.where(is_bridge, 1.0, IN_CYCLE)
    factors[stiff] = np.exp2(-np.ceil(np.log2((stiffness / left)[stiff])))
    try:
        return cast("AnyProblem", problem.reweighted(factors))
    except GraphError:  # the other weights of an edge would be below the range
        return problem


def _may_be_stiff(weights: FloatArray, num_nodes: int) -> bool:
    """Whether a weight is large against what is typical, whichever measurements are bridges."""
    if not len(weights):
        return False
    least = max(len(weights) - num_nodes + 1, 0) // 4  # bridges are fewer than nodes
    return bool(weights.max() > BRIDGE * np.partition(weights, least)[least])
