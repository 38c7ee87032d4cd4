"""A graph that grows by parts, which are joined when all of them are asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.concatenate import joined
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import IntArray
from certpgo.objective.choose_cost import CHORDAL
from certpgo.objective.plain_edges import PlainEdges
from certpgo.solve.odometry import Track
from certpgo.solve.terms import Terms

#: Parts from which they are joined.
MANY = 64
#: A graph, and the numbers of its nodes among all.
Part = tuple[Graph, IntArray]


class GrowingMeasurements:
    """Measurements in the order in which they come, between the nodes of a `Track`.

    Attributes
    ----------
    scale : what W of those that were collected is made of
    """

    def __init__(self) -> None:
        self.scale = Scale.none()
        self._whole: Graph | None = None
        self._parts: list[Part] = []  # after those, in order
        self._new: list[Part] = []  # after these, which were not collected yet
        self._title: str | None = None  # None if not known
        self._plain: PlainEdges | None = None  # of those that were collected, if all are

    @property
    def has_new(self) -> bool:
        """Whether some came since `collect`."""
        return bool(self._new)

    @property
    def last(self) -> Graph | None:
        """Some of the last measurements; None before the first."""
        some = self._new or self._parts
        return some[-1][0] if some else self._whole

    def add(self, graph: Graph, nodes: IntArray) -> None:
        """Add measurements whose nodes have these numbers (n,), -1 without measurements."""
        measured = np.array(sorted({*graph.pairs.ravel().tolist()}))
        if len(measured) < graph.num_nodes:
            graph, nodes = graph.subgraph(measured), nodes[measured]
        self._new.append((graph, nodes))

    def replace(self, graph: Graph, terms: Terms) -> None:
        """Go on with other measurements of all nodes."""
        self._whole, self._parts, self._new = graph, [], []
        self.scale, self._title, self._plain = terms.scale(graph), None, None

    def collect(self, track: Track, terms: Terms) -> Part:
        """The measurements that are new, of which there are some; from now on they are not."""
        added = self._new[0]
        if len(self._new) > 1:
            graph = _joined(self._new, track)
            nodes = np.unique(graph.pairs)
            added = graph.subgraph(nodes), nodes
        graph, self._new = added[0], []
        # Edges that measure all do not change the title.
        if graph.blocks or track.num_scaled or not graph.kappa.all() or not self._parts:
            self._title = None
        self.scale += terms.scale(graph)
        if self._plain is not None:
            self._plain = self._plain.extended(*added)
        self._parts.append(added)
        if len(self._parts) > MANY:
            self.joint(track)
        return added

    def joint(self, track: Track) -> Graph:
        """All measurements that were collected, between all nodes."""
        whole, parts = self._whole, self._parts
        if whole is None or parts:
            before = [] if whole is None else [(whole, np.arange(whole.num_nodes))]
            whole = _joined([*before, *parts], track)
            self._whole, self._parts = whole, []
        return whole

    def plain(self, track: Track, terms: Terms) -> PlainEdges | None:
        """The same for compiled code, if it takes them all, and their cost."""
        if self._plain is None and terms.cost == CHORDAL:
            whole = self.joint(track)
            self._plain = PlainEdges(whole.d).extended(whole, np.arange(whole.num_nodes))
        return self._plain

    def title(self, terms: Terms) -> str:
        """The cost of those that were collected, in words."""
        if self._title is None:
            before = [] if self._whole is None else [self._whole]
            self._title = terms.title([*before, *(graph for graph, _ in self._parts)])
        return self._title


def _joined(parts: Sequence[Part], track: Track) -> Graph:
    graphs, nodes = zip(*parts, strict=True)
    return joined(graphs, len(track), track.points, nodes)
