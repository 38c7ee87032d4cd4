"""Sparse Cholesky factorization behind one interface, with two engines.

`multifrontal` is compiled where certpgo is installed with a C compiler; SuperLU, which comes with
SciPy, serves everywhere. Matrices have square blocks, a row and column of blocks for each node of a
graph, which is analysed once for all block sizes. Only a factorization that ran to completion
counts as positive definite.
"""

from __future__ import annotations

import importlib.util
import os
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from certpgo.errors import MissingDependency, SpecError
from certpgo.linalg import multifrontal
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.balls import U
from certpgo.linalg.residual import measured_residual

#: Number of nodes from which nested dissection is faster.
NESTED_FROM = 20_000
#: Two-sided refinement of METIS: a few per cent less fill in large graphs.
TWO_SIDED = 2
#: Relative agreement of a Cholesky factor's squared row norms with the diagonal.
AGREEMENT = 1e-6
#: Multiplications of a factorization in the time in which a product and a solve read an entry of L.
FLOPS_PER_ENTRY = 60.0
#: Bytes from which a factor is heavy.
HEAVY = 4e9
#: Nonzeros of a factor of SuperLU up to which its residual is measured.
MEASURABLE = 20e6
#: How to install the compiled engine.
COMPILED = "--force-reinstall certpgo, where a C compiler is"
#: Operations on an entry of L besides its products: divisions, roots, their rounding.
OTHERS = 8.0


#: Of a factorization: "mixed" computes in double precision and keeps L in single.
Precision = Literal["double", "single", "mixed"]


class Factor(Protocol):
    """A Cholesky factorization A[p][:, p] = L L^T."""

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        ...

    def lower(self) -> tuple[CSC, IntArray]:
        """L with positive diagonal, and the permutation p."""
        ...


class Rounding(NamedTuple):
    """How far a Cholesky factorization is from exact.

    Attributes
    ----------
    sums : (N,) upper bounds on the row sums of |A - L L^T| with the weights of the columns
    nonzeros : of L
    """

    sums: FloatArray
    nonzeros: int


class Symbolic(Protocol):
    """The analysis of all matrices of a graph with blocks of certain sizes."""

    engine: str

    @property
    def lengths(self) -> FloatArray:
        """(N,) upper bounds on the nonzeros of L's rows, in the order of A."""
        ...

    @property
    def measurable(self) -> bool:
        """Whether a `residual` is worth its time and memory."""
        ...

    @property
    def products(self) -> float:
        """Products with A and solves that take about as long as a factorization."""
        ...

    def multiply(self, A: CSC, x: FloatArray) -> FloatArray:
        """A x for x (N,)."""
        ...

    @property
    def is_heavy(self) -> bool:
        """Whether a factor in double precision takes gigabytes."""
        ...

    def factor(self, A: CSC, precision: Precision = "double") -> Factor | None:
        """Factorize A, which has this pattern; None if it is not positive definite.

        In single precision that is less accurate, and may fail where another does not.
        """
        ...

    def rounding(self, A: CSC, w: FloatArray) -> Rounding | None:
        """Factorize A, and bound the rounding with weights ``w`` (N,); L is not kept."""
        ...

    def residual(self, A: CSC, w: FloatArray) -> Rounding | None:
        """The same, measured instead of bounded a priori: sharper, and four times the work."""
        ...


class Analysis(Protocol):
    """The analysis of a graph."""

    engine: str

    def blocks(self, sizes: IntArray) -> Symbolic:
        """That of matrices whose nodes have ``sizes`` (n,) rows."""
        ...


def engines() -> tuple[str, ...]:
    """Names of the engines that are here, the preferred one first."""
    return ("multifrontal", "superlu") if multifrontal.AVAILABLE else ("superlu",)


def default_engine() -> str:
    """The engine in use: ``CERTPGO_ENGINE`` if set, else the first available."""
    return os.environ.get("CERTPGO_ENGINE") or engines()[0]


def analyze(
    indptr: IntArray,
    indices: IntArray,
    *,
    order: IntArray | None = None,
    engine: str | None = None,
) -> Analysis:
    """Analyse a symmetric pattern in compressed form: sorted indices, diagonal included.

    Parameters
    ----------
    order : (n,) fill-reducing permutation; by default one is computed
    engine : ``"multifrontal"``, ``"superlu"`` or None for `default_engine`

    Raises
    ------
    MissingDependency
        The engine was not compiled.
    """
    if order is None:
        order = fill_reducing_order(indptr, indices)
    name = engine or default_engine()
    if name == "superlu":
        return _SuperLUAnalysis(indptr, indices, order)
    if name != "multifrontal":
        raise SpecError.unknown("engine", name, ("multifrontal", "superlu"))
    if name not in engines():
        raise MissingDependency("the compiled engine", package=COMPILED)
    return _FrontsAnalysis(indptr, indices, order)


