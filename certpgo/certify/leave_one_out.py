"""Which kept measurements are proven to be worth keeping, each against all choices without it.

Leaving a kept measurement out costs its price c_e. That is never cheaper, whatever else changes, if
the optimum x of f_T is also that of the cost in which its term is min(f_e, c_e): by the bound of
`certpgo.certify.truncated_bound` with an edge of negative weight instead of f_e, which has its
value and its gradient at x. It takes W off S, the certificate matrix with all kept measurements,
where

    tr(E (D^-1 - W^-1)^-1 E^T) <= c_e,    W > D,    E = F - M:

for W = G^-1, G its resistance, the left side bounds by how much f_T falls without the measurement.
A bound for many measurements at once is one for each of them, since min(f_e, c_e) <= f_e.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo.certify.resistances import FULL, Resistances, together
from certpgo.certify.truncated_bound import Truncated, below_with, bound_with
from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.bridges import bridges
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.truncated import Truncation
from certpgo.objective.truncated_cost import TruncatedCost

#: Columns of measurements that are grouped at once.
MANY = 1500


def worth_keeping(normalized: Truncated, estimate: Estimate, prices: FloatArray) -> BoolArray:
    """(m,) which kept measurements cost more if they are left out, proven; False for rejected ones.

    Up to the tolerance, over all estimates and all choices of rejected measurements.
    False where the estimate is not certified, or a stop was requested before.

    Parameters
    ----------
    estimate : an optimum of the truncated cost
    prices : (m,) of all measurements, in normalized units; only those of kept ones count

    Raises
    ------
    InputError
        The cost is that of another program.
    """
    problem = normalized.problem
    if not problem.whole.is_chordal:
        raise InputError("kept measurements are proven to be worth keeping under F alone")
    kept = np.flatnonzero(~problem.is_rejected)
    proven = np.zeros(len(prices), dtype=bool)
    W_rejected = problem.truncation(estimate).plain()
    # Not a bound by other weights: S has to be that of the bound.
    cost = normalized.cost_upper(estimate)
    least = cost - normalized.tolerance(cost)
    if not _holds(normalized, estimate, cost, least, W_rejected):
        return proven
    proven[kept] = _is_bridge(problem, kept)
    below = below_with(problem, estimate, W_rejected)
    own = Truncation.at_point(problem.graph.with_edges(kept), prices[kept], estimate)
    found = Resistances.of(below, below.certificate_matrix(below.multipliers(estimate)), own)
    if found is None:
        return proven
    W, loads = own.dropping(found.blocks)
    size = max(MANY // found.b, 1)
    order = np.flatnonzero((loads < FULL) & ~proven[kept])
    parts = [order[k : k + size] for k in range(0, len(order), size)]
    whole = W + own.weights
    waiting = [g for part in parts for g in together(found, whole, part, FULL - loads[part])]
    while waiting and not normalized.stop.should_stop():
        group = waiting.pop()
        priced = problem.prices.copy()
        priced[kept[group]] = prices[kept[group]]
        with_group = replace(normalized, problem=TruncatedCost(problem.whole, priced))
        weights = np.zeros((len(priced), found.b, found.b))
        weights[problem.rejected], weights[kept[group]] = W_rejected, W[group]
        weights = weights[with_group.problem.rejected]
        if _holds(with_group, estimate, cost, least, weights):
            proven[kept[group]] = True
        elif len(group) > 1:
            waiting += [group[::2], group[1::2]]
    return proven


def _holds(truncated: Truncated, point: Estimate, cost: float, least: float, W: FloatArray) -> bool:
    """Whether nothing costs less than that."""
    bound = bound_with(truncated, point, cost, W)
    return bound is not None and bound.value >= least


def _is_bridge(problem: TruncatedCost, kept: IntArray) -> BoolArray:
    """(k,) which measurements fit in any case, as nothing else checks them, rejected or not."""
    graph = problem.graph
    pairs = np.sort(graph.edges, axis=1)
    alone = {tuple(pair) for pair in bridges(graph).tolist()}
    return np.array([tuple(pair) in alone for pair in pairs[kept].tolist()], dtype=bool)
