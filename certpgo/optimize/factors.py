"""Newton steps by factorizations: new ones, in single precision where it suffices, and old ones."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial

from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.cg import End, Truncated, conjugate_gradients
from certpgo.linalg.factor import Factor, Symbolic
from certpgo.linalg.multifrontal import Precision
from certpgo.objective.quadratic import Quadratic


class Factors:
    """The last factor of a descent, how well it still works, and what was done.

    Parameters
    ----------
    max_products : products of conjugate gradients at most before a new factor
    single_from : products that must cost less than a factor for single precision to be tried

    Attributes
    ----------
    last : the factor, if it is still of use
    most : products that cost less than a new factor
    counts : of factorizations and products
    """

    def __init__(self, problem: Quadratic, max_products: int, single_from: int) -> None:
        self._problem, self._max_products, self._single_from = problem, max_products, single_from
        self.last: Factor | None = None
        self.most = 0
        self.counts: Counter[str] = Counter()
        self._single = True  # whether factors are tried in single precision
        self._pace = math.inf  # -log(residual) per product with the last factor

    def drop(self) -> None:
        """Forget the last factor, which frees its memory."""
        self.last, self._pace = None, math.inf

    def serve(self, tol: float) -> bool:
        """Whether conjugate gradients with the last factor should take less than a new one."""
        return self.last is not None and -math.log(tol) / self._pace <= self.most

    def new(
        self, H: CSC, g: FloatArray, damped: FloatArray, tol: float
    ) -> tuple[FloatArray, float] | None:
        """The step (N,) of a new factor and its predicted decrease; None if H is not definite.

        A factor in single precision takes half the time, and a few products make up for its
        rounding, unless H is too ill-conditioned for it. Then double precision follows, where
        memory allows it.
        """
        A = add_to_diagonal(H, damped) if damped.any() else H
        symbolic = self._problem.symbolic(A)
        self.most = max(1, int(min(self._max_products, symbolic.products)))
        last: Precision = "mixed" if symbolic.is_heavy else "double"
        tried = self._single and self.most >= self._single_from
        for precision in ("single", last) if tried else (last,):
            factor = symbolic.factor(A, precision)
            self.counts["factorizations"] += 1
            if factor is None:
                continue
            if precision == "double":
                self.last, self._single, step = factor, False, -factor.solve(g)
                return step, float(step @ (damped * step - g))
            # A factor in double precision takes as long as two in single precision.
            most = max(self.most, min(2 * self.most + 1, self._max_products))
            solved = self._iterated(symbolic, A, g, factor, tol, most, trust=tol**2)
            enough = (End.CONVERGED, End.LIMIT) if precision == "mixed" else (End.CONVERGED,)
            predicted = float(solved.x @ (damped * solved.x + solved.residual - g))
            if solved.end in enough and predicted > 0.0:
                self.last, self._single = factor, precision == "single"
                return solved.x, predicted
            del factor
        return None

    def old(self, H: CSC, g: FloatArray, tol: float) -> Truncated:
        """Conjugate gradients for H x = -g with the last factor."""
        if self.last is None:
            raise ValueError("there is no factor")
        return self._iterated(self._problem.symbolic(H), H, g, self.last, tol, self.most)

    def _iterated(
        self,
        symbolic: Symbolic,
        A: CSC,
        g: FloatArray,
        factor: Factor,
        tol: float,
        most: int,
        trust: float = 0.0,
    ) -> Truncated:
        multiply = partial(symbolic.multiply, A)
        solved = conjugate_gradients(
            multiply, -g, factor.solve, tol=tol, max_iterations=most, trust=trust
        )
        self.counts["products"] += solved.products
        if solved.end is End.CONVERGED:
            self._pace = -math.log(tol) / solved.products
        return solved
