"""The residual of a computed Cholesky factor, measured instead of bounded a priori.

A = L L^T + E holds exactly for some E. Its large part is computed without rounding: with L split
into L1 + L2, L1 in integer multiples of 2^-s, every partial sum of A_hi - L1 L1^T is an integer
multiple of 2^-2s below 2^53 of them, hence a double in any order of summation. The contribution of
L2 is 2^-s smaller, and so is its rounding.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U

#: Bits after the point of L1, for rows of norm about one; a sum of squares has twice as many.
BITS = 24


def measured_residual(A: CSC, L: CSC, order: IntArray, w: FloatArray) -> FloatArray | None:
    """(N,) upper bounds on the row sums of |E| w, in the order of A; None if there are none.

    Parameters
    ----------
    A : (N, N) the factorized matrix, both triangles stored
    L, order : its factor, A[order][:, order] = L L^T + E
    w : (N,) positive weights
    """
    # Scaled by powers of two, which is exact, so that rows of L have norms of about one.
    diagonal = A.diagonal()[order]
    if not np.all(diagonal > 0.0):
        return None
    scale = np.ldexp(1.0, -np.round(0.5 * np.log2(diagonal)).astype(int))
    rows = sparse.diags_array(scale)
    Lower = sparse.csr_array(rows @ L)
    permuted = sparse.csr_array(rows @ A[order][:, order] @ rows)
    unit = 2.0**BITS
    high, low = _split(permuted, unit**2)
    L1, L2 = _split(Lower, unit)
    squares = L1.multiply(L1).sum(axis=1)
    if not abs(high).max() + squares.max() * (1.0 + 1e-9) < 2.0**52 / unit**2:
        return None
    exact = high - L1 @ L1.T
    cross = L1 @ L2.T
    rest = low - (cross + cross.T + L2 @ L2.T)
    v = w[order] / scale
    counts = np.diff(Lower.indptr) + 8.0
    small = abs(L1) @ (abs(L2).T @ v) + abs(L2) @ (abs(L1).T @ v) + abs(L2) @ (abs(L2).T @ v)
    sizes = abs(exact + rest)  # they nearly cancel
    # Rounding of the products with L2 and of their sums, then of the row sums.
    bound = np.asarray(sizes @ v) * (1.0 + (np.diff(sizes.indptr) + 16.0) * U)
    bound += 2.0 * counts * U * small + 4.0 * U * (abs(low) @ v)
    result = np.empty_like(v)
    result[order] = 1.001 * bound / scale
    return np.asarray(result)


def _split(B: sparse.csr_array, unit: float) -> tuple[sparse.csr_array, sparse.csr_array]:
    """B = high + low exactly, high in multiples of 1 / unit."""
    high, low = B.copy(), B.copy()
    high.data = np.round(B.data * unit) / unit
    low.data = B.data - high.data
    return high, low