def factorize(A: CSC, *, engine: str | None = None) -> Factor | None:
    """Analyse and factorize; None if A is not positive definite."""
    symbolic = analyze(A.indptr, A.indices, engine=engine).blocks(np.ones(A.shape[0], dtype=int))
    return symbolic.factor(A)


def fill_reducing_order(indptr: IntArray, indices: IntArray) -> IntArray:
    """A fill-reducing permutation for the symmetric pattern in compressed form, (n,).

    Minimum degree; for large graphs nested dissection if METIS (pymetis) is installed.
    """
    n = len(indptr) - 1
    if n >= NESTED_FROM and importlib.util.find_spec("pymetis"):
        return _nested_dissection(indptr, indices)
    if multifrontal.AVAILABLE:
        return multifrontal.minimum_degree(indptr, indices)
    lu = _splu_without_pivoting(_dominant(indptr, indices), "MMD_AT_PLUS_A")
    return np.asarray(np.argsort(lu.perm_c))


def _nested_dissection(indptr: IntArray, indices: IntArray) -> IntArray:
    import pymetis

    n = len(indptr) - 1
    column = np.repeat(np.arange(n), np.diff(indptr))
    others = indices != column  # METIS requires no self-loops
    starts = np.concatenate([[0], np.cumsum(np.bincount(column[others], minlength=n))])
    graph = pymetis.CSRAdjacency(starts.astype(np.int32), indices[others].astype(np.int32))
    order, _ = pymetis.nested_dissection(graph, options=pymetis.Options(rtype=TWO_SIDED))
    return np.asarray(order, dtype=np.intp)


class _FrontsAnalysis:
    engine = "multifrontal"

    def __init__(self, indptr: IntArray, indices: IntArray, order: IntArray) -> None:
        self._tree = multifrontal.Tree.of(indptr, indices, order)

    def blocks(self, sizes: IntArray) -> Symbolic:
        return _Multifrontal(multifrontal.Fronts(self._tree, sizes))


class _Multifrontal:
    """The compiled engine."""

    engine = "multifrontal"
    measurable = True

    @cached_property
    def products(self) -> float:
        # Products are bound by memory. Estimated, not timed, so that results can be reproduced.
        return 1.0 + self._fronts.flops / (FLOPS_PER_ENTRY * self._fronts.entries)

    def multiply(self, A: CSC, x: FloatArray) -> FloatArray:
        return self._fronts.multiply(A.data, x)

    def __init__(self, fronts: multifrontal.Fronts) -> None:
        self._fronts = fronts

    @cached_property
    def lengths(self) -> FloatArray:
        return self._fronts.lengths

    @property
    def is_heavy(self) -> bool:
        return 8 * self._fronts.entries > HEAVY

    def factor(self, A: CSC, precision: Precision = "double") -> Factor | None:
        if precision == "double":
            return self._fronts.factor(A.data)
        mixed = precision == "mixed"
        return self._fronts.factor_kept_single(A.data, A.diagonal(), mixed=mixed)

    def rounding(self, A: CSC, w: FloatArray) -> Rounding | None:
        terms = self.lengths + OTHERS
        both = _both(w, terms)
        found = self._fronts.row_sums(A.data, both)
        if found is None:
            return None
        absolute, squares = found
        if not _is_cholesky(squares, A):
            return None
        return Rounding(_least(absolute, terms), self._nonzeros)

    def residual(self, A: CSC, w: FloatArray) -> Rounding | None:
        diagonal = A.diagonal()
        if not (diagonal > 0.0).all():
            return None
        found = self._fronts.residual(A.data, diagonal, w)
        if found is None or not _is_cholesky(found[1], A):
            return None
        return Rounding(found[0], self._nonzeros)

    @property
    def _nonzeros(self) -> int:
        return int(self.lengths.sum())


def _both(w: FloatArray, terms: FloatArray) -> FloatArray:
    """(N, 2) weights of the two bounds that `_least` compares."""
    return np.stack([w, np.sqrt(terms) * w], axis=1)


def _least(absolute: FloatArray, terms: FloatArray) -> FloatArray:
    """(N,) bounds on the rounding, from |L| |L|^T times the weights of `_both`.

    An entry (i, j) of L L^T sums at most min(k_i, k_j) products, with k the row lengths of L: at
    most k_i, and at most the geometric mean.
    """
    by_row, by_mean = absolute.T
    return np.asarray(U * np.minimum(terms * by_row, np.sqrt(terms) * by_mean))


def _is_cholesky(squares: FloatArray, A: CSC) -> bool:
    """Whether the squared row norms of L match A's diagonal, as for Cholesky factors only."""
    diagonal = A.diagonal()
    return bool(np.all(np.abs(squares - diagonal) <= AGREEMENT * diagonal))


def _dominant(indptr: IntArray, indices: IntArray) -> CSC:
    """A definite matrix of that pattern."""
    n = len(indptr) - 1
    degree = np.diff(indptr)
    column = np.repeat(np.arange(n), degree)
    values = np.where(indices == column, degree[column].astype(float), -0.5)
    return CSC((values, indices, indptr), shape=(n, n))


