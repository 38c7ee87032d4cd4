"""Cholesky factorization by fronts, in compiled code, for blocks of any sizes.

The elimination tree is that of the graph of nodes; it is analysed once and serves blocks of every
size. A front is a dense matrix of a supernode's columns and of the rows below them: the columns are
factorized, and what they change in the rows is added to the parent's front (Duff and Reid 1983).
Dense work is done by SciPy's BLAS.

Row sums of |L| |L|^T, on which bounds of rounding rest, are added up front by front, so that L need
not be stored. docs/multifrontal.md has the analysis of rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.threads import PARALLEL, one_thread

#: Compensates the rounding of sums of nonnegative numbers.
ROUNDED_UP = 1.001


#: Arrays of a factorization: weights, sums and squares, or scale, weights and sums.
Triple = tuple[FloatArray, FloatArray, FloatArray]
#: Of a factorization: "mixed" computes in double precision and keeps L in single.
Precision = Literal["double", "single", "mixed"]
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


@dataclass(frozen=True, eq=False)
class Elimination:
    """What a factorization gives; all rows are in the order of L.

    Attributes
    ----------
    panels : L, if it is kept
    sums : (k, N) |L| |L|^T w
    squares : (N,) squared norms of L's rows, unless L is kept
    residual : (N,) bounds on the row sums of |A - L L^T|, scaled, if it is measured
    """

    panels: Any
    sums: FloatArray
    squares: FloatArray
    residual: FloatArray


class Fronts:
    """The fronts of matrices whose nodes have ``sizes`` (n,) rows.

    Attributes
    ----------
    tree : the elimination tree
    sizes : (n,)
    place : (n,) of each node in the elimination order
    offset : (n + 1,) where rows of L begin, in that order
    entry : (n + 1,) where the columns of each node begin among the entries of a matrix
    size : rows of the matrix
    entries : of L
    """

    def __init__(self, tree: Tree, sizes: IntArray) -> None:
        self.tree, self.sizes = tree, _integers(sizes)
        n, many = len(tree.order), len(tree.above)
        lengths = n, n + 1, n + 1, many + 1
        place, offset, entry, panel = (np.empty(k, dtype=np.int64) for k in lengths)
        fronts = tree.start, tree.above, tree.begin, tree.rows
        known = tree.indptr, tree.indices, tree.order, self.sizes, *fronts
        room = compiled.kernel.measure(*known, place, offset, entry, panel)
        pattern = tree.indptr, tree.indices, entry, tree.order, place, self.sizes, offset
        self.arrays: Any = *pattern, *fronts, panel, *room
        self.entries, self.size = int(panel[-1]), int(offset[-1])
        self.place, self.offset, self.entry, self._panel = place, offset, entry, panel

    @cached_property
    def order(self) -> IntArray:
        """(N,) row of A of each row of L."""
        starts = _running(self.sizes)[self.tree.order]
        sizes = self.sizes[self.tree.order]
        return np.asarray(np.repeat(starts - self.offset[:-1], sizes) + np.arange(self.size))

    @cached_property
    def lengths(self) -> FloatArray:
        """(N,) upper bounds on the nonzeros of L's rows, in the order of A."""
        tree, sizes, lengths = self.tree, self.sizes, np.empty(len(self.sizes))
        if (sizes != sizes[0]).any():
            tree, scale = Tree.of(tree.indptr, tree.indices, tree.order, sizes), 1
        else:
            scale = int(sizes[0])
        lengths[tree.order] = scale * tree.lengths
        return np.repeat(lengths, sizes)

    def factor(self, data: FloatArray) -> Panels | None:
        """The factor of the matrix with these entries; None if it is not positive definite."""
        done = self.eliminate(data, keep="double")
        return None if done is None else Panels(self, done.panels)

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
        scale = self._scale(diagonal)
        done = self.eliminate(data, scale=scale, keep="mixed" if mixed else "single")
        return None if done is None else Panels(self, done.panels, scale)

    def row_sums(
        self, data: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """|L| |L|^T w for weights w (N, k), and squared norms of rows (N,), in the order of A.

        None if the matrix is not positive definite.
        """
        done = self.eliminate(data, weights=np.take(weights.T, self.order, axis=1))
        if done is None:
            return None
        absolute, norms = np.empty_like(done.sums), np.empty(self.size)
        absolute[:, self.order], norms[self.order] = done.sums, done.squares
        return absolute.T, norms

    def residual(
        self, data: FloatArray, diagonal: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Upper bounds on |A - L L^T| w (N,), and squared norms of L's rows (N,), in A's order.

        The residual is measured front by front; the bounds hold if the squared norms are near the
        ``diagonal`` (N,) of A. None if the matrix is not positive definite.
        """
        scale = self._scale(diagonal)
        done = self.eliminate(data, measured=(scale, weights[self.order] / scale))
        if done is None:
            return None
        bound, norms = np.empty(self.size), np.empty(self.size)
        bound[self.order] = ROUNDED_UP * done.residual / scale
        norms[self.order] = done.squares
        return bound, norms

    def eliminate(
        self,
        data: FloatArray,
        *,
        scale: FloatArray | None = None,
        keep: Precision | None = None,
        weights: FloatArray | None = None,
        measured: tuple[FloatArray, FloatArray] | None = None,
    ) -> Elimination | None:
        """Factorize the matrix with these entries; None if it is not positive definite.

        Parameters
        ----------
        data : entries of the matrix
        scale : (N,) multiplies rows and columns
        keep : of what precision the factor is, if it is kept
        weights : (k, N), to sum |L| |L|^T w
        measured : (N,) powers of two that make the diagonal about one and weights over these, to
            measure the residual; only in double precision

        All rows are in the order of L.
        """
        panels: Any = None
        if keep is not None:
            panels = np.empty(self.entries, dtype=np.float64 if keep == "double" else np.float32)
        if weights is None:
            weights = np.empty((0, self.size))
        sums, squares, residual = np.zeros_like(weights), np.zeros(self.size), np.zeros(self.size)
        summed = None if keep else (_aligned(weights), sums, squares)
        wish = None if measured is None else (*map(_aligned, measured), residual)
        scale = None if scale is None else _aligned(scale)
        options: Any = scale, panels, summed, wish, keep == "single"
        data = _aligned(data)
        with one_thread.unless(self.is_parallel):
            done = compiled.kernel.factor(self.arrays, data, *options)
        return Elimination(panels, sums, squares, residual) if done else None

    def _scale(self, diagonal: FloatArray) -> FloatArray:
        """(N,) powers of two that make the diagonal about one, in the order of L."""
        exponents = -np.round(0.5 * np.log2(diagonal)).astype(int)
        return np.asarray(np.ldexp(1.0, exponents)[self.order])

    def multiply(self, data: FloatArray, x: FloatArray) -> FloatArray:
        """A x for x (N,)."""
        y = np.zeros(self.size)
        compiled.kernel.multiply(self.arrays, data, np.ascontiguousarray(x), y)
        return y

    @cached_property
    def work(self) -> FloatArray:
        """Multiplications of each supernode."""
        entries, widths = np.diff(self._panel), np.diff(self.offset[self.tree.start])
        return np.asarray(entries * (entries / widths))

    @cached_property
    def diagonal(self) -> IntArray:
        """(N,) where the diagonal of L is among its entries, in the order of L."""
        widths = np.diff(self.offset[self.tree.start])
        heights = np.diff(self._panel) // widths
        within = np.arange(self.size) - np.repeat(_running(widths)[:-1], widths)
        return np.asarray(
            np.repeat(self._panel[:-1], widths) + within * np.repeat(heights + 1, widths)
        )

    @cached_property
    def is_parallel(self) -> bool:
        """Whether threads of BLAS share a factorization."""
        # No supernode is higher than the matrix.
        return self.entries * self.size >= PARALLEL and self.flops >= PARALLEL

    @cached_property
    def flops(self) -> float:
        """Multiplications of a factorization."""
        return float(self.work.sum())

    def solve(self, panels: Kept, scale: FloatArray | None, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        B, X = np.ascontiguousarray(B, dtype=np.float64), np.empty(B.shape)
        single = panels.dtype == np.float32
        compiled.kernel.solve(self.arrays, _aligned(panels), scale, B, X, single)
        return X

    def lower(self, panels: Kept) -> CSC:
        """L, with the zeros that the merging of supernodes stores."""
        heights, rows = np.empty(self.size, dtype=np.int64), np.empty(self.entries, dtype=np.int64)
        values = np.empty(self.entries)
        used = compiled.kernel.lower(self.arrays, panels, heights, rows, values)
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

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of A."""
        log = float(np.log(self.panels[self.fronts.diagonal]).sum())
        return 2.0 * (log if self.scale is None else log - float(np.log(self.scale).sum()))

    def lower(self) -> tuple[CSC, IntArray]:
        """L and the rows p of A with A[p][:, p] = L L^T, in double precision only."""
        return self.fronts.lower(self.panels), self.fronts.order


def minimum_degree(indptr: IntArray, indices: IntArray) -> IntArray:
    """A fill-reducing order (n,) of a symmetric pattern (Amestoy, Davis, Duff 1996)."""
    found = compiled.kernel.order(_integers(indptr), _integers(indices))
    return np.frombuffer(found, dtype=np.int64)


def _integers(values: IntArray) -> IntArray:
    return np.ascontiguousarray(values, dtype=np.int64)


def _aligned(values: Any) -> Any:
    """The array, copied if compiled code cannot read it: contiguous, at an even address."""
    return np.require(values, requirements=["C", "A"])


def _running(values: IntArray) -> IntArray:
    return np.concatenate([[0], np.cumsum(values)])
