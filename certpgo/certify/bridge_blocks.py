"""Bounds from the parts of a graph between its bridges.

The measurement of a bridge is met exactly at the optimum, as its sides move like rigid bodies. So
F* is the sum of the parts' optima, and lower bounds add up too: M is the sum of the parts' M and
the bridges' terms, which are >= 0, so multipliers of the parts, with zeros elsewhere, are
multipliers of the whole. Rounding in a part is relative to its own weights and arms, not to those
of a long bridge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certpgo.certify.dual import DualBound
from certpgo.graph.bridges import bridges
from certpgo.graph.edges import components_of
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import IntArray
from certpgo.objective.quadratic import Quadratic


@dataclass(frozen=True, eq=False)
class Part:
    """A part without bridges.

    Attributes
    ----------
    nodes : (k,) indices of its nodes in the graph
    problem : problem of the measurements among them
    """

    nodes: IntArray
    problem: Quadratic

    def point(self, whole: Point) -> Point:
        """A point of the whole graph restricted to the part, with its best translations."""
        point = whole.subset(self.nodes)
        if self.problem.has_positions:
            point = point.with_translations(np.zeros(point.rotations.shape[:2]))
        return self.problem.with_optimal_translations(point)


def parts(problem: Quadratic) -> list[Part]:
    """The parts with at least two nodes; none if the graph has no bridge, or has partial edges."""
    graph = problem.graph
    if graph.is_partial:
        return []  # a part may not determine its nodes
    cut = bridges(graph)
    if not len(cut):
        return []
    pair = np.array([graph.num_nodes, 1])
    kept = ~np.isin(np.sort(graph.edges, axis=1) @ pair, cut @ pair)
    labels = components_of(graph.num_nodes, graph.edges[kept])
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return [
        Part(nodes, Quadratic(graph.subgraph(nodes), problem.engine))
        for nodes in groups
        if len(nodes) > 1
    ]


def outside(problem: Quadratic, found: list[Part]) -> float:
    """The share of the graph's weight or length (the larger share) outside all parts."""
    weight = 1.0 - math.fsum(part.problem.scale for part in found) / problem.scale
    total = _length(problem)
    inside = math.fsum(_length(part.problem) for part in found)
    return max(weight, 1.0 - inside / total if total > 0.0 else 0.0)


def _length(problem: Quadratic) -> float:
    if not problem.has_positions:
        return 0.0
    return float(np.linalg.norm(problem.graph.translations, axis=1).sum())


def sum_of_bounds(
    problem: Quadratic, found: list[Part], bound_of: Callable[[Part], DualBound | None]
) -> DualBound | None:
    """The bound of the whole graph from its parts; None if no part has one."""
    multipliers = np.zeros((problem.n, problem.d, problem.d))
    bounds = []
    for part in found:
        bound = bound_of(part)
        if bound is not None and bound.value > 0.0:
            bounds.append(bound)
            multipliers[part.nodes] = bound.multipliers
    if not bounds:
        return None
    return DualBound(
        value=math.nextafter(math.fsum(bound.value for bound in bounds), -math.inf),
        multipliers=multipliers,
        form=problem,
        shift=max(bound.shift for bound in bounds),
        factorizations=sum(bound.factorizations for bound in bounds),
        nonzeros=max(bound.nonzeros for bound in bounds),
        loose=any(bound.loose for bound in bounds),
        attained=math.fsum(bound.attained for bound in bounds),
    )
