"""Poses that grow at the end, as measurements of new nodes arrive."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Estimate, Graph
from certpgo.graph.concatenate import make_of, require_one_make
from certpgo.graph.labels import Label, called
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray

#: Room for so many poses at first.
FIRST = 64


class Track:
    """Labelled nodes of measurements of one make, and their poses; the first is the identity.

    Attributes
    ----------
    numbers : the number of each label, in the order in which they came
    points : for each, whether it is a point rather than a pose
    """

    def __init__(self, first: Graph) -> None:
        d, self._make = first.d, make_of(first)
        self.numbers: dict[Label, int] = {}
        self.points: list[bool] = []
        self._rotations = np.tile(np.eye(d), (FIRST, 1, 1))
        self._translations = np.zeros((FIRST, d))
        self._projected = 0  # poses whose rotations are such to rounding

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def estimate(self) -> Estimate:
        """All poses; never changed later."""
        n, new = len(self), slice(self._projected, len(self))
        if self._projected < n:
            self._rotations[new] = so.project(self._rotations[new])
            self._projected = n
        return Estimate.trusted(self._rotations[:n], self._translations[:n])

    @estimate.setter
    def estimate(self, better: Estimate) -> None:
        room = FIRST + 2 * len(self)
        self._rotations = np.tile(np.eye(better.d), (room, 1, 1))
        self._translations = np.zeros((room, better.d))
        self._rotations[: len(self)] = better.rotations
        if better.translations is not None:
            self._translations[: len(self)] = better.translations
        self._projected = len(self)

    def extend(self, graph: Graph, labels: Sequence[Label]) -> IntArray:
        """Compose the poses of new nodes; the number of each node (n,), -1 for one without edges.

        Raises
        ------
        GraphError
            As `steps`; then nothing changes.
        """
        steps, points = self.steps(graph, labels), _points(graph)
        if not self.numbers:
            first = int(graph.edges[0, 0])
            self.numbers[labels[first]] = 0
            self.points.append(first in points)
        self.points += [there in points for _, there, _ in steps]
        for here, there, edge in steps:
            self._append(graph, labels, here, there, edge)
        return np.array([self.numbers.get(label, -1) for label in labels], dtype=np.intp)

    def steps(self, graph: Graph, labels: Sequence[Label]) -> list[tuple[int, int, int]]:
        """Edges (from, to, edge) that reach new nodes from known ones.

        Raises
        ------
        GraphError
            A node is not connected with those that are known, or is a pose here and a point there;
            or the measurements are of another make.
        """
        require_one_make([self._make, make_of(graph)])
        begin = self.numbers or {labels[int(graph.edges[0, 0])]: 0}
        touched, points = sorted(set(graph.pairs.ravel().tolist())), _points(graph)
        for node in touched:
            known = self.numbers.get(labels[node])
            if known is not None and self.points[known] != (node in points):
                raise GraphError(f"{called(labels[node])} is a pose and a point")
        steps = _steps(graph, labels, begin)
        reached = {node for _, node, _ in steps}
        for node in touched:
            if node not in reached and labels[node] not in begin:
                raise GraphError(f"{called(labels[node])} is not connected with those before it")
        return steps

    def _append(
        self, graph: Graph, labels: Sequence[Label], here: int, there: int, edge: int
    ) -> None:
        """The pose of a new node from that of a known one and the measurement between them."""
        n, known = len(self), self.numbers[labels[here]]
        if n == len(self._rotations):
            self._rotations = _doubled(self._rotations)
            self._translations = _doubled(self._translations)
        R, forward = graph.rotations[edge], graph.edges[edge, 0] == here
        self._rotations[n] = self._rotations[known] @ (R if forward else R.T)
        if graph.has_positions:
            t, back = graph.steps[edge], n if not forward else known
            step = self._rotations[back] @ t
            self._translations[n] = self._translations[known] + (step if forward else -step)
        self.numbers[labels[there]] = n


def _points(graph: Graph) -> set[int]:
    """The nodes that are points."""
    return set(np.flatnonzero(graph.is_point).tolist())


def _steps(
    graph: Graph, labels: Sequence[Label], known: dict[Label, int]
) -> list[tuple[int, int, int]]:
    """Edges (from, to, edge) that reach new nodes from known ones, breadth first."""
    leaving = defaultdict(list)
    for edge, (i, j) in enumerate(graph.edges.tolist()):
        leaving[i].append((j, edge))
        leaving[j].append((i, edge))
    found = {node for node in leaving if labels[node] in known}
    queue, steps = deque(sorted(found)), []
    while queue:
        here = queue.popleft()
        for there, edge in leaving[here]:
            if there not in found:
                found.add(there)
                queue.append(there)
                steps.append((here, there, edge))
    return steps


def _doubled(array: FloatArray) -> FloatArray:
    return np.concatenate([array, np.zeros_like(array)])
