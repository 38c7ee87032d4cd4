"""Entries of an inverse on the pattern of a Cholesky factor, without the rest of it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from certpgo.linalg.arrays import CSC, FloatArray, IntArray


def selected_inverse(L: CSC) -> CSC:
    """The lower triangle of (L L^T)^-1 on the pattern of L, closed under fill.

    Takahashi's recursion from the last column to the first (Takahashi, Fagan, Chen 1973), in dense
    blocks of columns with one pattern: with pivots p and rows r below them,
    Z_rp = -Z_rr L_rp L_pp^-1, where Z_rr is known.

    Parameters
    ----------
    L : (N, N) lower triangular with positive diagonal, sorted indices

    Returns
    -------
    (N, N) CSC, lower triangular
    """
    starts, rows, above = _supernodes(L)
    waiting = np.bincount(above[above >= 0], minlength=len(above))  # children that need Z
    known: dict[int, FloatArray] = {}
    columns: list[tuple[FloatArray, IntArray]] = []
    for s in range(len(rows) - 1, -1, -1):
        front, k = _front(starts, rows, s), int(starts[s + 1] - starts[s])
        Z = np.empty((len(front),) * 2)
        if (parent := int(above[s])) >= 0:
            place = np.searchsorted(_front(starts, rows, parent), rows[s])
            Z[k:, k:] = known[parent][place[:, None], place]
            waiting[parent] -= 1
            if not waiting[parent]:
                del known[parent]
        P = _panel(L, front, k)
        inverse = solve_triangular(P[:k], np.eye(k), lower=True)
        carried = P[k:] @ inverse
        Z[k:, :k] = -Z[k:, k:] @ carried
        Z[:k, k:] = Z[k:, :k].T
        Z[:k, :k] = inverse.T @ inverse - carried.T @ Z[k:, :k]
        if waiting[s]:
            known[s] = Z
        columns += [(Z[c:, c], front[c:]) for c in range(k - 1, -1, -1)]
    columns.reverse()
    indptr = np.cumsum([0, *(len(values) for values, _ in columns)])
    values, indices = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    return CSC((values, indices, indptr), shape=L.shape)


def _supernodes(L: CSC) -> tuple[IntArray, list[IntArray], IntArray]:
    """Runs of columns with one pattern.

    Returns
    -------
    where they start, (k + 1,); the rows below each; and the run that contains the first of these,
    (k,), or -1
    """
    lengths, N = np.diff(L.indptr), L.shape[0]
    following = np.full(N, -1)
    longer = lengths > 1
    following[longer] = L.indices[L.indptr[:-1][longer] + 1]
    joined = (following[:-1] == np.arange(1, N)) & (lengths[:-1] == lengths[1:] + 1)
    # The rows below the diagonal are those of the next column.
    column = np.repeat(np.arange(N), lengths)
    below = np.flatnonzero((L.indices > column) & np.r_[joined, False][column])
    other = L.indices[below] != L.indices[below + lengths[column[below]] - 1]
    joined[column[below[other]]] = False
    starts = np.r_[np.flatnonzero(np.r_[True, ~joined]), N]
    rows = [L.indices[L.indptr[end - 1] + 1 : L.indptr[end]] for end in starts[1:]]
    above = np.full(len(rows), -1)
    for s, below in enumerate(rows):
        if len(below):
            parent = above[s] = np.searchsorted(starts, below[0], "right") - 1
            # Entries that cancelled exactly may be missing.
            rows[parent] = np.union1d(rows[parent], below[below >= starts[parent + 1]])
    return starts, rows, above


def _front(starts: IntArray, rows: list[IntArray], s: int) -> IntArray:
    return np.concatenate([np.arange(starts[s], starts[s + 1]), rows[s]])


def _panel(L: CSC, front: IntArray, k: int) -> FloatArray:
    """The first k columns of a front, dense."""
    P = np.zeros((len(front), k))
    first, last = L.indptr[front[0]], L.indptr[front[0] + k]
    column = np.repeat(np.arange(k), np.diff(L.indptr[front[0] : front[0] + k + 1]))
    P[np.searchsorted(front, L.indices[first:last]), column] = L.data[first:last]
    return P
