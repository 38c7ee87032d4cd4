"""Factors in single precision, whose rounding conjugate gradients make up for."""

from __future__ import annotations

from functools import partial

import numpy as np

from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.cg import End, conjugate_gradients
from certpgo.linalg.factor import LinearSolver, Symbolic

#: Relative accuracy of solutions in the norm of the matrix.
ACCURACY = 1e-3
#: Products that must cost less than a factor for single precision to be tried.
SINGLE_FROM = 2


class SingleFirst:
    """Factors of the matrices of a descent, in double precision from when single did not do."""

    def __init__(self) -> None:
        self._single = True

    def factor(self, symbolic: Symbolic, A: CSC) -> LinearSolver | None:
        """A factor for solutions accurate to `ACCURACY`; None if A is not positive definite.

        Solutions are NaN where it shows only then, or where a factor serves no more.
        """
        if self._single and symbolic.products >= SINGLE_FROM:
            rough = symbolic.factor(A, "single")
            if rough is not None:
                return _Refined(self, symbolic, A, rough)
        return symbolic.factor(A)

    def give_up(self) -> None:
        """Take double precision from now on."""
        self._single = False


class _Refined:
    """A factor in single precision; if that does not suffice at first, one in double takes over."""

    def __init__(self, first: SingleFirst, symbolic: Symbolic, A: CSC, rough: LinearSolver) -> None:
        self._first, self._symbolic, self._A = first, symbolic, A
        self._factor: LinearSolver | None = rough
        self._is_rough, self._has_served = True, False

    def solve(self, B: FloatArray) -> FloatArray:
        """A^-1 B for B (N,); NaN if the factor does not serve."""
        if self._is_rough and self._factor is not None:
            found = conjugate_gradients(
                partial(self._symbolic.multiply, self._A),
                B,
                self._factor.solve,
                tol=ACCURACY,
                max_iterations=int(self._symbolic.products),
                trust=ACCURACY**2,
            )
            if found.end is End.CONVERGED:
                self._has_served = True
                return found.x
            self._first.give_up()
            # A later matrix deserves the time of another factor more than this one.
            self._factor = None if self._has_served else self._symbolic.factor(self._A)
            self._is_rough = False
        return np.full_like(B, np.nan) if self._factor is None else self._factor.solve(B)
