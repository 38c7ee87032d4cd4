"""A priori bounds on the rounding of a sparse Cholesky factorization.

|A - L L^T| <= (k + 8) u |L| |L|^T entry by entry, k the nonzeros of a row of L (Rump and Jeannerod
2014, in any order of summation). docs/multifrontal.md has the argument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import diagonal_of

#: Relative agreement of a Cholesky factor's squared row norms with the diagonal.
AGREEMENT = 1e-6
#: Diagonal entries below which underflow could exceed the rounding that is bounded.
SMALLEST = 1e-250
#: Operations on an entry of L besides its products: divisions, roots, their rounding.
OTHERS = 8.0


@dataclass(frozen=True, eq=False)
class RoundingBound:
    """How far a Cholesky factorization is from exact, at most.

    Attributes
    ----------
    sums : (N,) upper bounds on the row sums of |A - L L^T| with the weights of the columns
    nonzeros : of L
    """

    sums: FloatArray
    nonzeros: int


def weights_of_both(w: FloatArray, terms: FloatArray) -> FloatArray:
    """(N, 2) weights of the two bounds that `_least` compares."""
    return np.stack([w, np.sqrt(terms) * w], axis=1)


def least_of_both(absolute: FloatArray, terms: FloatArray) -> FloatArray:
    """(N,) bounds on the rounding, from |L| |L|^T times the weights of `weights_of_both`.

    An entry (i, j) of L L^T sums at most min(k_i, k_j) products, with k the row lengths of L: at
    most k_i, and at most the geometric mean.
    """
    by_row, by_mean = absolute.T
    return np.asarray(U * np.minimum(terms * by_row, np.sqrt(terms) * by_mean))


def rounding_of_factor(L: CSC, rows: IntArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What a factor is off by, as `RoundingBound.sums`, and L's squared row norms, in A's order.

    Parameters
    ----------
    L, rows : the factor and its permutation p, with A[p][:, p] = L L^T
    w : (N,) weights of the columns
    """
    terms, squares = np.empty(len(w)), np.empty(len(w))
    terms[rows] = np.bincount(L.indices, minlength=len(w)) + OTHERS
    squares[rows] = np.bincount(L.indices, L.data**2, minlength=len(w))
    size, both = abs(L), weights_of_both(w, terms)
    absolute = np.empty_like(both)
    absolute[rows] = size @ (size.T @ both[rows])
    return least_of_both(absolute, terms), squares


def is_cholesky(squares: FloatArray, A: CSC) -> bool:
    """Whether the squared row norms of L match A's diagonal, as for Cholesky factors only.

    And whether no product of entries underflows by more than the rounding that is bounded.
    """
    diagonal = diagonal_of(A)
    near = np.abs(squares - diagonal) <= AGREEMENT * diagonal
    return bool(np.all(near & (diagonal >= SMALLEST) & (diagonal < np.inf)))
