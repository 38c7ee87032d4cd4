"""What robust methods share: weights that keep a graph in one piece, and the fit to the kept."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.trees import minimum_spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.problem import Problem
from certpgo.optimize.newton import NewtonSettings, newton
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

#: Measurements over those of a tree, below which a fit says little.
MEANINGFUL = 1.1
#: Weight of a measurement rejected for now: it says where nodes stand of which nothing better is
#: known.
FAINT = 1e-9


def connected(problem: Problem, weights: FloatArray, costs: FloatArray) -> FloatArray:
    """The weights (m,) with as many zeros made ones as keep the graph connected.

    Where all measurements that tie a part of the graph to the rest are rejected, one of them must
    be believed nevertheless: the cheapest, as ``costs`` (m,) have it. It alone then says how the
    part stands, so that its residual is zero at the optimum, whatever its weight.
    """
    rejected = np.flatnonzero(weights <= 0.0)
    lengths = np.ones(len(weights))
    lengths[rejected[np.argsort(costs[rejected], kind="stable")]] += 1.0 + np.arange(len(rejected))
    tree = minimum_spanning_tree(problem.graph, lengths)
    believed = (weights <= 0.0) & np.isin(lengths, tree.data)
    return np.where(believed, 1.0, weights)


def fitted(
    problem: Problem, kept: BoolArray, point: Estimate, progress: Progress, *, note: str = ""
) -> Solution:
    """The stationary point near ``point`` that fits what is kept, and weights of 1 and 0.

    Parameters
    ----------
    kept : (m,) which measurements; more are where the graph would fall apart
    progress : of the method that chose them
    note : what else a reader should know
    """
    costs = problem.edge_costs(point)
    weights = connected(problem, np.where(kept, 1.0, 0.0), costs)
    with progress.watch.phase("newton"):
        point = newton(problem.reweighted(weights), point, NewtonSettings(tolerance=1e-9)).estimate
    return Solution(
        estimate=point,
        cost=problem.cost(point),
        status=progress.status,
        iterations=progress.steps,
        seconds=progress.watch.seconds,
        trace=tuple(progress.trace),
        note="; ".join(filter(None, (note, remark(problem, weights)))),
        weights=weights,
    )


def remark(problem: Problem, weights: FloatArray) -> str:
    """What a reader should know of what was kept; empty where that is as it should be."""
    kept, n = int((weights > 0.0).sum()), problem.n
    if kept == problem.graph.num_edges:
        return "no measurement was rejected"
    if kept < MEANINGFUL * (n - 1):
        return (
            f"{kept} measurements of {n} nodes are hardly more than a tree, which any answer fits"
        )
    return ""
