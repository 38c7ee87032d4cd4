"""The quadratic form of the rotations alone, translations eliminated exactly.

F(R, t*(R)) = tr(R Q R^T), where Q is the Schur complement of M on the rotations, and Q = L for
rotation averaging. For poses Q is dense and never formed: its products and inverse use sparse
matrices that include the translations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certpgo.errors import NumericalError
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, pinned
from certpgo.linalg.factor import Factor
from certpgo.objective.quadratic import Quadratic

#: Shifts over the mean diagonal, tried until the factorization succeeds.
SHIFTS = (1e-11, 1e-9, 1e-7)
#: The same for M, whose rounding increases with the translations.
ELIMINATED_SHIFTS = (1e-9, 1e-7, 1e-5)


class Reduced:
    """A symmetric matrix of rotations (dn, dn), n of poses, as products and shifted solves.

    Attributes
    ----------
    shift : products and solves are those of Q + shift I
    factor : of the sparse matrix used by the solves

    Parameters
    ----------
    matrix : by default `problem.matrix`; or one of its pattern that differs only in the rotations'
        rows and columns, such as a certificate matrix
    shifts : the first that makes the matrix definite is used; by default small ones, in units of
        the mean weight of a node
    rough : whether solves in single precision will do, where it can factorize the matrix

    Raises
    ------
    NumericalError
        No shift is sufficient.
    """

    def __init__(
        self,
        problem: Quadratic,
        matrix: CSC | None = None,
        shifts: tuple[float, ...] | None = None,
        *,
        rough: bool = False,
    ) -> None:
        self._problem = problem
        self._matrix = problem.matrix if matrix is None else matrix
        self._rotations = problem.rotation_rows
        self.shape = (problem.d * len(problem.poses),) * 2
        grounded = self._matrix
        if problem.has_positions:
            grounded = pinned(grounded, np.array([0]))
        unit = 1.0
        if shifts is None:
            unit = float(problem.rotation.node_weights.mean())
            shifts = ELIMINATED_SHIFTS if problem.has_positions else SHIFTS

        def build(shift: float) -> CSC:
            return add_to_diagonal(grounded, np.where(self._rotations, shift, 0.0))

        _, self.shift, self.factor = factor_shifted(problem, build, unit, shifts, rough=rough)

    def solve(self, B: FloatArray) -> FloatArray:
        """(Q + shift I)^-1 B for B (dn, k)."""
        return np.asarray(self.factor.solve(self._padded(B))[self._rotations])

    def __matmul__(self, B: FloatArray) -> FloatArray:
        """(Q + shift I) B for B (dn, k)."""
        if not self._problem.has_positions:
            return np.asarray(self._matrix @ B + self.shift * B)
        product = self._matrix @ self._padded(B)
        translations = np.zeros_like(product)
        forces = product[~self._rotations]
        translations[~self._rotations] = -self._problem.elimination.solve(forces)
        product += self._matrix @ translations
        return np.asarray(product[self._rotations] + self.shift * B)

    def _padded(self, B: FloatArray) -> FloatArray:
        full = np.zeros((len(self._rotations), B.shape[1]))
        full[self._rotations] = B
        return full


def factor_shifted(
    problem: Quadratic,
    build: Callable[[float], CSC],
    unit: float,
    shifts: tuple[float, ...] = SHIFTS,
    *,
    rough: bool = False,
) -> tuple[CSC, float, Factor]:
    """The first definite matrix ``build(shift)``, its shift and its factor, or a NumericalError.

    Parameters
    ----------
    build : shift -> a block matrix of the problem, semidefinite up to rounding if the shift is zero
    unit : factor of the shifts
    rough : whether a factor in single precision will do
    """
    for relative in shifts:
        A = build(unit * relative)
        symbolic = problem.symbolic(A)
        factor = (symbolic.factor(A, "single") if rough else None) or symbolic.factor(A)
        if factor is not None:
            return A, unit * relative, factor
    raise NumericalError("a semidefinite matrix could not be factorized, even when shifted")
