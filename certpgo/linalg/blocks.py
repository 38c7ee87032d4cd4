"""Sparse symmetric matrices of square blocks, a row per node and two blocks per edge."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """The block sparsity pattern shared by all matrices of a graph, of any block size.

    Attributes
    ----------
    num_nodes : number n of block rows
    edges : (m, 2) node pairs; the blocks of parallel edges are summed
    """

    num_nodes: int
    edges: IntArray

    @cached_property
    def _slots(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        n, (i, j) = self.num_nodes, self.edges.T
        nodes = np.arange(n)
        keys = np.concatenate([nodes * (n + 1), i * n + j, j * n + i])
        order = np.argsort(keys, kind="stable")
        first = np.diff(keys[order], prepend=-1) > 0
        slot = np.empty_like(order)
        slot[order] = np.cumsum(first) - 1
        rows, columns = np.divmod(keys[order][first], n)
        # 32 bits if possible, like SciPy.
        small: type[np.integer[Any]] = np.int32 if len(columns) < 2**31 else np.int64
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

    def layout(self, b: int) -> Layout:
        """Positions of the blocks' entries in a matrix of block size b."""
        if b not in self._layouts:
            self._layouts[b] = Layout(self, b)
        return self._layouts[b]

    @cached_property
    def _layouts(self) -> dict[int, Layout]:
        return {}

    def assemble(self, diagonal: FloatArray, upper: FloatArray) -> CSC:
        """The symmetric matrix of diagonal blocks and blocks ``upper[e]`` at edges e = (i, j).

        Parameters
        ----------
        diagonal : (n, b, b) symmetric blocks
        upper : (m, b, b); block (j, i) is the transpose

        Returns
        -------
        (n b, n b) matrix in CSC form with sorted indices, shared by matrices of one size
        """
        layout = self.layout(diagonal.shape[1])
        if compiled.AVAILABLE:
            data = np.zeros(len(layout.indices))
            diagonal, upper = np.ascontiguousarray(diagonal), np.ascontiguousarray(upper)
            compiled.kernel.assemble(self._places, diagonal, upper, data)
        else:
            data = self._assembled(layout, diagonal, upper)
        N = len(layout.indptr) - 1
        return CSC((data, layout.indices, layout.indptr), shape=(N, N))

    @cached_property
    def _places(self) -> tuple[IntArray, ...]:
        """Pointers, slots of diagonal blocks and of edges' blocks, and edges, for the kernel."""
        indptr, _, own, slots = self._slots
        return tuple(
            np.ascontiguousarray(part, dtype=np.int64) for part in (indptr, own, slots, self.edges)
        )

    def _assembled(self, layout: Layout, diagonal: FloatArray, upper: FloatArray) -> FloatArray:
        data = np.empty(len(layout.indices))
        data[layout.diagonal] = diagonal
        if self._summation is None:
            data[layout.pairs] = upper
        else:
            order, starts, _ = self._summation
            pairs = np.concatenate([upper, np.swapaxes(upper, 1, 2)])
            data[layout.pairs] = np.add.reduceat(pairs[order], starts, axis=0)
        return data


