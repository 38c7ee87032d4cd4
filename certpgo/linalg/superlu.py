"""SciPy's SuperLU as an engine, where the compiled one is missing."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.residual import measured_residual
from certpgo.linalg.rounding_bound import RoundingBound, is_cholesky, rounding_of_factor

#: Nonzeros of a factor of SuperLU up to which its residual is measured.
MEASURABLE = 20e6


def minimum_degree(indptr: IntArray, indices: IntArray) -> IntArray:
    """SuperLU's fill-reducing order (n,) of a symmetric pattern."""
    lu = _splu_without_pivoting(_dominant(indptr, indices), "MMD_AT_PLUS_A")
    return np.asarray(np.argsort(lu.perm_c))


def _dominant(indptr: IntArray, indices: IntArray) -> CSC:
    """A definite matrix of that pattern."""
    n = len(indptr) - 1
    degree = np.diff(indptr)
    column = np.repeat(np.arange(n), degree)
    values = np.where(indices == column, degree[column].astype(float), -0.5)
    return CSC((values, indices, indptr), shape=(n, n))


def _splu_without_pivoting(A: CSC, ordering: str) -> Any:
    from scipy.sparse.linalg import splu

    try:
        return splu(
            A,
            permc_spec=ordering,
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True, "Equil": False},
        )
    except RuntimeError:  # an exactly zero pivot
        return None


class SuperLUAnalysis:
    """The analysis of a graph."""

    engine = "superlu"

    def __init__(self, indptr: IntArray, indices: IntArray, order: IntArray) -> None:
        self._pattern, self._order = (indptr, indices), order

    def blocks(self, sizes: IntArray) -> SuperLU:
        """That of matrices whose nodes have ``sizes`` (n,) rows."""
        permutation = np.argsort(np.repeat(np.argsort(self._order), sizes), kind="stable")
        return SuperLU(permutation, self._lengths(sizes))

    def _lengths(self, sizes: IntArray) -> FloatArray:
        n, order = len(sizes), self._order
        A = _dominant(*self._pattern)
        L = _splu_without_pivoting(A[order][:, order].tocsc(), "NATURAL").L.tocsc()
        lengths = np.empty(n)
        column = np.repeat(np.arange(n), np.diff(L.indptr))
        lengths[order] = np.bincount(L.indices, sizes[order][column], n)
        return np.repeat(lengths, sizes)


class SuperLU:
    """SciPy's SuperLU in symmetric mode on the diagonal: L D L^T with D from U's diagonal."""

    engine = "superlu"
    products = 8.0
    is_heavy = False  # it has no other precision

    def __init__(self, order: IntArray, lengths: FloatArray) -> None:
        self._order, self._lengths = order, lengths
        self._permuted: tuple[IntArray, IntArray, IntArray] | None = None

    @property
    def lengths(self) -> FloatArray:
        """(N,) nonzeros of L's rows, in the order of A."""
        return self._lengths

    @property
    def measurable(self) -> bool:
        """Whether a `residual` is worth its time and memory."""
        return float(self._lengths.sum()) <= MEASURABLE

    def factor(self, A: CSC, precision: str = "double") -> SuperLUFactor | None:
        """Factorize A; None if a pivot is not positive, not finite, or off the diagonal."""
        return self._factor(A)

    def multiply(self, A: CSC, x: FloatArray) -> FloatArray:
        """A x for x (N,)."""
        return np.asarray(A @ x)

    def _factor(self, A: CSC) -> SuperLUFactor | None:
        gather, indices, indptr = self._places(A)
        permuted = CSC((A.data[gather], indices, indptr), shape=A.shape)
        lu = _splu_without_pivoting(permuted, "NATURAL")
        if lu is None or not np.array_equal(lu.perm_r, lu.perm_c):
            return None
        pivots = lu.U.diagonal()
        definite = np.all((pivots > 0.0) & (pivots < np.inf))
        return SuperLUFactor(lu, pivots, self._order, permuted) if definite else None

    def _places(self, A: CSC) -> tuple[IntArray, IntArray, IntArray]:
        """Where each entry of the permuted matrix comes from, and its pattern."""
        if self._permuted is None:
            n, order = A.shape[0], self._order
            labels = CSC((np.arange(1, A.nnz + 1, dtype=np.int64), A.indices, A.indptr), (n, n))
            permuted = labels[order][:, order].tocsc()
            permuted.sort_indices()
            self._permuted = permuted.data - 1, permuted.indices, permuted.indptr
        return self._permuted

    def rounding(self, A: CSC, w: FloatArray) -> RoundingBound | None:
        """Factorize A, and bound the rounding with weights ``w`` (N,)."""
        factor = self._factor(A)
        if factor is None:
            return None
        L, p = factor.nonzeros
        sums, squares = rounding_of_factor(L, p, w)
        if not is_cholesky(squares, A):
            return None
        sums[p] += factor.excess(w[p])
        return RoundingBound(sums, int(L.nnz))

    def residual(self, A: CSC, w: FloatArray) -> RoundingBound | None:
        """The same, measured."""
        factor = self._factor(A)
        if factor is None:
            return None
        L, p = factor.nonzeros
        sums = measured_residual(A, L, p, w)
        return None if sums is None else RoundingBound(sums, int(L.nnz))


class SuperLUFactor:
    """A factorization, as one of Cholesky's."""

    def __init__(self, lu: Any, pivots: FloatArray, order: IntArray, permuted: CSC) -> None:
        self._lu, self._pivots, self._order, self._permuted = lu, pivots, order, permuted

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        X = np.empty_like(B, dtype=np.float64)
        permuted = np.asarray(B, dtype=np.float64)[self._order]
        # Iterations for eigenvectors need a symmetric inverse, which L U is only but for rounding.
        X[self._order] = 0.5 * (self._lu.solve(permuted) + self._lu.solve(permuted, "T"))
        return X

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of A."""
        return float(np.log(self._pivots).sum())

    def excess(self, w: FloatArray) -> FloatArray:
        """(N,) row sums that bound the rounding beyond that of a Cholesky factorization.

        |A - L U| <= k u |L| |U|, but rounding breaks the symmetry: U is not exactly D L^T.
        """
        L, U = self._lu.L.tocsc(), self._lu.U.tocsc()
        scaled = sparse.diags_array(self._pivots) @ L.T
        eps = float(np.finfo(float).eps)
        difference = abs(U - scaled) + 2.0 * eps * (abs(U) + abs(scaled))
        counts = np.bincount(L.indices, minlength=len(w))
        return np.asarray((1.0 + (counts + 4) * eps) * (abs(L) @ (difference @ w)))

    def lower(self) -> tuple[CSC, IntArray]:
        """L D^(1/2), with the zeros that A stores, and the rows p of A."""
        L, p = self.nonzeros
        A, place = self._permuted.tocoo(), self._lu.perm_c
        row, column = place[A.row], place[A.col]
        stored = row >= column
        known = L.tocoo()
        rows = np.concatenate([known.row, row[stored]])
        columns = np.concatenate([known.col, column[stored]])
        values = np.concatenate([known.data, np.zeros(np.count_nonzero(stored))])
        return CSC((values, (rows, columns)), shape=L.shape), p

    @cached_property
    def nonzeros(self) -> tuple[CSC, IntArray]:
        """L D^(1/2) without its zeros, and the rows p of A."""
        L = self._lu.L.tocsc(copy=True)
        L.data *= np.repeat(np.sqrt(self._pivots), np.diff(L.indptr))
        L.sort_indices()
        return CSC(L), self._order[np.argsort(self._lu.perm_c)]
