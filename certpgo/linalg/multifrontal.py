"""Cholesky factorization by fronts, in compiled code, for blocks of any sizes.

The elimination tree is that of the graph of nodes; it is analysed once and serves blocks of every
size. A front is a dense matrix of a supernode's columns and of the rows below them: the columns are
factorized, and what they change in the rows is added to the parent's front (Duff and Reid 1983).
Dense work is done by SciPy's BLAS.

Row sums of |L| |L|^T, on which bounds of rounding rest, are added up front by front, so that L need
not be stored. docs/multifrontal.md has the analysis of rounding.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.compiled import AVAILABLE

__all__ = ["AVAILABLE", "Fronts", "Panels", "Tree", "minimum_degree"]


#: Compensates the rounding of sums of nonnegative numbers.
ROUNDED_UP = 1.001


#: Multiplications from which a factorization uses all threads of BLAS: some ten seconds of one.
PARALLEL = 3e11
#: Arrays of a factorization: weights, sums and squares, or scale, weights and sums.
Triple = tuple[FloatArray, FloatArray, FloatArray]
#: L, in double or single precision.
Kept = FloatArray | np.ndarray[Any, np.dtype[np.float32]]


@dataclass(frozen=True, eq=False)
class Tree:
    """The analysis of a graph of nodes.

    Attributes
    ----------
    indptr, indices : the pattern in compressed form, sorted, diagonal included
    order : (n,) elimination order of the nodes, a postorder of the one that was given
    lengths : (n,) entries in the rows of L, for nodes of one row
    start : (k + 1,) first node of each supernode, in that order
    above : (k,) parent of each supernode, -1 for roots
    begin, rows : the nodes below each supernode, in compressed form
    """

    indptr: IntArray
    indices: IntArray
    order: IntArray
    lengths: IntArray
    start: IntArray
    above: IntArray
    begin: IntArray
    rows: IntArray

    @staticmethod
    def of(
        indptr: IntArray, indices: IntArray, order: IntArray, sizes: IntArray | None = None
    ) -> Tree:
        """Analyse a pattern in a fill-reducing ``order`` (n,); ``sizes`` (n,) weigh the lengths."""
        pattern = _integers(indptr), _integers(indices)
        if sizes is None:
            sizes = np.ones(len(order), dtype=np.int64)
        found = compiled.kernel.analyze(*pattern, _integers(order), _integers(sizes))
        return Tree(*pattern, *(np.frombuffer(part, dtype=np.int64) for part in found))


class Fronts:
    """The fronts of matrices whose nodes have ``sizes`` (n,) rows."""

    def __init__(self, tree: Tree, sizes: IntArray) -> None:
        sizes = _integers(sizes)
        n, order = len(sizes), tree.order
        place = np.empty(n, dtype=np.int64)
        place[order] = np.arange(n)
        owner = np.repeat(np.arange(n), np.diff(tree.indptr))
        heights = np.bincount(owner, sizes[tree.indices], n).astype(np.int64)
        offset, panel = _running(sizes[order]), np.empty(len(tree.start), dtype=np.int64)
        room = compiled.kernel.measure(offset, tree.start, tree.above, tree.begin, tree.rows, panel)
        entry = _running(heights * sizes)
        pattern = tree.indptr, tree.indices, entry, order, place, sizes, offset
        self._fronts: Any = *pattern, tree.start, tree.above, tree.begin, tree.rows, panel, *room
        self.entries, self.size, self._tree = int(panel[-1]), int(offset[-1]), tree
        self._sizes, self._offset, self._panel = sizes, offset, panel

    @cached_property
    def order(self) -> IntArray:
        """(N,) row of A of each row of L."""
        starts = _running(self._sizes)[self._tree.order]
        sizes = self._sizes[self._tree.order]
        return np.asarray(np.repeat(starts - self._offset[:-1], sizes) + np.arange(self.size))

    @cached_property
    def lengths(self) -> FloatArray:
        """(N,) upper bounds on the nonzeros of L's rows, in the order of A."""
        tree, sizes, lengths = self._tree, self._sizes, np.empty(len(self._sizes))
        if (sizes != sizes[0]).any():
            tree, scale = Tree.of(tree.indptr, tree.indices, tree.order, sizes), 1
        else:
            scale = int(sizes[0])
        lengths[tree.order] = scale * tree.lengths
        return np.repeat(lengths, sizes)

    def factor(self, data: FloatArray) -> Panels | None:
        """The factor of the matrix with these entries; None if it is not positive definite."""
        panels = np.empty(self.entries)
        return Panels(self, panels) if self._run(data, panels=panels) else None

    def factor_kept_single(
        self, data: FloatArray, diagonal: FloatArray, *, mixed: bool = False
    ) -> Panels | None:
        """A factor in single precision, or with ``mixed`` of double arithmetic.

        Rows and columns are scaled by powers of two, so that the ``diagonal`` (N,) of the matrix is
        about one and no unit is out of range. None if the matrix is not positive definite, or not
        by as much as single precision demands.
        """
        if not ((diagonal > 0.0) & (diagonal < np.inf)).all():
            return None
        scale, panels = self._scale(diagonal), np.empty(self.entries, dtype=np.float32)
        done = self._run(data, scale=scale, panels=panels, single=not mixed)
        return Panels(self, panels, scale) if done else None

    def _run(
        self,
        data: FloatArray,
        *,
        scale: FloatArray | None = None,
        panels: Kept | None = None,
        sums: Triple | None = None,
        residual: Triple | None = None,
        single: bool = False,
    ) -> bool:
        """A factorization; threads of BLAS only wait for each other in small fronts."""
        arguments = data, scale, panels, None, sums, residual, single
        with nullcontext() if self.flops >= PARALLEL else _one_thread:
            return compiled.kernel.factor(self._fronts, *arguments)

    def _scale(self, diagonal: FloatArray) -> FloatArray:
        """(N,) powers of two that make the diagonal about one, in the order of L."""
        exponents = -np.round(0.5 * np.log2(diagonal)).astype(int)
        return np.asarray(np.ldexp(1.0, exponents)[self.order])

    def row_sums(
        self, data: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """|L| |L|^T w for weights w (N, k), and squared norms of rows (N,), in the order of A.

        None if the matrix is not positive definite.
        """
        w = np.ascontiguousarray(weights[self.order].T)
        sums, squares = np.zeros_like(w), np.zeros(self.size)
        if not self._run(data, sums=(w, sums, squares)):
            return None
        absolute, norms = np.empty_like(weights), np.empty(self.size)
        absolute[self.order], norms[self.order] = sums.T, squares
        return absolute, norms

    def residual(
        self, data: FloatArray, diagonal: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Upper bounds on |A - L L^T| w (N,), and squared norms of L's rows (N,), in A's order.

        The residual is measured front by front; the bounds hold if the squared norms are near the
        ``diagonal`` (N,) of A. None if the matrix is not positive definite.
        """
        scale = self._scale(diagonal)
        v, rows, squares = weights[self.order] / scale, np.zeros(self.size), np.zeros(self.size)
        sums = np.empty((0, self.size)), np.empty((0, self.size)), squares
        if not self._run(data, sums=sums, residual=(scale, v, rows)):
            return None
        bound, norms = np.empty(self.size), np.empty(self.size)
        bound[self.order], norms[self.order] = ROUNDED_UP * rows / scale, squares
        return bound, norms

    def multiply(self, data: FloatArray, x: FloatArray) -> FloatArray:
        """A x for x (N,)."""
        y = np.zeros(self.size)
        compiled.kernel.multiply(self._fronts, data, np.ascontiguousarray(x), y)
        return y

    @cached_property
    def flops(self) -> float:
        """Multiplications of a factorization."""
        entries, widths = np.diff(self._panel), np.diff(self._offset[self._tree.start])
        return float((entries * (entries / widths)).sum())

    def solve(self, panels: Kept, scale: FloatArray | None, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        right, kept = np.atleast_2d(B[self.order].T), panels.dtype
        if scale is not None:
            right = right * scale
        # Within the range of any precision.
        unit = np.ldexp(1.0, np.frexp(np.abs(right).max(axis=1, initial=0.0))[1])[:, None]
        X: Any = np.array(right / unit, dtype=kept, order="C")
        compiled.kernel.solve(self._fronts, panels, X, kept == np.float32, 0)
        X = X * unit if scale is None else X * (unit * scale)
        solution = np.empty(B.shape)
        solution[self.order] = X[0] if B.ndim == 1 else X.T
        return solution

    def lower(self, panels: Kept) -> CSC:
        """L, with the zeros that the merging of supernodes stores."""
        heights, rows = np.empty(self.size, dtype=np.int64), np.empty(self.entries, dtype=np.int64)
        values = np.empty(self.entries)
        used = compiled.kernel.lower(self._fronts, panels, heights, rows, values)
        return CSC((values[:used], rows[:used], _running(heights)), shape=(self.size,) * 2)


@dataclass(frozen=True, eq=False)
class Panels:
    """A factor: the columns of each supernode, perhaps of a matrix scaled by powers of two."""

    fronts: Fronts
    panels: Kept
    scale: FloatArray | None = None

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        return self.fronts.solve(self.panels, self.scale, B)

    def lower(self) -> tuple[CSC, IntArray]:
        """L and the rows p of A with A[p][:, p] = L L^T, in double precision only."""
        return self.fronts.lower(self.panels), self.fronts.order


def minimum_degree(indptr: IntArray, indices: IntArray) -> IntArray:
    """A fill-reducing order (n,) of a symmetric pattern (Amestoy, Davis, Duff 1996)."""
    found = compiled.kernel.order(_integers(indptr), _integers(indices))
    return np.frombuffer(found, dtype=np.int64)


class _OneThread:
    """Limits BLAS to one thread while any thread of Python is within; the last one restores."""

    def __init__(self) -> None:
        self._lock, self._within = Lock(), 0
        self._limiter: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._within:
                self._limiter = self._blas.limit(limits=1, user_api="blas")
            self._within += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                self._limiter.restore_original_limits()

    @cached_property
    def _blas(self) -> Any:
        from threadpoolctl import ThreadpoolController

        return ThreadpoolController()


_one_thread = _OneThread()


def _integers(values: IntArray) -> IntArray:
    return np.ascontiguousarray(values, dtype=np.int64)


def _running(values: IntArray) -> IntArray:
    return np.concatenate([[0], np.cumsum(values)])
