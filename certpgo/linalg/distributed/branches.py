"""The elimination tree, cut into tasks: subtrees, and the fronts of separators above them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.multifrontal import Fronts, Tree

#: Share of all multiplications that the subtree of one task has at most.
SHARE = 1.0 / 64.0
#: Rows of a tile of a separator's front: a tenth of a second of products, a hundred times the
#: overhead of a task.
TILE = 1024


@dataclass(frozen=True, eq=False)
class Branch:
    """A subtree, a few small ones with the same parent, or the front of a separator.

    Attributes
    ----------
    fronts : its supernodes; nodes are numbered from 0, those that are eliminated here first
    rows : (k,) rows of L, ascending, those of the nodes that are eliminated here first
    own : how many rows are eliminated here
    entries : which entries of the matrix the columns of a subtree have
    updates : of each root of the subtrees, or of the separator
    above : number of the branch that receives the updates, or -1
    tiles : of a separator's front, else None
    """

    fronts: Fronts
    rows: IntArray
    own: int
    entries: IntArray
    updates: tuple[Update, ...]
    above: int
    tiles: Tiles | None


@dataclass(frozen=True, eq=False)
class Update:
    """What elimination changes in the rows below a root.

    Attributes
    ----------
    size : its rows
    begin : where it begins among the updates of the branch
    pieces : its rows by the tiles that receive them
    """

    size: int
    begin: int
    pieces: tuple[Piece, ...]


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive rows of an update that belong to one tile of the branch above.

    Attributes
    ----------
    rows : of the update
    tile : of the branch above
    places : (k,) rows of that tile
    """

    rows: slice
    tile: int
    places: IntArray


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of a separator's front.

    Attributes
    ----------
    cuts : (t + 1,) where each begins among the rows of the front
    own : how many are eliminated
    entries : of pairs of tiles, which entries of the matrix they have, at which rows and columns
    """

    cuts: IntArray
    own: int
    entries: dict[tuple[int, int], tuple[IntArray, IntArray, IntArray]]

    def holding(self, rows: slice, own: int) -> tuple[int, slice]:
        """The tile with these rows of the update, of a front with ``own`` rows, and where there."""
        tile = int(np.searchsorted(self.cuts, own + rows.start, "right")) - 1
        shift = own - int(self.cuts[tile])
        return tile, slice(rows.start + shift, rows.stop + shift)

    def slices(self) -> list[slice]:
        """The rows of each tile."""
        return [slice(int(a), int(b)) for a, b in pairwise(self.cuts)]


def branches_of(fronts: Fronts, *, share: float = SHARE, tile: int = TILE) -> list[Branch]:
    """Cut a tree; children come before their parents."""
    most = share * fronts.flops
    ranges = _ranges(fronts.tree, _of_subtrees(fronts.tree, fronts.work), most)
    branch_of = np.repeat(np.arange(len(ranges)), [last - first for first, last, _ in ranges])
    branches: dict[int, Branch] = {}
    for number in reversed(range(len(ranges))):
        first, last, is_separator = ranges[number]
        above = int(fronts.tree.above[last - 1])
        receiver = int(branch_of[above]) if above >= 0 else -1
        branch = _Range(fronts, first, last)
        updates = branch.updates(branches.get(receiver))
        tiles = branch.tiles(updates[0], tile) if is_separator else None
        branches[number] = Branch(
            branch.local(with_columns=tiles is None),
            branch.rows,
            branch.own,
            branch.entries() if tiles is None else np.empty(0, dtype=np.int64),
            updates,
            receiver,
            tiles,
        )
    return [branches[number] for number in range(len(ranges))]


def _of_subtrees(tree: Tree, work: FloatArray) -> FloatArray:
    """Sums over subtrees."""
    sums = work.copy()
    for s, above in enumerate(tree.above.tolist()):
        if above >= 0:
            sums[above] += sums[s]
    return sums


def _ranges(tree: Tree, work: FloatArray, most: float) -> list[tuple[int, int, bool]]:
    """Supernodes of each branch and whether it is a separator; subtrees are postordered."""
    separators = work > most
    is_top = separators | (tree.above < 0) | separators[tree.above]
    ranges: list[tuple[int, int, bool]] = []
    grouped, first = 0.0, 0
    for top in np.flatnonzero(is_top).tolist():
        separator = bool(separators[top])
        if ranges and not separator and not ranges[-1][2]:
            begin, last, _ = ranges[-1]
            if tree.above[last - 1] == tree.above[top] and grouped + work[top] <= most:
                ranges[-1], grouped, first = (begin, top + 1, False), grouped + work[top], top + 1
                continue
        ranges.append((first, top + 1, separator))
        grouped, first = work[top], top + 1
    return ranges


class _Range:
    """Consecutive supernodes whose columns depend on those of no other, or on their children's."""

    def __init__(self, fronts: Fronts, first: int, last: int) -> None:
        tree = fronts.tree
        self._fronts, self._tree, self._first, self._last = fronts, tree, first, last
        self._start, self._stop = int(tree.start[first]), int(tree.start[last])
        is_root = (tree.above[first:last] >= last) | (tree.above[first:last] < 0)
        self._roots: list[int] = (first + np.flatnonzero(is_root)).tolist()
        below = [self._below(root) for root in self._roots]
        self._nodes = np.concatenate([np.arange(self._start, self._stop), _union(below)])
        offset = fronts.offset
        self.own = int(offset[self._stop] - offset[self._start])
        self.rows = self._rows_of(self._nodes)

    def _below(self, root: int) -> IntArray:
        return self._tree.rows[self._tree.begin[root] : self._tree.begin[root + 1]]

    def _rows_of(self, nodes: IntArray) -> IntArray:
        offset = self._fronts.offset
        return ranges_of(offset[nodes], offset[nodes + 1] - offset[nodes])

    def local(self, *, with_columns: bool) -> Fronts:
        """Its fronts; the columns of the matrix are of use only if children are in the range."""
        tree, fronts, first, last = self._tree, self._fronts, self._first, self._last
        lengths = np.zeros(len(self._nodes), dtype=np.int64)
        indices: IntArray = np.empty(0, dtype=np.int64)
        if with_columns:
            columns = tree.order[self._start : self._stop]
            lengths[: len(columns)] = np.diff(tree.indptr)[columns]
            neighbours = ranges_of(tree.indptr[columns], lengths[: len(columns)])
            indices = self._locally(fronts.place[tree.indices[neighbours]])
        above = tree.above[first:last] - first
        above[np.array(self._roots) - first] = -1
        begin = tree.begin[first : last + 1]
        local = Tree(
            indptr=np.concatenate([[0], np.cumsum(lengths)]),
            indices=indices,
            order=np.arange(len(self._nodes)),
            lengths=lengths,
            start=tree.start[first : last + 1] - self._start,
            above=above,
            begin=begin - begin[0],
            rows=self._locally(tree.rows[begin[0] : begin[-1]]),
        )
        return Fronts(local, fronts.sizes[tree.order[self._nodes]])

    def _locally(self, nodes: IntArray) -> IntArray:
        return np.searchsorted(self._nodes, nodes)

    def entries(self) -> IntArray:
        """Which entries of the matrix its columns have."""
        columns = self._tree.order[self._start : self._stop]
        begin = self._fronts.entry[columns]
        return ranges_of(begin, self._fronts.entry[columns + 1] - begin)

    def updates(self, receiver: Branch | None) -> tuple[Update, ...]:
        """The updates of its roots."""
        updates, begin = [], 0
        for root in self._roots:
            rows = self._rows_of(self._below(root))
            pieces = () if receiver is None else _pieces(rows, receiver)
            updates.append(Update(len(rows), begin, pieces))
            begin += len(rows) ** 2
        return tuple(updates)

    def tiles(self, update: Update, tile: int) -> Tiles:
        """The tiles of a single supernode; those of its update consist of whole pieces."""
        own = -(-self.own // tile)
        cuts: list[int] = np.linspace(0, self.own, own + 1).astype(int).tolist()
        ends = [self.own + piece.rows.stop for piece in update.pieces]
        for end, following in pairwise([*ends, math.inf]):
            if following - cuts[-1] > tile:
                cuts.append(int(end))
        tiles = Tiles(np.array(cuts, dtype=np.int64), own, {})
        tiles.entries.update(self._tile_entries(tiles))
        return tiles

    def _tile_entries(
        self, tiles: Tiles
    ) -> Iterator[tuple[tuple[int, int], tuple[IntArray, IntArray, IntArray]]]:
        fronts, tree = self._fronts, self._tree
        found: list[tuple[IntArray, IntArray, IntArray]] = []
        for k in range(self._start, self._stop):
            node = int(tree.order[k])
            near = fronts.place[tree.indices[tree.indptr[node] : tree.indptr[node + 1]]]
            sizes = fronts.offset[near + 1] - fronts.offset[near]
            rows, height = ranges_of(fronts.offset[near], sizes), int(sizes.sum())
            kept = np.flatnonzero(rows >= fronts.offset[k])
            for c in range(int(fronts.sizes[node])):
                entries = fronts.entry[node] + c * height + kept
                column = np.full(len(kept), fronts.offset[k] + c - self.rows[0])
                found.append((entries, np.searchsorted(self.rows, rows[kept]), column))
        entry, row, column = (
            np.concatenate(found_parts) for found_parts in zip(*found, strict=True)
        )
        lower = row >= column
        entry, row, column = entry[lower], row[lower], column[lower]
        i, j = (np.searchsorted(tiles.cuts, x, "right") - 1 for x in (row, column))
        order = np.lexsort((j, i))
        pairs, starts = np.unique(np.stack([i, j])[:, order], axis=1, return_index=True)
        for (ti, tj), own in zip(pairs.T.tolist(), np.split(order, starts[1:]), strict=True):
            at = row[own] - tiles.cuts[ti], column[own] - tiles.cuts[tj]
            yield (ti, tj), (entry[own], *at)


def _pieces(rows: IntArray, receiver: Branch) -> tuple[Piece, ...]:
    places, cuts = np.searchsorted(receiver.rows, rows), _cuts(receiver)
    tiles = np.searchsorted(cuts, places, "right") - 1
    starts = np.flatnonzero(np.diff(tiles, prepend=-1))
    return tuple(
        Piece(slice(a, b), int(tiles[a]), places[a:b] - cuts[tiles[a]])
        for a, b in pairwise([*starts.tolist(), len(rows)])
    )


def _cuts(separator: Branch) -> IntArray:
    """Only separators have branches below them."""
    return np.empty(0, dtype=np.int64) if separator.tiles is None else separator.tiles.cuts


def _union(below: list[IntArray]) -> IntArray:
    return np.unique(np.concatenate(below)) if below else np.empty(0, dtype=np.int64)


def ranges_of(starts: IntArray, lengths: IntArray) -> IntArray:
    """The integers of ranges, one range after another."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts - before, lengths) + np.arange(int(lengths.sum()))
