"""Common to robust methods: weights that keep a graph connected, and the final fit."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.priors import free_rotations, levers
from certpgo.graph.trees import minimum_spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.progress import Progress
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution

#: Measurements over those of a tree, below which a fit means little.
MEANINGFUL = 1.1
#: Weight of a temporarily rejected measurement: it determines nodes without a better one.
FAINT = 1e-9


def connected(problem: Quadratic, weights: FloatArray, costs: FloatArray) -> FloatArray:
    """The weights (m,) with as few zeros set to one as keep the graph connected.

    If all measurements between a part of the graph and the rest are rejected, the one of lowest
    ``costs`` (m,) is kept. Its residual is then zero at the optimum, whatever its weight. Where
    some edges measure only a rotation or a translation, both kinds stay connected as they were.
    """
    graph, lengths = problem.graph, np.ones(len(weights))
    rejected = np.flatnonzero(weights <= 0.0)
    lengths[rejected[np.argsort(costs[rejected], kind="stable")]] += 1.0 + np.arange(len(rejected))
    if not (graph.has_positions and graph.is_partial):
        tree = minimum_spanning_tree(graph, lengths)
        return np.where((weights <= 0.0) & np.isin(lengths, tree.data), 1.0, weights)
    for kind in (graph.measures_translation, graph.measures_rotation):
        if not kind.any():
            continue
        tree = minimum_spanning_tree(graph.with_edges(kind), lengths[kind])
        restored = (weights <= 0.0) & kind & np.isin(lengths, tree.data)
        weights = np.where(restored, 1.0, weights)
    _hold(graph, weights, costs)
    return weights


def _hold(graph: Graph, weights: FloatArray, costs: FloatArray) -> None:
    """Restore measurements of lowest cost until each rotation is determined by one."""
    for node in np.flatnonzero(free_rotations(graph, weights > 0.0)):
        holding = np.zeros(len(weights), dtype=bool)
        for end, holds in zip(graph.edges.T, levers(graph), strict=True):
            holding |= holds & (end == node)
        weights[np.flatnonzero(holding)[np.argmin(costs[holding])]] = 1.0


def fitted(
    problem: Quadratic, kept: BoolArray, point: Estimate, progress: Progress, *, note: str = ""
) -> Solution:
    """The stationary point near ``point`` for the kept measurements, with weights of 1 and 0.

    Parameters
    ----------
    kept : (m,) which measurements; more are kept if the graph would be disconnected
    progress : of the method that chose them
    note : what else a reader should know
    """
    costs = problem.edge_costs(point)
    weights = connected(problem, np.where(kept, 1.0, 0.0), costs)
    with progress.watch.phase("newton"):
        point = newton(problem.reweighted(weights), point, NewtonSettings(tolerance=1e-9)).estimate
    note = "; ".join(filter(None, (note, remark(problem, weights))))
    return progress.solution(point, problem.cost(point), note=note, weights=weights)


def remark(problem: Quadratic, weights: FloatArray) -> str:
    """What a reader should know about the kept measurements; empty if nothing is unusual."""
    kept, n = int((weights > 0.0).sum()), problem.n
    if kept == problem.graph.num_edges:
        return "no measurement was rejected"
    if kept < MEANINGFUL * (n - 1):
        return f"{kept} measurements of {n} nodes are hardly more than a tree, which always fits"
    return ""
