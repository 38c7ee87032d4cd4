"""Which loops an estimate winds: residual rotations around them add up to full turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.trees import spanning_tree
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray

#: Loops whose lengths are compared, of those that are wound.
COMPARED = 200
TURN = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class Wound:
    """The shortest loop that is wound.

    Attributes
    ----------
    edges : (k,) its measurements; the last closes it
    degrees, usual : what its residual rotations add up to, and those of the best estimate
    loops : how many loops of a tree are wound
    """

    edges: IntArray
    degrees: float
    usual: float
    loops: int


def wound(graph: Graph, estimate: Estimate, best: Estimate) -> Wound | None:
    """The shortest loop that an estimate winds and the best one does not; None if none is known.

    Around a loop residuals multiply to what the measurements miss it by, whatever the estimate is:
    in the plane, their angles add up to that and full turns. In space that holds for residuals that
    are small; sums of vectors near full turns are looked for. Loops are those of edges with a
    breadth-first tree.
    """
    turning = np.flatnonzero(graph.measures_rotation)
    nodes = np.unique(graph.edges[turning])
    part = graph.rotations_alone.with_edges(turning).subgraph(nodes)
    if not part.is_connected:
        return None
    tree = _Tree(part)
    sums, usual = (np.linalg.norm(tree.sums(one.subset(nodes)), axis=1) for one in (estimate, best))
    found = np.flatnonzero(np.rint(sums / TURN) > np.rint(usual / TURN))
    if not len(found):
        return None
    heights = tree.depths[part.edges[found]].sum(axis=1)
    near = found[np.argsort(heights, kind="stable")[:COMPARED]]
    loops = [tree.loop(int(edge)) for edge in near]
    k = int(np.argmin([len(loop) for loop in loops]))
    degrees, as_best = np.degrees([sums[near[k]], usual[near[k]]]).tolist()
    return Wound(turning[loops[k]], degrees, as_best, len(found))


class _Tree:
    """A breadth-first tree of a connected graph of rotations."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.parents = spanning_tree(graph, root="center")
        self.depths = np.zeros(graph.num_nodes, dtype=np.intp)
        up = self.parents.copy()
        while (deeper := up >= 0).any():
            self.depths += deeper
            up = np.where(deeper, self.parents[up], -1)
        of_pair = {pair: e for e, pair in reversed([*enumerate(map(tuple, graph.edges.tolist()))])}
        #: For each node, the edge to its parent, and whether that leads to the node.
        self.edge = np.full(graph.num_nodes, -1)
        self.down = np.zeros(graph.num_nodes, dtype=bool)
        for node, parent in enumerate(self.parents.tolist()):
            if parent >= 0:
                forward = of_pair.get((parent, node))
                self.down[node] = forward is not None
                self.edge[node] = of_pair[node, parent] if forward is None else forward

    def sums(self, estimate: Estimate) -> FloatArray:
        """(m, q) sums of residual rotations around the loop of each edge, in the world's frame."""
        R, (i, j) = estimate.rotations, self.graph.edges.T
        residuals = so.log(R[i] @ self.graph.rotations @ np.swapaxes(R[j], 1, 2))
        residuals = residuals.reshape(len(i), -1)
        total = np.zeros((len(R), residuals.shape[1]))
        for node in np.argsort(self.depths, kind="stable")[1:].tolist():
            step = residuals[self.edge[node]]
            total[node] = total[self.parents[node]] + (step if self.down[node] else -step)
        return np.asarray(total[i] + residuals - total[j])

    def loop(self, edge: int) -> IntArray:
        """The edges of a loop, its own last."""
        (i, j), found = self.graph.edges[edge].tolist(), list[int]()
        while i != j:
            if self.depths[i] < self.depths[j]:
                i, j = j, i
            found.append(int(self.edge[i]))
            i = int(self.parents[i])
        return np.array([*found, edge])
