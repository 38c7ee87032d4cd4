"""How well loops of measured poses close along a tree: a cheap judge of readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import components_of
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.edge_sums import EdgeSums

#: Share of the median cost of loops that does not count, where noise is not stated.
NEGLIGIBLE = 1e-3


@dataclass(frozen=True, eq=False)
class Loops:
    """Nodes that measured poses join, and how well loops close along a tree of them.

    Attributes
    ----------
    whole : (m,) which measurements are of poses
    nodes : (k,) the nodes of their largest component
    parents : (k,) of its tree
    closing : (l,) which of their measurements are in no tree
    floor : what noise costs
    given : mean logarithm of costs, as it stands
    """

    whole: BoolArray
    nodes: IntArray
    parents: IntArray
    closing: BoolArray
    floor: float = 0.0
    given: float = 0.0

    @classmethod
    def of(cls, examined: Examined) -> Self:
        """Those of the measurements that are given."""
        graph, whole = examined.instance.graph, examined.whole
        labels = components_of(graph.num_nodes, graph.edges[whole])
        nodes = np.flatnonzero(labels == np.argmax(np.bincount(labels)))
        part = _part(graph, whole, nodes)
        parents = spanning_tree(part, root="center")
        i, j = part.edges.T
        found = cls(whole, nodes, parents, (parents[i] != j) & (parents[j] != i))
        if not found.closing.any():
            return found
        numbers = graph.d * (graph.d + 1) / 2
        median = float(np.median(found._costs(graph)))
        stated = examined.instance.states_noise
        found = replace(found, floor=numbers if stated else NEGLIGIBLE * median or 1.0)
        return replace(found, given=found._mean(graph))

    def share(self, graph: Graph) -> float:
        """What other measurements leave of the costs, their geometric mean; 1 without loops."""
        return math.exp(self._mean(graph) - self.given) if self.closing.any() else 1.0

    def composed(self, graph: Graph) -> Estimate:
        """Poses of the nodes along the tree."""
        return compose(_part(graph, self.whole, self.nodes), self.parents)

    def _costs(self, graph: Graph) -> FloatArray:
        part = _part(graph, self.whole, self.nodes)
        return EdgeSums(part).terms(compose(part, self.parents))[self.closing]

    def _mean(self, graph: Graph) -> float:
        return float(np.log(self._costs(graph) + self.floor).mean())


def _part(graph: Graph, whole: BoolArray, nodes: IntArray) -> Graph:
    """The measured poses among some nodes."""
    return graph.with_blocks().with_information(None).with_edges(whole).subgraph(nodes)
