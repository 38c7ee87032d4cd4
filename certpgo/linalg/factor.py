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
from typing import Protocol

import numpy as np

from certpgo.errors import MissingDependency, SpecError
from certpgo.linalg import compiled, multifrontal, superlu
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import diagonal_of
from certpgo.linalg.multifrontal import Precision
from certpgo.linalg.rounding_bound import (
    OTHERS,
    RoundingBound,
    is_cholesky,
    least_of_both,
    weights_of_both,
)

#: Number of nodes from which nested dissection is faster.
NESTED_FROM = 20_000
#: Two-sided refinement of METIS: a few per cent less fill in large graphs.
TWO_SIDED = 2
#: Multiplications of a factorization in the time in which a product and a solve read an entry of L.
FLOPS_PER_ENTRY = 60.0
#: Bytes from which a factor is heavy.
HEAVY = 4e9


class LinearSolver(Protocol):
    """What solves with a matrix A."""

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,); factors take (N, k), too."""
        ...


class Factor(LinearSolver, Protocol):
    """A Cholesky factorization A[p][:, p] = L L^T."""

    @property
    def log_det(self) -> float:
        """The logarithm of the determinant of A."""
        ...

    def lower(self) -> tuple[CSC, IntArray]:
        """L with positive diagonal, and the permutation p."""
        ...


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

    def rounding(self, A: CSC, w: FloatArray) -> RoundingBound | None:
        """Factorize A, and bound the rounding with weights ``w`` (N,); L is not kept."""
        ...

    def residual(self, A: CSC, w: FloatArray) -> RoundingBound | None:
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
    return ("multifrontal", "superlu") if compiled.AVAILABLE else ("superlu",)


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
        return superlu.SuperLUAnalysis(indptr, indices, order)
    if name != "multifrontal":
        raise SpecError.unknown("engine", name, ("multifrontal", "superlu"))
    if name not in engines():
        raise MissingDependency("the compiled engine", remedy=compiled.COMPILED)
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
    if compiled.AVAILABLE:
        return multifrontal.minimum_degree(indptr, indices)
    return superlu.minimum_degree(indptr, indices)


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

    def __init__(self, fronts: multifrontal.Fronts) -> None:
        self.fronts = fronts

    @cached_property
    def products(self) -> float:
        # Products are bound by memory. Estimated, not timed, so that results can be reproduced.
        return 1.0 + self.fronts.flops / (FLOPS_PER_ENTRY * self.fronts.entries)

    def multiply(self, A: CSC, x: FloatArray) -> FloatArray:
        return self.fronts.multiply(_entries(A), x)

    @cached_property
    def lengths(self) -> FloatArray:
        return self.fronts.lengths

    @property
    def is_heavy(self) -> bool:
        return 8 * self.fronts.entries > HEAVY

    def factor(self, A: CSC, precision: Precision = "double") -> Factor | None:
        if precision == "double":
            return self.fronts.factor(_entries(A))
        mixed = precision == "mixed"
        return self.fronts.factor_kept_single(_entries(A), diagonal_of(A), mixed=mixed)

    def rounding(self, A: CSC, w: FloatArray) -> RoundingBound | None:
        terms = self.lengths + OTHERS
        both = weights_of_both(w, terms)
        found = self.fronts.row_sums(_entries(A), both)
        if found is None:
            return None
        absolute, squares = found
        return self._bound(least_of_both(absolute, terms), squares, A)

    def residual(self, A: CSC, w: FloatArray) -> RoundingBound | None:
        diagonal = diagonal_of(A)
        if not (diagonal > 0.0).all():
            return None
        found = self.fronts.residual(_entries(A), diagonal, w)
        return None if found is None else self._bound(*found, A)

    def _bound(self, sums: FloatArray, squares: FloatArray, A: CSC) -> RoundingBound | None:
        if not is_cholesky(squares, A) or not np.isfinite(sums).all():
            return None
        return RoundingBound(sums, int(self.lengths.sum()))


def _entries(A: CSC) -> FloatArray:
    return np.ascontiguousarray(A.data, dtype=np.float64)
