"""Cycles of a graph: all the short ones, a basis, and the graphs that are a single one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.edges import adjacency
from certpgo.graph.graph import Graph
from certpgo.linalg.arrays import BoolArray, IntArray

#: Edges of the longest cycles of which a list has all.
SHORT = 6
#: A step along an edge, and whether in the direction of its measurement.
Step = tuple[int, bool]


@dataclass(frozen=True, eq=False)
class Walk:
    """Once around a cycle, from node 0.

    Attributes
    ----------
    nodes : (n,) in order
    parents : (n,) the node before each, negative for node 0
    edges : (n,) the edge that leaves each node of ``nodes``
    forward : (n,) whether that edge is measured in the direction of the walk
    """

    nodes: IntArray
    parents: IntArray
    edges: IntArray
    forward: BoolArray


def is_cycle(graph: Graph) -> bool:
    """Whether the (connected) graph is a single cycle of at least three nodes."""
    degree = np.bincount(graph.edges.ravel(), minlength=graph.num_nodes)
    return graph.num_nodes >= 3 and graph.num_edges == graph.num_nodes and bool((degree == 2).all())


def walk(graph: Graph) -> Walk:
    """The walk around a cycle; GraphError for other graphs."""
    from scipy.sparse import csgraph

    n, (i, j) = graph.num_nodes, graph.edges.T
    if not is_cycle(graph):
        raise GraphError(
            f"this graph of {n} nodes and {graph.num_edges} edges is not a single cycle of at "
            "least 3 nodes"
        )
    # Depth-first search follows the cycle.
    nodes, parents = csgraph.depth_first_order(adjacency(n, i, j, np.ones(n)), 0, directed=False)
    position = np.empty(n, dtype=np.intp)
    position[nodes] = np.arange(n)
    forward = (position[j] - position[i]) % n == 1
    edges = np.argsort(np.where(forward, position[i], position[j]))
    return Walk(
        np.asarray(nodes, dtype=np.intp),
        np.asarray(parents, dtype=np.intp),
        edges,
        forward[edges],
    )


@dataclass(frozen=True, eq=False)
class Cycles:
    """Closed walks, one after the other; the first ones are a basis of all flows.

    Attributes
    ----------
    edges : (p,) the edges of all walks, in order
    signs : (p,) 1 where an edge is walked in the direction of its measurement, -1 elsewhere
    starts : (c + 1,) where each walk begins in these, and the end
    chords : (b,) the edges that are not of a spanning forest: the first of each walk of the basis
    """

    edges: IntArray
    signs: IntArray
    starts: IntArray
    chords: IntArray

    @classmethod
    def of(cls, walks: list[list[Step]], basis: int) -> Cycles:
        """The walks of these steps; so many of them are the basis."""
        steps = np.array([step for walk in walks for step in walk], dtype=np.intp).reshape(-1, 2)
        starts = np.cumsum([0, *map(len, walks)], dtype=np.intp)
        edges, forward = steps.T
        return cls(edges, 2 * forward - 1, starts, edges[starts[:basis]])

    def __len__(self) -> int:
        return len(self.starts) - 1

    def chosen(self, which: list[int]) -> Cycles:
        """Some of them."""
        of = np.split(np.arange(len(self.edges)), self.starts[1:-1])
        at = np.concatenate([of[c] for c in which]) if which else np.zeros(0, np.intp)
        starts = np.cumsum([0, *self.lengths[which]], dtype=np.intp)
        return Cycles(self.edges[at], self.signs[at], starts, self.chords)

    @cached_property
    def lengths(self) -> IntArray:
        """(c,) number of edges of each."""
        return np.diff(self.starts)

    @cached_property
    def owners(self) -> IntArray:
        """(p,) the walk that each of the edges belongs to."""
        return np.repeat(np.arange(len(self)), self.lengths)


def cycle_list(num_nodes: int, edges: IntArray, most: int) -> Cycles:
    """A basis of all flows on edges (m, 2), and all cycles of a length while there are few.

    Parameters
    ----------
    most : number of cycles beyond which those of the next length, up to `SHORT`, are left out
    """
    around = _Around(num_nodes, edges)
    walks = list(around.basis())
    basis, found = len(walks), {frozenset(k for k, _ in walk) for walk in walks}
    for length in range(2, SHORT + 1):
        more = []
        for walk in around.of_length(length):
            if frozenset(k for k, _ in walk) not in found:
                more.append(walk)
                if len(walks) + len(more) > most:
                    return Cycles.of(walks, basis)
        walks += more
    return Cycles.of(walks, basis)


class _Around:
    """The steps from each node."""

    def __init__(self, num_nodes: int, edges: IntArray) -> None:
        self.ends = edges.tolist()
        self.steps: list[list[tuple[int, Step]]] = [[] for _ in range(num_nodes)]
        for k in range(len(self.ends)):
            self._add(self.steps, k)

    def basis(self) -> Iterator[list[Step]]:
        """For each edge outside a forest a shortest cycle of it, the forest and those before.

        So each of these cycles has an edge that none before it has. The first edges are those whose
        cycles in the forest are shortest.
        """
        tree = self._forest()
        steps: list[list[tuple[int, Step]]] = [[] for _ in self.steps]
        for k in tree:
            self._add(steps, k)
        chords = sorted({*range(len(self.ends))} - tree)
        lengths = {k: len(_path(steps, *self.ends[k])) for k in chords}
        for k in sorted(chords, key=lambda k: lengths[k]):
            i, j = self.ends[k]
            yield [(k, True), *_path(steps, j, i)]
            self._add(steps, k)

    def _forest(self) -> set[int]:
        """The edges of breadth-first trees."""
        reached, tree = set[int](), set[int]()
        for root in range(len(self.steps)):
            front = deque([] if root in reached else [root])
            reached.add(root)
            while front:
                for other, (k, _) in self.steps[front.popleft()]:
                    if other not in reached:
                        reached.add(other)
                        tree.add(k)
                        front.append(other)
        return tree

    def _add(self, steps: list[list[tuple[int, Step]]], k: int) -> None:
        i, j = self.ends[k]
        steps[i].append((j, (k, True)))
        steps[j].append((i, (k, False)))

    def of_length(self, length: int) -> Iterator[list[Step]]:
        """All cycles of this many edges, each once, from its smallest node."""
        for root in range(len(self.steps)):
            yield from self._extended(root, root, [], {root}, self._near(root, length // 2), length)

    def _extended(
        self,
        root: int,
        node: int,
        walk: list[Step],
        visited: set[int],
        near: dict[int, int],
        length: int,
    ) -> Iterator[list[Step]]:
        left = length - len(walk) - 1
        for other, step in self.steps[node]:
            if left == 0:
                # Of both directions the one whose first edge is the smaller.
                if other == root and step[0] > walk[0][0]:
                    yield [*walk, step]
            elif near.get(other, length) <= left and other not in visited:
                walk.append(step)
                visited.add(other)
                yield from self._extended(root, other, walk, visited, near, length)
                visited.remove(other)
                walk.pop()

    def _near(self, root: int, far: int) -> dict[int, int]:
        """Distances from a node to those after it that are at most so far."""
        distances, front = {root: 0}, [root]
        for distance in range(1, far + 1):
            after = {x for node in front for x, _ in self.steps[node] if x > root} - {*distances}
            distances.update(dict.fromkeys(after, distance))
            front = [*after]
        return distances


def _path(steps: list[list[tuple[int, Step]]], start: int, end: int) -> list[Step]:
    """A shortest path, searched from both ends."""
    came: tuple[dict[int, tuple[int, Step] | None], ...] = ({start: None}, {end: None})
    fronts = deque([start]), deque([end])
    while True:
        side = len(fronts[1]) < len(fronts[0])
        if not fronts[side]:
            side = not side
        own, other = came[side], came[not side]
        for _ in range(len(fronts[side])):
            node = fronts[side].popleft()
            for after, (k, forward) in steps[node]:
                if after in own:
                    continue
                own[after] = node, (k, forward)
                if after in other:
                    return _joined(came, after)
                fronts[side].append(after)


def _joined(came: tuple[dict[int, tuple[int, Step] | None], ...], node: int) -> list[Step]:
    """The path through a node that both searches reached."""
    path: list[Step] = []
    at = came[0][node]
    while at is not None:
        path.append(at[1])
        at = came[0][at[0]]
    path.reverse()
    at = came[1][node]
    while at is not None:
        k, forward = at[1]
        path.append((k, not forward))
        at = came[1][at[0]]
    return path
