"""Edges of poses with isotropic weights, which grow: optima and bounds by compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.kinds import Node
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern
from certpgo.linalg.factor import default_engine
from certpgo.linalg.rotations import rotation_defect
from certpgo.linalg.threads import one_thread
from certpgo.objective.analyses import Analyses

#: Edges that there is room for at first.
FIRST = 64


class Settled(NamedTuple):
    """A minimum of F, and what is proven of it.

    Attributes
    ----------
    estimate : with the best translations for its rotations
    cost : F there, rounded up
    multipliers : (n, d, d) those of the estimate
    proven : (n, d, d) smaller ones, with a certificate matrix that is proven to be positive
        semidefinite; None if the first shift does not suffice
    """

    estimate: Estimate
    cost: float
    multipliers: FloatArray
    proven: FloatArray | None


class PlainEdges:
    """Such edges, see `is_plain`: more are added in time that does not grow."""

    def __init__(self, d: int) -> None:
        self.d, self._count, self._defect = d, 0, 0.0
        self._arrays: list[Any] = [
            np.empty((FIRST, 2), dtype=np.int64),
            np.empty((FIRST, d, d)),
            np.empty(FIRST),
            np.empty(FIRST),
            np.empty((FIRST, d)),
        ]

    @staticmethod
    def is_plain(graph: Graph) -> bool:
        """Whether there is compiled code for a graph."""
        if not compiled.AVAILABLE or default_engine() != "multifrontal":
            return False
        poses = bool((graph.nodes == Node.POSE).all()) and not graph.blocks
        return poses and not (graph.is_general or graph.is_signed or graph.has_scales)

    def extended(self, graph: Graph, nodes: IntArray) -> PlainEdges | None:
        """With the edges of a graph whose nodes have these numbers (n,), unless it is not plain."""
        if not self.is_plain(graph):
            return None
        before, after = self._count, self._count + graph.num_edges
        room = len(self._arrays[0])
        if after > room:
            more = max(room, after)
            self._arrays = [
                np.concatenate([of, np.empty((more, *of.shape[1:]), of.dtype)])
                for of in self._arrays
            ]
        added = nodes[graph.edges], graph.rotations, graph.kappa, graph.tau, graph.translations
        for to, new in zip(self._arrays, added, strict=True):
            to[before:after] = new
        self._count = after
        self._defect = max(self._defect, rotation_defect(graph.rotations))
        return self

    @one_thread
    def settled(self, start: Estimate, enough: float, first: int | None = None) -> Settled | None:
        """The minimum near an estimate; None if there is none near.

        Nodes from the number ``first`` on are placed anew, one after another, where measurements
        from nodes before them say on average: chains that were composed drift.

        By Newton's method with few factors, whose last step promised to lower F by a share of at
        most ``enough``; then with the best translations. The bound is that of
        `certpgo.certify.dual.dual_bound` by its first shift.
        """
        d, n = self.d, start.num_nodes
        pairs, P, kappa, tau, moved = (of[: self._count] for of in self._arrays)
        pattern = BlockPattern(n, pairs)
        analyses: Any = Analyses(pattern, "multifrontal")
        rows = d + d * (d - 1) // 2, 1, d + 1
        fronts = [analyses.of_rows(b).fronts for b in rows]
        R, t = np.array(start.rotations), np.array(start.translations)
        multipliers, proven = np.empty_like(R), np.empty_like(R)
        found = compiled.kernel.settle(
            (pairs, P, None, kappa, tau, moved, None),
            d,
            pattern.places(),
            *(of.arrays for of in fronts),
            fronts[-1].lengths,
            self._defect,
            enough,
            n if first is None else first,
            R,
            t,
            multipliers,
            proven,
        )
        if found is None:
            return None
        cost, is_proven = found
        return Settled(Estimate(R, t), cost, multipliers, proven if is_proven else None)
