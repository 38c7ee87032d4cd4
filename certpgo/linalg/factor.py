"""Sparse symmetric factorization behind one interface, with two engines.

SuperLU (always available in SciPy) in symmetric mode without pivoting, and CHOLMOD if the cvxopt
wheel is installed. Only a factorization that ran to completion counts as positive definite.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from certpgo.errors import MissingDependency, SpecError
from certpgo.linalg.arrays import CSC, FloatArray, IntArray

#: Number of nodes from which nested dissection is faster.
NESTED_FROM = 7500
#: Two-sided refinement of METIS: a few per cent less fill in large graphs.
TWO_SIDED = 2
#: Entries up to which CHOLMOD's memory is kept for the next factor.
KEPT = 1_000_000


class Factor(Protocol):
    """A Cholesky factorization A[p][:, p] = L L^T."""

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,) or (N, k)."""
        ...

    def lower(self) -> tuple[CSC, IntArray]:
        """L with positive diagonal, and the permutation p; afterwards `solve` cannot be called."""
        ...

    def excess(self, w: FloatArray) -> FloatArray:
        """Rounding error of the engine beyond that of a Cholesky factorization.

        (N,) row sums, weighted by ``w`` (N,) and both in the order p, that bound how far
        |A[p][:, p] - L L^T| may exceed (k + 8) u |L| |L|^T, k the row counts of L.
        """
        ...


class Symbolic(Protocol):
    """The analysis of a sparsity pattern, for all matrices with that pattern."""

    engine: str

    def factor(self, A: CSC) -> Factor | None:
        """Factorize A, which has this pattern; None if it is not positive definite."""
        ...


def engines() -> tuple[str, ...]:
    """Names of the installed engines, the preferred one first."""
    return ("cholmod", "superlu") if importlib.util.find_spec("cvxopt") else ("superlu",)


def default_engine() -> str:
    """The engine in use: ``CERTPGO_ENGINE`` if set, else the first installed."""
    return os.environ.get("CERTPGO_ENGINE") or engines()[0]


def analyze(A: CSC, *, order: IntArray | None = None, engine: str | None = None) -> Symbolic:
    """Analyse the pattern of a symmetric matrix (both triangles stored, sorted indices).

    Parameters
    ----------
    A : (N, N) matrix; only its pattern is used
    order : (N,) fill-reducing permutation; by default one is computed
    engine : ``"superlu"``, ``"cholmod"`` or None for `default_engine`

    Raises
    ------
    MissingDependency
        The engine is not installed.
    """
    p = fill_reducing_order(A.indptr, A.indices, engine=engine) if order is None else order
    return _engine(engine)(A, p)


def factorize(A: CSC, *, engine: str | None = None) -> Factor | None:
    """Analyse and factorize; None if A is not positive definite."""
    return analyze(A, engine=engine).factor(A)


def fill_reducing_order(
    indptr: IntArray, indices: IntArray, *, engine: str | None = None
) -> IntArray:
    """A fill-reducing permutation for the symmetric pattern in compressed form, (N,).

    Minimum degree; for large graphs nested dissection if METIS (pymetis) is installed.
    """
    n = len(indptr) - 1
    if n >= NESTED_FROM and importlib.util.find_spec("pymetis"):
        return _nested_dissection(indptr, indices)
    if (engine or default_engine()) == "cholmod":
        from cvxopt import amd

        order: IntArray = _array_of(amd.order(_cvxopt_lower(n, indptr, indices)[0]), np.intp)
        return order
    degree = np.diff(indptr)
    column = np.repeat(np.arange(n), degree)
    values = np.where(indices == column, degree[column].astype(float), -0.5)
    lu = _splu_without_pivoting(CSC((values, indices, indptr), shape=(n, n)), "MMD_AT_PLUS_A")
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


def _engine(name: str | None) -> Callable[[CSC, IntArray], Symbolic]:
    name = name or default_engine()
    if name == "superlu":
        return SuperLU
    if name != "cholmod":
        raise SpecError.unknown("engine", name, ("superlu", "cholmod"))
    if "cholmod" not in engines():
        raise MissingDependency("CHOLMOD (the cvxopt package)", "cholmod")
    return Cholmod


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


class SuperLU:
    """SciPy's SuperLU in symmetric mode on the diagonal: L D L^T with D from U's diagonal."""

    engine = "superlu"

    def __init__(self, A: CSC, order: IntArray) -> None:
        n = A.shape[0]
        self._order = order
        # Permute once and store where each entry went: refactoring is then a gather.
        labels = CSC((np.arange(1, A.nnz + 1, dtype=np.int64), A.indices, A.indptr), shape=(n, n))
        permuted = labels[order][:, order].tocsc()
        permuted.sort_indices()
        self._gather = permuted.data - 1
        self._indices, self._indptr = permuted.indices, permuted.indptr

    def factor(self, A: CSC) -> Factor | None:
        """Factorize A; None if a pivot is not positive, not finite, or off the diagonal."""
        permuted = CSC((A.data[self._gather], self._indices, self._indptr), shape=A.shape)
        lu = _splu_without_pivoting(permuted, "NATURAL")
        if lu is None or not np.array_equal(lu.perm_r, lu.perm_c):
            return None
        pivots = lu.U.diagonal()
        definite = np.all((pivots > 0.0) & (pivots < np.inf))
        return _SuperLUFactor(lu, pivots, self._order) if definite else None


