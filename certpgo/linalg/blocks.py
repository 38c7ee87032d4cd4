"""Sparse symmetric matrices of blocks, a row of blocks per node and two blocks per edge.

Nodes are poses or points. The blocks of points are smaller, the leading part of a pose's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """The block sparsity pattern shared by all matrices of a graph, of any block size.

    Attributes
    ----------
    num_nodes : number n of block rows
    edges : (m, 2) node pairs; the blocks of parallel edges are summed
    points : (n,) which nodes are points, or None
    """

    num_nodes: int
    edges: IntArray
    points: BoolArray | None = None

    @cached_property
    def _slots(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        n, (i, j) = self.num_nodes, self.edges.T
        if compiled.AVAILABLE:
            pairs = np.ascontiguousarray(self.edges, dtype=np.int64)
            whole = n + pairs.size
            indptr, indices, slot = (np.empty(k, dtype=np.int64) for k in (n + 1, whole, whole))
            indices = indices[: compiled.kernel.blocks(pairs, indptr, indices, slot)]
            small = integers_for(len(indices))
            return indptr.astype(small), indices.astype(small), slot[:n], slot[n:]
        nodes = np.arange(n)
        keys = np.concatenate([nodes * (n + 1), i * n + j, j * n + i])
        order = np.argsort(keys, kind="stable")
        first = np.diff(keys[order], prepend=-1) > 0
        slot = np.empty_like(order)
        slot[order] = np.cumsum(first) - 1
        rows, columns = np.divmod(keys[order][first], n)
        small = integers_for(len(columns))
        indptr = np.searchsorted(rows, np.arange(n + 1)).astype(small)
        return indptr, columns.astype(small), slot[:n], slot[n:]

    @property
    def indptr(self) -> IntArray:
        """(n + 1,) row pointers of the occupied blocks, diagonal included."""
        return self._slots[0]

    @property
    def indices(self) -> IntArray:
        """Column of each occupied block, ascending within its row."""
        return self._slots[1]

    @property
    def own(self) -> IntArray:
        """(n,) which occupied block is each node's diagonal block."""
        return self._slots[2]

    @property
    def slots(self) -> IntArray:
        """(2m,) which are those of the edges (i, j), then of (j, i)."""
        return self._slots[3]

    @property
    def _merged(self) -> IntArray | None:
        """Occupied blocks off the diagonal if there are parallel edges, else None."""
        return None if self._summation is None else self._summation[2]

    @cached_property
    def _summation(self) -> tuple[IntArray, IntArray, IntArray] | None:
        """Order and starts to sum blocks of parallel edges; None for a simple graph."""
        slot = self._slots[3]
        order = np.argsort(slot, kind="stable")
        target, starts = np.unique(slot[order], return_index=True)
        return None if len(target) == len(slot) else (order, starts, target)

    def layout(self, b: int, of_points: int | None = None) -> Layout:
        """Places in matrices of blocks of b rows, those of points ``of_points``, by default b."""
        points = None if of_points in (None, b) else self.points
        key = b, b if points is None or of_points is None else of_points
        if key not in self._layouts:
            self._layouts[key] = Layout(self, *key, points)
        return self._layouts[key]

    def layout_of(self, A: CSC) -> Layout:
        """That of a matrix which this pattern assembled, or of one with equal blocks."""
        # A copy, as another thread may add to them.
        found = (known for known in list(self._layouts.values()) if known.size == A.shape[0])
        return next(found, None) or self.layout(A.shape[0] // self.num_nodes)

    @cached_property
    def _layouts(self) -> dict[tuple[int, int], Layout]:
        """By the rows of poses and of points."""
        return {}

    def assemble(
        self, diagonal: FloatArray, upper: FloatArray, of_points: int | None = None
    ) -> CSC:
        """The symmetric matrix of diagonal blocks and blocks ``upper[e]`` at edges e = (i, j).

        Parameters
        ----------
        diagonal : (n, b, b) symmetric blocks
        upper : (m, b, b); block (j, i) is the transpose
        of_points : leading rows of blocks that points have; by default b

        Returns
        -------
        (N, N) matrix in CSC form with sorted indices, shared by matrices of one size
        """
        layout = self.layout(diagonal.shape[1], of_points)
        if compiled.AVAILABLE:
            data = np.zeros(layout.padded)
            diagonal, upper = np.ascontiguousarray(diagonal), np.ascontiguousarray(upper)
            compiled.kernel.assemble(self._places, diagonal, upper, data)
        else:
            data = self._assembled(layout, diagonal, upper)
        if layout._kept is not None:
            data = data[layout._kept]
        return with_entries(layout.template, data)

    def subtract(self, A: CSC, blocks: FloatArray) -> CSC:
        """A minus ``blocks`` (n, d, d) in the last rows of the diagonal blocks that are whole."""
        layout, data, d = self.layout_of(A), A.data.copy(), blocks.shape[-1]
        if compiled.AVAILABLE and layout._kept is None:
            indptr, own, *_ = self._places
            values = np.ascontiguousarray(blocks)
            compiled.kernel.subtract(indptr, own, layout._b, values, d, data)
        else:
            data[layout.diagonal[:, -d:, -d:]] -= blocks[layout.whole]
        return with_entries(A, data)

    @cached_property
    def _places(self) -> tuple[IntArray, ...]:
        """Pointers, slots of diagonal blocks and of edges' blocks, and edges, for the kernel."""
        indptr, _, own, slots = self._slots
        return tuple(
            np.ascontiguousarray(part, dtype=np.int64) for part in (indptr, own, slots, self.edges)
        )

    def places(self) -> tuple[IntArray, ...]:
        """`indptr`, `own` and `slots`, for the kernel."""
        return self._places[:3]

    def _assembled(self, layout: Layout, diagonal: FloatArray, upper: FloatArray) -> FloatArray:
        data = np.empty(layout.padded)
        data[layout.diagonal_blocks] = diagonal
        if self._summation is None:
            data[layout.pairs] = upper
        else:
            order, starts, _ = self._summation
            pairs = np.concatenate([upper, np.swapaxes(upper, 1, 2)])
            data[layout.pairs] = np.add.reduceat(pairs[order], starts, axis=0)
        return data


class Layout:
    """A block pattern for blocks of b rows, points having only the leading ``of_points``.

    Matrices are assembled from whole blocks; what belongs to no row of a point is then left out.
    """

    def __init__(
        self, pattern: BlockPattern, b: int, of_points: int, points: BoolArray | None
    ) -> None:
        self._pattern, self._b = pattern, b
        self.padded = b * b * len(pattern.indices)
        self._integers = integers_for(self.padded)
        n = pattern.num_nodes
        self.sizes: IntArray = np.full(n, b)
        self._rows: IntArray | None = None
        if points is not None:
            self.sizes = np.where(points, of_points, b)
            self._rows = np.flatnonzero(np.tile(np.arange(b), n) < np.repeat(self.sizes, b))
        self.size = int(self.sizes.sum())

    def pack(self, values: FloatArray) -> FloatArray:
        """(N, ...) rows of the matrix from (n, b, ...) of the nodes."""
        flat = values.reshape(-1, *values.shape[2:])
        return flat if self._rows is None else np.asarray(flat[self._rows])

    def unpack(self, rows: FloatArray) -> FloatArray:
        """(n, b, ...) of the nodes from (N, ...), zero for what points do not have."""
        if self._rows is None:
            return rows.reshape(-1, self._b, *rows.shape[1:])
        flat = np.zeros((len(self.sizes) * self._b, *rows.shape[1:]))
        flat[self._rows] = rows
        return flat.reshape(-1, self._b, *rows.shape[1:])

    def first_row(self, node: int) -> int:
        """The first row of a node."""
        return int(self.sizes[:node].sum())

    def rows_of(self, node: int) -> IntArray:
        """The rows of a node, ascending."""
        return self.first_row(node) + np.arange(self.sizes[node])

    def trailing(self, k: int) -> BoolArray:
        """(N,) which rows are among the last k of whole blocks."""
        last = np.arange(self._b) >= self._b - k
        return np.asarray(self.pack(last & (self.sizes == self._b)[:, None]))

    @cached_property
    def _kept(self) -> IntArray | None:
        """Which entries of the padded matrix are those of the matrix; None for all."""
        if self._rows is None:
            return None
        row = np.isin(np.arange(len(self.sizes) * self._b), self._rows)
        indptr, indices = self._padded_pattern
        column = np.repeat(row, np.diff(indptr))
        return np.flatnonzero(row[indices] & column)

    @cached_property
    def _padded_pattern(self) -> tuple[IntArray, IntArray]:
        """Column pointers and rows of the padded matrix."""
        b, indices = self._b, self._pattern.indices
        heights = np.repeat(b * np.diff(self._pattern.indptr), b)
        starts = np.concatenate([[0], np.cumsum(heights)]).astype(self._integers)
        rows = np.empty(self.padded, dtype=self._integers)
        if compiled.AVAILABLE and rows.dtype == np.int32:
            indptr = self._pattern.indptr.astype(np.int64)
            compiled.kernel.expand(indptr, indices.astype(np.int64), b, rows)
        else:
            firsts = (b * indices.astype(self._integers))[:, None, None]
            rows[self._blocks(starts)] = firsts + np.arange(b, dtype=self._integers)
        return starts, rows

    @cached_property
    def indptr(self) -> IntArray:
        """Column pointers of the matrix."""
        starts, _ = self._padded_pattern
        if self._kept is None or self._rows is None:
            return starts
        counts = np.searchsorted(self._kept, starts)
        return np.append(counts[self._rows], counts[-1]).astype(self._integers)

    @cached_property
    def indices(self) -> IntArray:
        """Rows of the entries, ascending in each column."""
        _, rows = self._padded_pattern
        if self._kept is None or self._rows is None:
            return rows
        place = np.zeros(len(self.sizes) * self._b, dtype=self._integers)
        place[self._rows] = np.arange(len(self._rows))
        return np.asarray(place[rows[self._kept]])

    @cached_property
    def template(self) -> CSC:
        """A matrix of this pattern, for `with_entries`; its own entries take no memory."""
        return sparse_of(
            self.size, np.broadcast_to(0.0, len(self.indices)), self.indices, self.indptr
        )

    @cached_property
    def whole(self) -> IntArray:
        """The nodes with whole blocks."""
        return np.flatnonzero(self.sizes == self._b)

    def still(self, *known: int | None) -> int:
        """The node that stands still: the first known one, else the first with a whole block."""
        return next((node for node in known if node is not None), int(self.whole[0]))

    @cached_property
    def diagonal(self) -> IntArray:
        """(k, b, b) positions in ``data`` of the entries of `whole` diagonal blocks."""
        kept, places = self._kept, self.diagonal_blocks
        return places if kept is None else np.searchsorted(kept, places[self.whole])

    @cached_property
    def diagonal_blocks(self) -> IntArray:
        """(n, b, b) the same of all blocks among the padded matrix' entries."""
        b, indptr, own = self._b, self._pattern.indptr, self._pattern.own
        counts = np.diff(indptr)[:, None, None]
        first = b * (b * indptr[:-1] + own - indptr[:-1])
        within = b * counts * np.arange(b)[:, None] + np.arange(b)
        return np.asarray((first[:, None, None] + within).astype(self._integers))

    @cached_property
    def pairs(self) -> IntArray:
        """(2, m, b, b) the same for the padded blocks of edges and their transposes.

        For a graph with parallel edges (k, b, b), for the k occupied blocks off the diagonal.
        """
        places, slots = self._blocks(self._padded_pattern[0]), self._pattern.slots
        if self._pattern._merged is not None:
            return np.asarray(places[self._pattern._merged])
        forward, backward = np.split(slots, 2)
        return np.stack([places[forward], np.swapaxes(places[backward], 1, 2)])

    def _blocks(self, starts: IntArray) -> IntArray:
        """(k, b, b) positions of the entries of all padded blocks."""
        b, indptr, indices = self._b, self._pattern.indptr, self._pattern.indices
        counts = np.diff(indptr)
        row = np.repeat(np.arange(len(counts)), counts)
        within = np.arange(len(indices)) - indptr[row]
        lines = (starts[:-1].reshape(-1, b)[row] + (b * within)[:, None]).astype(self._integers)
        return np.asarray(lines[:, :, None] + np.arange(b, dtype=self._integers))


def integers_for(entries: int) -> type[np.integer[Any]]:
    """The indices of a matrix of so many entries: 32 bits if possible, like SciPy."""
    return np.int32 if entries < 2**31 else np.int64


def scatter_sum(index: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Sum ``values`` (m, ...) into (n, ...) by ``index`` (m,)."""
    flat = np.ascontiguousarray(values.reshape(len(index), -1), dtype=np.float64)
    if compiled.AVAILABLE:
        sums, rows = np.zeros((n, flat.shape[1])), np.ascontiguousarray(index, dtype=np.int64)
        compiled.kernel.scatter_sum(rows, flat, sums, flat.shape[1])
        return sums.reshape(n, *values.shape[1:])
    out = np.empty((n, flat.shape[1]))
    for k in range(flat.shape[1]):
        out[:, k] = np.bincount(index, weights=flat[:, k], minlength=n)
    return out.reshape(n, *values.shape[1:])


_NOTHING = CSC((1, 1))


def sparse_of(n: int, data: FloatArray, indices: IntArray, indptr: IntArray) -> CSC:
    """The (n, n) matrix of these arrays, unchecked: that takes SciPy longer than assembly."""
    A = with_entries(_NOTHING, data)
    A.indices, A.indptr, A._shape = indices, indptr, (n, n)
    return A


def with_entries(A: CSC, data: FloatArray) -> CSC:
    """The matrix with the pattern of A and entries ``data``, in the order of ``A.data``."""
    # `copy.copy` takes ten times as long.
    other: CSC = object.__new__(type(A))
    other.__dict__.update(A.__dict__, data=data)
    return other


def divided(A: CSC, root: FloatArray) -> CSC:
    """The matrix with entries A_rs / (root_r root_s), for root (N,)."""
    column = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr))
    return with_entries(A, A.data / (root[A.indices] * root[column]))


def diagonal_places(A: CSC) -> IntArray:
    """(N,) positions of the diagonal entries in ``A.data``; all must be stored."""
    if compiled.AVAILABLE and A.indices.dtype == A.indptr.dtype == np.int32:
        places = np.empty(A.shape[0], dtype=np.int64)
        compiled.kernel.diagonal_places(A.indptr, A.indices, places)
        return places
    column = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr))
    return np.flatnonzero(A.indices == column)


def diagonal_of(A: CSC) -> FloatArray:
    """(N,) the diagonal, all of which must be stored; SciPy's way takes some ten times as long."""
    return np.asarray(A.data[diagonal_places(A)])


def add_to_diagonal(A: CSC, values: FloatArray | float) -> CSC:
    """A + diag(values), with the pattern of A."""
    data = A.data.copy()
    data[diagonal_places(A)] += values
    return with_entries(A, data)


def pinned(A: CSC, rows: IntArray) -> CSC:
    """A with ``rows`` and the same columns set to zero, except on the diagonal.

    The rest is the principal submatrix; the pattern stays the same.
    """
    data = A.data.copy()
    if compiled.AVAILABLE and A.indices.dtype == A.indptr.dtype == np.int32:
        rows = np.ascontiguousarray(rows, dtype=np.int64)
        compiled.kernel.pin(A.indptr, A.indices, data, rows)
        return with_entries(A, data)
    cut = np.isin(np.arange(A.shape[0]), rows)
    diagonal = diagonal_places(A)[rows]
    kept = data[diagonal]
    own = _entries(A, rows)
    data[own] = 0.0
    # By symmetry the rows' entries are in the columns of the columns' rows.
    others = _entries(A, np.unique(A.indices[own]))
    data[others[cut[A.indices[others]]]] = 0.0
    data[diagonal] = kept
    return with_entries(A, data)


def _entries(A: CSC, columns: IntArray) -> IntArray:
    """Positions in ``A.data`` of all entries of some columns."""
    counts = np.diff(A.indptr)[columns]
    before = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.asarray(np.repeat(A.indptr[columns] - before, counts) + np.arange(counts.sum()))
