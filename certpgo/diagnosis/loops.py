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
    """Measured poses that join nodes, and how well loops close along a tree of them.

    Attributes
    ----------
    rows : (k,) which measurements, between the nodes of their largest component
    nodes : (l,) these
    part : the measurements, with the nodes so numbered
    parents : (l,) of its tree
    closing : (k,) which of them are in no tree
    floor : what noise costs
    given : mean logarithm of costs, as it stands
    """

    rows: IntArray
    nodes: IntArray
    part: Graph
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
        rows = np.flatnonzero(whole & np.isin(graph.edges[:, 0], nodes))
        few = graph.with_blocks().with_information(None).with_edges(rows)
        part = few.subgraph(nodes)
        parents = spanning_tree(part, root="center")
        i, j = part.edges.T
        found = cls(rows, nodes, part, parents, (parents[i] != j) & (parents[j] != i))
        if not found.closing.any():
            return found
        numbers = graph.d * (graph.d + 1) / 2
        median = float(np.median(found._costs(part)))
        stated = examined.instance.states_noise
        found = replace(found, floor=numbers if stated else NEGLIGIBLE * median or 1.0)
        return replace(found, given=found._mean(part))

    def share(self, part: Graph) -> float:
        """What other measurements leave of the costs, their geometric mean; 1 without loops."""
        return math.exp(self._mean(part) - self.given) if self.closing.any() else 1.0

    @property
    def composed(self) -> Estimate:
        """Poses of the nodes along the tree."""
        return compose(self.part, self.parents)

    def _costs(self, part: Graph) -> FloatArray:
        return EdgeSums(part).terms(compose(part, self.parents))[self.closing]

    def _mean(self, part: Graph) -> float:
        return float(np.log(self._costs(part) + self.floor).mean())
