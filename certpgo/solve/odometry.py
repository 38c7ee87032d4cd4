"""Poses that grow at the end, as measurements of new nodes arrive."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Estimate, Graph
from certpgo.graph.concatenate import make_of, require_one_make
from certpgo.graph.kinds import NODES, Node
from certpgo.graph.labels import WORLD, Label, called
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: Room for so many poses at first.
FIRST = 64


class Track:
    """Labelled nodes of measurements of one make, and their poses; the first is the identity.

    Attributes
    ----------
    numbers : the number of each label, in the order in which they came
    kinds : for each, what it is, see ``certpgo.graph.kinds.NODES``
    """

    def __init__(self, first: Graph) -> None:
        d, self._make = first.d, make_of(first)
        self.numbers: dict[Label, int] = {}
        self.kinds: list[int] = []
        self.num_scaled = 0  #: Nodes of unknown scale.
        self.newest: int | None = None  #: The last pose of the last graph with new ones.
        self.num_given = 0  #: Poses of the last estimate; those after them were composed.
        self._num_known = 0  # nodes that are neither such nor points
        self._unit = np.eye(d)
        self._rotations = np.tile(self._unit, (FIRST, 1, 1))
        self._translations = np.zeros((FIRST, d))
        self._scales = np.ones(FIRST)

    @property
    def points(self) -> BoolArray | None:
        """(n,) which nodes are points; None for none."""
        points = np.array(self.kinds) == Node.POINT
        return points if points.any() else None

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def mean_over(self) -> int:
        """Over how many scales the mean is that is the unit; 0 if there is a known one, or none."""
        return 0 if self._num_known else self.num_scaled

    @property
    def estimate(self) -> Estimate:
        """All poses; never changed later."""
        n = len(self)
        scales = self._scales[:n] if self.num_scaled else None
        return Estimate.trusted(self._rotations[:n], self._translations[:n], scales=scales)

    @estimate.setter
    def estimate(self, better: Estimate) -> None:
        room = FIRST + 2 * len(self)
        self._rotations = np.tile(np.eye(better.d), (room, 1, 1))
        self._translations, self._scales = np.zeros((room, better.d)), np.ones(room)
        self._rotations[: len(self)], self.num_given = better.rotations, len(self)
        if better.translations is not None:
            self._translations[: len(self)] = better.translations
        if better.scales is not None:
            self._scales[: len(self)] = better.scales

    def estimate_of(self, nodes: IntArray) -> Estimate:
        """The poses of some nodes."""
        scales = self._scales[nodes] if self.num_scaled else None
        return Estimate.trusted(self._rotations[nodes], self._translations[nodes], scales=scales)

    def extend(self, graph: Graph, labels: Sequence[Label]) -> IntArray:
        """Compose the poses of new nodes; the number of each node (n,), -1 for one without edges.

        Raises
        ------
        GraphError
            As `steps`; then nothing changes.
        """
        steps, kinds, before = self.steps(graph, labels), graph.nodes.tolist(), len(self)
        if not self.numbers:
            first = int(graph.edges[0, 0])
            self.numbers[labels[first]] = 0
            self._count(kinds[first])
        for here, there, edge in steps:
            self._append(graph, labels, here, there, edge)
            self._count(kinds[there])
        numbers = [self.numbers.get(label, -1) for label in labels]
        for number, label, kind in zip(numbers, labels, kinds, strict=True):
            if number >= before and label is not WORLD and kind != Node.POINT:
                self.newest = number
        return np.array(numbers, dtype=np.intp)

    def steps(self, graph: Graph, labels: Sequence[Label]) -> list[tuple[int, int, int]]:
        """Edges (from, to, edge) that reach new nodes from known ones.

        Raises
        ------
        GraphError
            A node is not connected with those that are known, or is of one kind here and another
            there; or the measurements are of another make.
        """
        require_one_make([self._make, make_of(graph)])
        begin = self.numbers or {labels[int(graph.edges[0, 0])]: 0}
        touched, kinds = sorted(set(graph.pairs.ravel().tolist())), graph.nodes.tolist()
        for node in touched:
            known = self.numbers.get(labels[node])
            if known is not None and self.kinds[known] != kinds[node]:
                both = sorted((self.kinds[known], kinds[node]))
                said = " and a ".join(NODES[kind].format(s="") for kind in both)
                raise GraphError(f"{called(labels[node])} is a {said}")
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
            self._scales = np.concatenate([self._scales, np.ones_like(self._scales)])
        R, forward = graph.rotations[edge], graph.edges[edge, 0] == here
        R = self._rotations[known] @ (R if forward else R.T)
        # By a step of Newton and Schulz, whatever the length of the chain, a rotation to rounding.
        self._rotations[n] = R @ (1.5 * self._unit - 0.5 * (R.T @ R))
        if graph.has_scales:
            self._scale(graph, there, edge, known)
        if graph.has_positions:
            t, back = graph.steps[edge], n if not forward else known
            step = self._scales[back] * (self._rotations[back] @ t)
            self._translations[n] = self._translations[known] + (step if forward else -step)
        self.numbers[labels[there]] = n

    def _scale(self, graph: Graph, there: int, edge: int, known: int) -> None:
        """The scale of a new node, the last, in the unit of all, or of the first known one."""
        n, kind, ratio = len(self), graph.nodes[there], graph.scales[edge]
        scale = self._scales[known] * (ratio if graph.edges[edge, 1] == there else 1.0 / ratio)
        if kind == Node.SCALED:
            self._scales[n] = scale
        elif kind == Node.POSE and self.mean_over:
            self._scales, self._translations = self._scales.copy(), self._translations / scale
            self._scales[:n] /= scale

    def _count(self, kind: int) -> None:
        """Count the last node as one of this kind."""
        self.kinds.append(kind)
        self.num_scaled += int(kind == Node.SCALED)
        self._num_known += int(kind not in (Node.SCALED, Node.POINT))


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
