"""The numbers that a session gives to its measurements."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from numbers import Integral

import numpy as np

from certpgo.errors import InputError, require
from certpgo.graph import Graph
from certpgo.graph.observations import Observations
from certpgo.linalg.arrays import BoolArray, IntArray

#: The number of an edge that is no measurement, but puts a world somewhere or holds a node.
ASSUMED = -1


class RowNumbers:
    """The number of each row of a graph that grows: its edges, then its blocks by their kinds."""

    def __init__(self) -> None:
        self.edges: list[int] = []
        self.blocks: dict[type[Observations], list[int]] = {}
        #: Measurements that ever came, and edges that are none.
        self.count, self.assumed = 0, 0

    def following(self, graph: Graph, is_measured: BoolArray) -> list[int]:
        """Numbers of new measurements, in that order, given which edges (m,) are measurements."""
        if not graph.blocks and is_measured.all():
            return list(range(self.count, self.count + graph.num_edges))
        others = sum(block.num_edges for block in graph.blocks)
        measured = np.append(is_measured, np.ones(others, dtype=bool))
        numbers = np.where(measured, self.count + np.cumsum(measured) - 1, ASSUMED)
        return [int(number) for number in numbers]

    def append(self, graph: Graph, numbers: Sequence[int]) -> None:
        """Add the rows of a graph with these numbers."""
        m = graph.num_edges
        self.edges += numbers[:m]
        self.assumed += numbers[:m].count(ASSUMED)
        for block in graph.blocks:
            self.blocks.setdefault(type(block), []).extend(numbers[m : m + block.num_edges])
            m += block.num_edges
        self.count = max(self.count, max(numbers) + 1)

    def chosen(self, numbers: Iterable[int]) -> list[int]:
        """Numbers of measurements, each once, ascending.

        Raises
        ------
        InputError
            There is no such measurement.
        """
        require(numbers, Iterable, "the numbers of measurements")
        found = list(numbers)
        for number in found:
            require(number, Integral, "the number of a measurement")
        absent = sorted(set(found) - {*self.rows.tolist()} | {*found} & {ASSUMED})
        if absent:
            raise InputError(f"there is no measurement {absent[0]}")
        return sorted(set(found))

    def keep(self, kept: BoolArray) -> None:
        """Keep some of the `rows`."""
        lists = [self.edges, *self.blocks.values()]
        ends = np.cumsum([len(numbers) for numbers in lists])
        for numbers, chosen in zip(lists, np.split(kept, ends[:-1]), strict=True):
            numbers[:] = np.array(numbers, dtype=np.intp)[chosen].tolist()
        self.blocks = {kind: numbers for kind, numbers in self.blocks.items() if numbers}
        self.assumed = self.edges.count(ASSUMED)

    def keep_edges(self, kept: BoolArray) -> None:
        """Keep some of the edges, and all else."""
        self.keep(np.append(kept, np.ones(len(self) - len(kept), dtype=bool)))

    def __len__(self) -> int:
        return len(self.edges) + sum(map(len, self.blocks.values()))

    @property
    def num_measurements(self) -> int:
        """How many rows are measurements."""
        return len(self) - self.assumed

    @property
    def rows(self) -> IntArray:
        """The number of each row."""
        return np.array([*self.edges, *chain(*self.blocks.values())], dtype=np.intp)
