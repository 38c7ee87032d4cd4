"""Graphs of tasks that factorize a matrix, measure the rounding, and solve."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from typing import Any

import numpy as np

from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.distributed import tiles
from certpgo.linalg.distributed.branches import SHARE, TILE, Branch, Piece, Tiles, branches_of
from certpgo.linalg.distributed.schedulers import Scheduler
from certpgo.linalg.distributed.tasks import Key, TaskGraph
from certpgo.linalg.distributed.tiles import NotDefinite, RowScaling, Tile
from certpgo.linalg.multifrontal import Elimination, Fronts, Precision, Tree

#: Bytes of a factor that returns to this process.
GATHERED = 2e9
#: Updates that arrive at tiles of a branch: the call, and rows and columns of the tile.
Incoming = dict[tuple[int, int], list[list[Any]]]


class DistributedFronts(Fronts):
    """Fronts that are eliminated by the tasks of a scheduler."""

    def __init__(
        self,
        tree: Tree,
        sizes: IntArray,
        scheduler: Scheduler,
        *,
        share: float = SHARE,
        tile: int = TILE,
    ) -> None:
        super().__init__(tree, sizes)
        self.scheduler, self._share, self._tile = scheduler, share, tile

    @cached_property
    def branches(self) -> list[Branch]:
        """The elimination tree, cut."""
        return branches_of(self, share=self._share, tile=self._tile)

    @cached_property
    def kept_fronts(self) -> list[Any]:
        """The fronts of each branch, which the workers keep."""
        graph = TaskGraph()
        keys = [graph.add(_itself, branch.fronts) for branch in self.branches]
        return self.scheduler.keep(graph, keys)

    def eliminate(
        self,
        data: FloatArray,
        *,
        scale: FloatArray | None = None,
        keep: Precision | None = None,
        weights: FloatArray | None = None,
        measured: tuple[FloatArray, FloatArray] | None = None,
    ) -> Elimination | None:
        """As `Fronts.eliminate`."""
        if weights is None:
            weights = np.empty((0, self.size))
        job = _Job(self, data, scale, keep, weights, measured)
        self.scheduler.factorizations += 1
        try:
            if keep is not None:
                is_small = (8 if keep == "double" else 4) * self.entries <= GATHERED
                collect = self.scheduler.compute if is_small else self.scheduler.keep
                return Elimination(collect(job.graph, job.panels), *(np.empty(0),) * 4)
            found = self.scheduler.compute(job.graph, [key for key, _ in job.sums])
        except NotDefinite:
            return None
        total = _Totals(len(weights), self.size)
        for (_, add), result in zip(job.sums, found, strict=True):
            add(total, result)
        return Elimination(None, np.empty(0), total.sums, total.squares, total.residual)

    def solve(self, panels: Any, scale: FloatArray | None, B: FloatArray) -> FloatArray:
        """As `Fronts.solve`."""
        right = np.atleast_2d(B[self.order].T)
        if scale is not None:
            right = right * scale
        # Within the range of any precision.
        unit = np.ldexp(1.0, np.frexp(np.abs(right).max(axis=1, initial=0.0))[1])[:, None]
        X = self.substitute(panels, right / unit)
        X = X * unit if scale is None else X * (unit * scale)
        solution = np.empty(B.shape)
        solution[self.order] = X[0] if B.ndim == 1 else X.T
        return solution

    def substitute(self, panels: Any, right: FloatArray, way: int = 0) -> FloatArray:
        """As `Fronts.substitute`; both ways only, where the factor stays with the workers."""
        if way:
            raise NotImplementedError
        branches, X = self.branches, np.empty_like(right)
        if isinstance(panels[0], np.ndarray):
            fronts, call = [branch.fronts for branch in branches], _at_once
        else:
            graph = TaskGraph()
            fronts, call = self.kept_fronts, graph.add
        forwarded: list[Any] = []
        incoming: list[list[Any]] = [[] for _ in branches]
        places = [_places(branch, branches) for branch in branches]
        for number, branch in enumerate(branches):
            own = np.ascontiguousarray(right[:, branch.rows[: branch.own]])
            factor = fronts[number], panels[number]
            forwarded.append(call(tiles.forward, *factor, own, incoming[number]))
            if branch.above >= 0:
                incoming[branch.above].append([forwarded[-1], branch.own, places[number]])
        solved: dict[int, Any] = {}
        for number in reversed(range(len(branches))):
            branch = branches[number]
            factor = fronts[number], panels[number]
            above = solved.get(branch.above), branch.own, places[number]
            solved[number] = call(tiles.backward, *factor, forwarded[number], *above)
        wanted = [call(tiles.own_rows, solved[k], branch.own) for k, branch in enumerate(branches)]
        if call is not _at_once:
            wanted = self.scheduler.compute(graph, wanted)
        for branch, found in zip(branches, wanted, strict=True):
            X[:, branch.rows[: branch.own]] = found
        return X

    def lower(self, panels: Any) -> CSC:
        """As `Fronts.lower`."""
        if not isinstance(panels[0], np.ndarray):
            graph = TaskGraph()
            panels = self.scheduler.compute(graph, [graph.add(_itself, part) for part in panels])
        return super().lower(np.concatenate(panels))


class _Totals:
    """Sums over the rows of L, of what branches contribute."""

    def __init__(self, k: int, size: int) -> None:
        self.sums, self.squares, self.residual = np.zeros((k, size)), np.zeros(size), np.zeros(size)

    def add_subtree(self, found: Elimination, rows: IntArray) -> None:
        self.sums[:, rows] += found.sums
        self.squares[rows] += found.squares
        self.residual[rows] += found.residual

    def add_tile(self, found: Tile, rows: IntArray, columns: IntArray) -> None:
        self.residual[rows] += found.rows
        self.residual[columns] += found.columns
        self.squares[rows] += found.squares

    def add_column(self, found: FloatArray, rows: IntArray) -> None:
        self.sums[:, rows] += found[:-1]
        self.squares[rows] += found[-1]


class _Job:
    """The tasks of one factorization.

    Attributes
    ----------
    graph : the calls
    panels : keys of the columns of L of each branch, if L is kept
    sums : else keys of sums over rows, and what adds them to `_Totals`
    """

    def __init__(
        self,
        whole: DistributedFronts,
        data: FloatArray,
        scale: FloatArray | None,
        keep: Precision | None,
        weights: FloatArray,
        measured: tuple[FloatArray, FloatArray] | None,
    ) -> None:
        self._data, self._scale, self._keep = data, scale, keep
        self._weights, self._measured = weights, measured
        self._arithmetic: Any = np.float32 if keep == "single" else np.float64
        self.graph = TaskGraph()
        self.panels: list[Key] = []
        self.sums: list[tuple[Key, Callable[[_Totals, Any], None]]] = []
        incoming: list[Incoming] = [defaultdict(list) for _ in whole.branches]
        for branch, fronts, updates in zip(
            whole.branches, whole.kept_fronts, incoming, strict=True
        ):
            receiver = incoming[branch.above] if branch.above >= 0 else defaultdict(list)
            if branch.tiles is None:
                self._subtree(branch, fronts, receiver)
            else:
                self._separator(branch, branch.tiles, updates, receiver)

    def _subtree(self, branch: Branch, fronts: Any, receiver: Incoming) -> None:
        options: dict[str, Any] = {"keep": self._keep}
        if self._scale is not None:
            options["scale"] = self._scale[branch.rows]
        if not self._keep:
            options["weights"] = np.ascontiguousarray(self._weights[:, branch.rows])
        if self._measured is not None:
            options["measured"] = tuple(x[branch.rows] for x in self._measured)
        done = self.graph.add(tiles.subtree, fronts, self._data[branch.entries], **options)
        if self._keep:
            self.panels.append(self.graph.add(tiles.panels_of, done))
        else:
            add = partial(_Totals.add_subtree, rows=branch.rows)
            self.sums.append((self.graph.add(tiles.sums_of, done), add))
        for update in branch.updates:
            for high, low in _lower(update.pieces):
                block = self.graph.add(
                    tiles.update_of, done, update.begin, update.size, high.rows, low.rows
                )
                receiver[high.tile, low.tile].append([block, high.places, low.places])

    def _separator(
        self, branch: Branch, layout: Tiles, updates: Incoming, receiver: Incoming
    ) -> None:
        slices = layout.slices()
        rows = [branch.rows[own] for own in slices]
        scaled = [self._scaled(own) for own in rows]
        L: dict[tuple[int, int], Any] = {}
        for j in range(len(slices)):
            for i in range(j, len(slices)):
                tile = L[i, j] = self.graph.add(
                    tiles.eliminate,
                    (len(rows[i]), len(rows[j])),
                    self._entries(layout.entries.get((i, j)), rows[i], rows[j]),
                    updates.pop((i, j), []),
                    [[L[i, k], L[j, k]] for k in range(min(j, layout.own))],
                    L[j, j] if i > j and j < layout.own else None,
                    kind=(i == j, j < layout.own),
                    real=self._arithmetic,
                    measured=(scaled[i], scaled[j]) if self._measured else None,
                )
                if self._measured is not None:
                    across = rows[j] if i > j else rows[j][:0]
                    add = partial(_Totals.add_tile, rows=rows[i], columns=across)
                    self.sums.append((self.graph.add(tiles.without_values, tile), add))
        columns = [[L[i, j] for i in range(j, len(slices))] for j in range(layout.own)]
        if self._keep:
            kept: Any = np.float64 if self._keep == "double" else np.float32
            self.panels.append(self.graph.add(tiles.panel, columns, len(branch.rows), kept))
        elif self._measured is None:
            for own, column in zip(slices, columns, strict=False):
                below = branch.rows[own.start :]
                found = self.graph.add(tiles.row_sums, column, self._weights[:, below])
                self.sums.append((found, partial(_Totals.add_column, rows=below)))
        for high, low in _lower(branch.updates[0].pieces):
            i, rows_of_tile = layout.holding(high.rows, branch.own)
            j, columns_of_tile = layout.holding(low.rows, branch.own)
            block = self.graph.add(tiles.block_of, L[i, j], rows_of_tile, columns_of_tile)
            receiver[high.tile, low.tile].append([block, high.places, low.places])

    def _scaled(self, rows: IntArray) -> RowScaling | None:
        return None if self._measured is None else RowScaling(*(x[rows] for x in self._measured))

    def _entries(
        self,
        place: tuple[IntArray, IntArray, IntArray] | None,
        rows: IntArray,
        columns: IntArray,
    ) -> tuple[IntArray, IntArray, FloatArray] | None:
        if place is None:
            return None
        entries, i, j = place
        values = self._data[entries]
        if self._scale is not None:
            values = values * self._scale[columns[j]] * self._scale[rows[i]]
        return i, j, values


def _lower(pieces: tuple[Piece, ...]) -> Iterator[tuple[Piece, Piece]]:
    for high, piece in enumerate(pieces):
        for other in pieces[: high + 1]:
            yield piece, other


def _at_once(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def _itself(value: Any) -> Any:
    return value


def _places(branch: Branch, branches: list[Branch]) -> IntArray:
    """Where the rows below a branch are among those of the branch above."""
    if branch.above < 0:
        return np.empty(0, dtype=np.int64)
    return np.searchsorted(branches[branch.above].rows, branch.rows[branch.own :])