def _splu_without_pivoting(A: CSC, ordering: str) -> Any:
    try:
        return splu(
            A,
            permc_spec=ordering,
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True, "Equil": False},
        )
    except RuntimeError:  # an exactly zero pivot
        return None


class _SuperLUAnalysis:
    engine = "superlu"

    def __init__(self, indptr: IntArray, indices: IntArray, order: IntArray) -> None:
        self._pattern, self._order = (indptr, indices), order

    def blocks(self, sizes: IntArray) -> Symbolic:
        permutation = np.argsort(np.repeat(np.argsort(self._order), sizes), kind="stable")
        return _SuperLU(permutation, self._lengths(sizes))

    def _lengths(self, sizes: IntArray) -> FloatArray:
        n, order = len(sizes), self._order
        A = _dominant(*self._pattern)
        L = _splu_without_pivoting(A[order][:, order].tocsc(), "NATURAL").L.tocsc()
        lengths = np.empty(n)
        column = np.repeat(np.arange(n), np.diff(L.indptr))
        lengths[order] = np.bincount(L.indices, sizes[order][column], n)
        return np.repeat(lengths, sizes)


class _SuperLU:
    """SciPy's SuperLU in symmetric mode on the diagonal: L D L^T with D from U's diagonal."""

    engine = "superlu"
    products = 8.0
    is_heavy = False  # it has no other precision

    def __init__(self, order: IntArray, lengths: FloatArray) -> None:
        self._order, self._lengths = order, lengths
        self._permuted: tuple[IntArray, IntArray, IntArray] | None = None

    @property
    def lengths(self) -> FloatArray:
        return self._lengths

    @property
    def measurable(self) -> bool:
        return float(self._lengths.sum()) <= MEASURABLE

    def factor(self, A: CSC, precision: Precision = "double") -> Factor | None:
        """Factorize A; None if a pivot is not positive, not finite, or off the diagonal."""
        return self._factor(A)

    def multiply(self, A: CSC, x: FloatArray) -> FloatArray:
        return np.asarray(A @ x)

    def _factor(self, A: CSC) -> _SuperLUFactor | None:
        gather, indices, indptr = self._places(A)
        permuted = CSC((A.data[gather], indices, indptr), shape=A.shape)
        lu = _splu_without_pivoting(permuted, "NATURAL")
        if lu is None or not np.array_equal(lu.perm_r, lu.perm_c):
            return None
        pivots = lu.U.diagonal()
        definite = np.all((pivots > 0.0) & (pivots < np.inf))
        return _SuperLUFactor(lu, pivots, self._order) if definite else None

    def _places(self, A: CSC) -> tuple[IntArray, IntArray, IntArray]:
        """Where each entry of the permuted matrix comes from, and its pattern."""
        if self._permuted is None:
            n, order = A.shape[0], self._order
            labels = CSC((np.arange(1, A.nnz + 1, dtype=np.int64), A.indices, A.indptr), (n, n))
            permuted = labels[order][:, order].tocsc()
            permuted.sort_indices()
            self._permuted = permuted.data - 1, permuted.indices, permuted.indptr
        return self._permuted

    def rounding(self, A: CSC, w: FloatArray) -> Rounding | None:
        factor = self._factor(A)
        if factor is None:
            return None
        L, p = factor.lower()
        terms, squares = np.empty(len(w)), np.empty(len(w))
        terms[p] = np.bincount(L.indices, minlength=len(w)) + OTHERS
        squares[p] = np.bincount(L.indices, L.data**2, minlength=len(w))
        if not _is_cholesky(squares, A):
            return None
        size, both = abs(L), _both(w, terms)
        absolute = np.empty_like(both)
        absolute[p] = size @ (size.T @ both[p])
        sums = _least(absolute, terms)
        sums[p] += factor.excess(w[p])
        return Rounding(sums, int(L.nnz))

    def residual(self, A: CSC, w: FloatArray) -> Rounding | None:
        factor = self._factor(A)
        if factor is None:
            return None
        L, p = factor.lower()
        sums = measured_residual(A, L, p, w)
        return None if sums is None else Rounding(sums, int(L.nnz))


class _SuperLUFactor:
    def __init__(self, lu: Any, pivots: FloatArray, order: IntArray) -> None:
        self._lu, self._pivots, self._order = lu, pivots, order

    def solve(self, B: FloatArray) -> FloatArray:
        X = np.empty_like(B, dtype=np.float64)
        X[self._order] = self._lu.solve(np.asarray(B, dtype=np.float64)[self._order])
        return X

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
        return self._lower

    @cached_property
    def _lower(self) -> tuple[CSC, IntArray]:
        L = self._lu.L.tocsc(copy=True)
        L.data *= np.repeat(np.sqrt(self._pivots), np.diff(L.indptr))
        L.sort_indices()
        return CSC(L), self._order[np.argsort(self._lu.perm_c)]