class Layout:
    """A block pattern for blocks of b rows."""

    def __init__(self, pattern: BlockPattern, b: int) -> None:
        self._pattern, self._b = pattern, b
        size = b * b * len(pattern.indices)
        # 32 bits if possible, like SciPy.
        self._integers: type[np.integer[Any]] = np.int32 if size < 2**31 else np.int64

    @cached_property
    def indptr(self) -> IntArray:
        """Column pointers of the matrix."""
        heights = np.repeat(self._b * np.diff(self._pattern.indptr), self._b)
        return np.concatenate([[0], np.cumsum(heights)]).astype(self._integers)

    @cached_property
    def indices(self) -> IntArray:
        """Rows of the entries, ascending in each column."""
        b, indices = self._b, self._pattern.indices
        columns = np.empty(b * b * len(indices), dtype=self._integers)
        if compiled.AVAILABLE and columns.dtype == np.int32:
            indptr = self._pattern.indptr.astype(np.int64)
            compiled.kernel.expand(indptr, indices.astype(np.int64), b, columns)
        else:
            rows = (b * indices.astype(self._integers))[:, None, None]
            columns[self._places()] = rows + np.arange(b, dtype=self._integers)
        return columns

    @cached_property
    def diagonal(self) -> IntArray:
        """(n, b, b) positions in ``data`` of the entries of diagonal blocks."""
        b, indptr, own = self._b, self._pattern.indptr, self._pattern.own
        counts = np.diff(indptr)[:, None, None]
        first = b * (b * indptr[:-1] + own - indptr[:-1])
        within = b * counts * np.arange(b)[:, None] + np.arange(b)
        return np.asarray((first[:, None, None] + within).astype(self._integers))

    @cached_property
    def pairs(self) -> IntArray:
        """(2, m, b, b) the same for the blocks of edges and their transposes.

        For a graph with parallel edges (k, b, b), for the k occupied blocks off the diagonal.
        """
        places, slots = self._places(), self._pattern.slots
        if self._pattern._merged is not None:
            return np.asarray(places[self._pattern._merged])
        forward, backward = np.split(slots, 2)
        return np.stack([places[forward], np.swapaxes(places[backward], 1, 2)])

    def _places(self) -> IntArray:
        """(k, b, b) positions of the entries of all blocks."""
        b, indptr, indices = self._b, self._pattern.indptr, self._pattern.indices
        counts = np.diff(indptr)
        row = np.repeat(np.arange(len(counts)), counts)
        within = np.arange(len(indices)) - indptr[row]
        starts = self.indptr[:-1].reshape(-1, b)
        lines = (starts[row] + (b * within)[:, None]).astype(self._integers)
        return np.asarray(lines[:, :, None] + np.arange(b, dtype=self._integers))


def adjacency(n: int, i: IntArray, j: IntArray, values: FloatArray) -> sparse.csr_array:
    """The (n, n) matrix with ``values`` at (i, j), repeated pairs summed, for csgraph."""
    # csgraph needs 32-bit indices; SciPy before 1.17 does not convert them.
    pairs = np.asarray(i, dtype=np.int32), np.asarray(j, dtype=np.int32)
    return sparse.coo_array((values, pairs), shape=(n, n)).tocsr()


def scatter_sum(index: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Sum ``values`` (m, ...) into (n, ...) by ``index`` (m,)."""
    flat = values.reshape(len(index), -1)
    if compiled.AVAILABLE:
        sums, rows = np.zeros((n, flat.shape[1])), np.ascontiguousarray(index, dtype=np.int64)
        flat = np.ascontiguousarray(flat, dtype=np.float64)
        compiled.kernel.scatter_sum(rows, flat, sums, flat.shape[1])
        return sums.reshape(n, *values.shape[1:])
    out = np.empty((n, flat.shape[1]))
    for k in range(flat.shape[1]):
        out[:, k] = np.bincount(index, weights=flat[:, k], minlength=n)
    return out.reshape(n, *values.shape[1:])


def diagonal_places(A: CSC) -> IntArray:
    """(N,) positions of the diagonal entries in ``A.data``; all must be stored."""
    if compiled.AVAILABLE and A.indices.dtype == A.indptr.dtype == np.int32:
        places = np.empty(A.shape[0], dtype=np.int64)
        compiled.kernel.diagonal_places(A.indptr, A.indices, places)
        return places
    column = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr))
    return np.flatnonzero(A.indices == column)


def add_to_diagonal(A: CSC, values: FloatArray | float) -> CSC:
    """A + diag(values), with the pattern of A."""
    data = A.data.copy()
    data[diagonal_places(A)] += values
    return CSC((data, A.indices, A.indptr), shape=A.shape)


def pinned(A: CSC, rows: IntArray) -> CSC:
    """A with ``rows`` and the same columns set to zero, except on the diagonal.

    The rest is the principal submatrix; the pattern stays the same.
    """
    data, cut = A.data.copy(), np.zeros(A.shape[0], dtype=bool)
    cut[rows] = True
    diagonal = diagonal_places(A)[rows]
    kept = data[diagonal]
    own = _entries(A, rows)
    data[own] = 0.0
    # By symmetry the rows' entries are in the columns of the columns' rows.
    others = _entries(A, np.unique(A.indices[own]))
    data[others[cut[A.indices[others]]]] = 0.0
    data[diagonal] = kept
    return CSC((data, A.indices, A.indptr), shape=A.shape)


def _entries(A: CSC, columns: IntArray) -> IntArray:
    """Positions in ``A.data`` of all entries of some columns."""
    counts = np.diff(A.indptr)[columns]
    before = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.asarray(np.repeat(A.indptr[columns] - before, counts) + np.arange(counts.sum()))