class _SuperLUFactor:
    def __init__(self, lu: Any, pivots: FloatArray, order: IntArray) -> None:
        self._lu, self._pivots, self._order = lu, pivots, order

    def solve(self, B: FloatArray) -> FloatArray:
        X = np.empty_like(B, dtype=np.float64)
        X[self._order] = self._lu.solve(np.asarray(B, dtype=np.float64)[self._order])
        return X

    def excess(self, w: FloatArray) -> FloatArray:
        # |A - L U| <= k u |L| |U|, but rounding breaks the symmetry: U is not exactly D L^T.
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


class Cholmod:
    """CHOLMOD's supernodal Cholesky factorization, from the cvxopt wheel."""

    engine = "cholmod"

    def __init__(self, A: CSC, order: IntArray) -> None:
        from cvxopt import matrix

        self._matrix, self._lower = _cvxopt_lower(A.shape[0], A.indptr, A.indices)
        self._symbolic = (self._matrix, matrix(np.asarray(order, dtype=np.int64), tc="i"))
        self.size = A.shape[0]
        # A factor overwrites its analysis; analyses of deleted factors are reused.
        self._free: list[Any] = [self._analyze()]

    def factor(self, A: CSC) -> Factor | None:
        """Factorize A; None if CHOLMOD finds a pivot that is not positive."""
        values = A.data[self._lower]
        if not np.isfinite(values).all():
            return None
        factor = self._free.pop() if self._free else self._analyze()
        if self._numeric(factor, values):
            return _CholmodFactor(self, factor)
        self.give_back(factor)
        return None

    def give_back(self, factor: Any) -> None:
        """Keep the memory of an unused factor for the next one, unless it is large."""
        if factor is not None and len(self._lower) <= KEPT and not self._free:
            self._free.append(factor)

    def _analyze(self) -> Any:
        from cvxopt import cholmod

        with _own_options():
            return cholmod.symbolic(*self._symbolic)

    def _numeric(self, analysis: Any, values: FloatArray) -> bool:
        from cvxopt import cholmod, matrix

        self._matrix.V = matrix(values)
        try:
            with _own_options():
                cholmod.numeric(self._matrix, analysis)
        except ArithmeticError:
            return False
        return True


@contextmanager
def _own_options() -> Iterator[None]:
    """Set CHOLMOD's process-wide options to supernodal L L^T, and restore them afterwards."""
    from cvxopt import cholmod

    others = dict(cholmod.options)
    cholmod.options.clear()
    cholmod.options.update(supernodal=2, nmethods=1)  # use only our ordering
    try:
        yield
    finally:
        cholmod.options.clear()
        cholmod.options.update(others)


class _CholmodFactor:
    def __init__(self, symbolic: Cholmod, factor: Any) -> None:
        self._symbolic, self._factor = symbolic, factor
        self._lower: tuple[CSC, IntArray] | None = None

    def __del__(self) -> None:
        self._symbolic.give_back(self._factor)

    def excess(self, w: FloatArray) -> FloatArray:
        return np.zeros_like(w)

    def solve(self, B: FloatArray) -> FloatArray:
        return self._solve(np.asarray(B, dtype=np.float64), 0)

    def _solve(self, B: FloatArray, system: int) -> FloatArray:
        from cvxopt import cholmod, matrix

        X = matrix(np.asfortranarray(B))
        cholmod.solve(self._factor, X, sys=system)
        return np.array(X).reshape(B.shape)

    def lower(self) -> tuple[CSC, IntArray]:
        if self._lower is None:
            from cvxopt import cholmod

            # The analysis may postorder the given order: read the permutation from the factor.
            n = self._symbolic.size
            order = self._solve(np.arange(n, dtype=np.float64), 7).astype(np.intp)
            L = cholmod.getfactor(self._factor)
            self._factor = None  # getfactor leaves only the pattern in it
            pointers, rows, values = L.CCS
            del L
            arrays = np.asarray(values).ravel(), _array_of(rows, np.int32)
            self._lower = CSC((*arrays, _array_of(pointers, np.int32)), shape=(n, n)), order
        return self._lower


def _cvxopt_lower(n: int, indptr: IntArray, indices: IntArray) -> tuple[Any, IntArray]:
    """The lower triangle of a pattern as a cvxopt matrix, and the indices of its entries."""
    from cvxopt import matrix, spmatrix

    columns = np.repeat(np.arange(n, dtype=np.int64), np.diff(indptr))
    lower = np.flatnonzero(indices >= columns).astype(indptr.dtype)
    rows = matrix(np.asarray(indices[lower], dtype=np.int64), tc="i")
    return spmatrix(1.0, rows, matrix(columns[lower], tc="i"), (n, n)), lower


def _array_of(values: Any, dtype: Any) -> Any:
    return np.array(values, dtype=dtype).ravel()
