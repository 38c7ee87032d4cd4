"""Measurements that cannot all be right: rejected ones against others, and disjoint cores.

If all measurements of a set are right and their noise is as stated, the least cost of the set is
to first order a sum of independent squares, of as many numbers as are measured beyond those that
determine the nodes. So a set whose cost is proven to be above the quantile 1 - ``level`` of that
sum contains a wrong measurement, unless something of probability ``level`` has happened.

A measurement with others that determine its ends already adds as many numbers as it measures. Sets
that share no measurement each contain a wrong one: so many are wrong at least.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from scipy import special
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from certpgo.certify.leave_one_out import worth_keeping
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.rises import rises
from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.errors import GraphError
from certpgo.graph import Estimate, Graph
from certpgo.graph.succession import Succession
from certpgo.graph.trees import tree_initialization
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.costs import CHORDAL
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.progress import Stop
from certpgo.solve.rejection_bounds import optimum_of_kept
from certpgo.solve.selection import Posed

#: Length of a trusted measurement, over that of another one.
FAITH = 0.1
#: Probability that right measurements are called inconsistent.
LEVEL = 1e-6


def budgets(problem: Posed, level: float = LEVEL, scale: float = 1.0) -> FloatArray:
    """(m,) what the term of a right measurement exceeds with probability ``level`` at most.

    In the plane a rotation's square counts twice in F, and here so do those of translations.

    Parameters
    ----------
    scale : standard deviation of the noise over that stated by the weights
    """
    turned, moved = problem.numbers
    most = np.where(turned > 0, problem.double, 1)
    return np.asarray(scale**2 * most * 2.0 * special.gammainccinv(0.5 * (turned + moved), level))


def proven_rises(problem: TruncatedCost, estimate: Estimate, stop: Stop) -> FloatArray:
    """(k,) by how much the cost rises at least if a rejected measurement is taken back."""
    normalized = replace(NormalizedProblem.of(problem, "standard", RTOL, ATOL), stop=stop)
    point = optimum_of_kept(normalized, estimate)
    return np.asarray(normalized.unit * rises(normalized, point))


def proven_worth(
    problem: TruncatedCost, estimate: Estimate, prices: FloatArray, stop: Stop
) -> BoolArray:
    """(m,) which kept measurements cost more if they are left out, each for its price, proven."""
    normalized = replace(NormalizedProblem.of(problem, "standard", RTOL, ATOL), stop=stop)
    return worth_keeping(normalized, estimate, prices / normalized.unit)


def odometry(graph: Graph, order: Succession) -> BoolArray:
    """(m,) the first whole measurements from each pose to the next one, not from a world."""
    chosen = np.zeros(graph.num_edges, dtype=bool)
    next_to = _whole(graph) & order.are_steps(graph.edges)
    if graph.absolute is not None:
        next_to &= ~graph.absolute
    steps = np.flatnonzero(next_to)
    _, first = np.unique(order.places[graph.edges[steps]].min(axis=1), return_index=True)
    chosen[steps[first]] = True
    return chosen


def rises_over(
    problem: Posed, trusted: BoolArray, doubtful: IntArray, stop: Stop
) -> FloatArray | None:
    """(k,) by how much the cost of trusted measurements rises at least with one doubtful one.

    None if those leave nodes free.

    Parameters
    ----------
    trusted : (m,) which are, such as odometry
    doubtful : (k,) indices of others
    """
    if not trusted.any():
        return None
    factors, prices = np.zeros((2, problem.graph.num_edges))
    factors[trusted] = factors[doubtful] = 1.0
    prices[:] = np.inf
    prices[doubtful] = 1.0
    chosen = factors > 0.0
    try:
        posed = TruncatedCost(problem.reweighted(factors), prices[chosen])
    except GraphError:
        return None
    along = problem.measured.with_edges(trusted[: problem.measured.num_edges])
    return proven_rises(posed, tree_initialization(along), stop)


def cores(
    problem: Posed,
    kept: BoolArray,
    doubtful: IntArray,
    budget: FloatArray,
    stop: Stop,
    trusted: BoolArray | None = None,
) -> list[IntArray]:
    """Sets of measurements that cannot all be right, each proven: the indices of each.

    A doubtful measurement with a path between its ends, of kept measurements; short paths come
    first. No two sets share a measurement that is not trusted.

    Parameters
    ----------
    kept : (m,) the measurements that paths may use
    doubtful : (k,) the others
    budget : (m,) see `budgets`
    trusted : (m,) which measurements are taken to be right; none by default
    """
    graph, found = problem.measured, list[IntArray]()
    kept = kept[: graph.num_edges]
    shared = np.zeros_like(kept) if trusted is None else trusted[: graph.num_edges]
    free, waiting = kept & _whole(graph), doubtful[doubtful < graph.num_edges].tolist()
    while waiting and not stop.should_stop():
        paths = _Paths(graph, free, np.where(shared, FAITH, 1.0))
        ways = {}
        for e in waiting:
            way = None if stop.should_stop() else paths.between(*graph.edges[e])
            if way is not None:
                ways[e] = way
        waiting = []
        for e in sorted(ways, key=lambda e: len(ways[e])):
            if not free[ways[e]].all():
                waiting.append(e)  # another set has taken a part of it
            elif not stop.should_stop() and _is_inconsistent(
                problem, ways[e], e, float(budget[e]), stop
            ):
                free[ways[e]] = shared[ways[e]]
                found.append(np.r_[ways[e], e])
    return found


def _whole(graph: Graph) -> BoolArray:
    """(m,) which edges are of all that a node has."""
    if graph.kind == "poses":
        return np.asarray(graph.measures_rotation & graph.measures_translation)
    return graph.measures_rotation


def _is_inconsistent(problem: Posed, path: IntArray, edge: int, budget: float, stop: Stop) -> bool:
    """Whether a measurement and a path between its ends are proven not to be right together."""
    chosen = np.r_[path, edge]
    nodes = np.unique(problem.graph.edges[chosen])
    # A subgraph has its edges in the order of the whole one.
    cycle = _part(problem, chosen, nodes)
    prices = np.r_[np.full(len(path), np.inf), budget]
    posed = TruncatedCost(cycle, prices)
    along = tree_initialization(cycle.measured.with_edges(np.arange(len(path))))
    return bool(proven_rises(posed, along, stop)[0] > budget)


def _part(problem: Posed, edges: IntArray, nodes: IntArray) -> Posed:
    """The problem of some measurements between some nodes."""
    graph = problem.measured.with_blocks().with_edges(edges).subgraph(nodes)
    if problem.cost_name == CHORDAL:
        return Quadratic(graph, problem.engine)
    return replace(cast("Sum", problem), measured=graph)


class _Paths:
    """The shortest paths in some measurements of a graph."""

    def __init__(self, graph: Graph, free: BoolArray, lengths: FloatArray) -> None:
        known = np.flatnonzero(free)
        known = known[np.argsort(-lengths[known], kind="stable")]
        #: The shortest measurement between two nodes.
        self.edge = {
            pair: e
            for e, (i, j) in zip(known.tolist(), graph.edges[known].tolist(), strict=True)
            for pair in ((i, j), (j, i))
        }
        i, j = np.array([*self.edge]).reshape(-1, 2).T
        n = graph.num_nodes
        values = lengths[np.array([*self.edge.values()], dtype=int)]
        self.links = csr_array((values, (i, j)), shape=(n, n))

    def between(self, start: int, end: int) -> IntArray | None:
        """Indices of the measurements of a path; None if there is none."""
        _, before = dijkstra(self.links, indices=start, return_predecessors=True)
        found, node = [], int(end)
        while node != start:
            earlier = int(before[node])
            if earlier < 0:
                return None
            found.append(self.edge[earlier, node])
            node = earlier
        return np.array(found)
