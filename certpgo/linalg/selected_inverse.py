"""Entries of an inverse on the pattern of a Cholesky factor, without the rest of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from certpgo.errors import NumericalError
from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import Layout, with_entries
from certpgo.linalg.threads import PARALLEL, one_thread

ILL_CONDITIONED = "a factor is too ill-conditioned for bounds on its inverse"


def diagonal_blocks(L: CSC, rows: IntArray, layout: Layout, *, above: bool = False) -> FloatArray:
    """(n, b, b) the nodes' diagonal blocks of A^-1; zero for rows that points do not have.

    Parameters
    ----------
    L, rows : the factor and its permutation p, with A[p][:, p] = L L^T
    layout : of A, which stores the nodes' whole blocks
    above : whether each is to be an upper bound on the block, despite rounding: the difference is
        positive semidefinite

    Raises
    ------
    NumericalError
        L is too ill-conditioned for an upper bound.
    """
    at = _places(rows, layout)
    if not above:
        return _blocks(L, at)
    # Rows of L of length about one: rounding is bounded by norms.
    lengths = np.sqrt(np.bincount(L.indices, L.data**2, minlength=layout.size))
    unit = np.exp2(-np.round(np.log2(lengths)))
    scale = unit[at]
    blocks = _blocks(with_entries(L, L.data * unit[L.indices]), at, above=True)
    return np.asarray(blocks * scale[:, :, None] * scale[:, None, :])


def blocks_of_pairs(L: CSC, rows: IntArray, layout: Layout, pairs: IntArray) -> FloatArray:
    """(m, 2b, 2b) blocks of A^-1 of two nodes each; zero for rows that points do not have.

    Parameters
    ----------
    L, rows, layout : as in `diagonal_blocks`
    pairs : (m, 2) nodes, which A couples
    """
    at = _places(rows, layout)[pairs]
    return _blocks(L, at.reshape(len(pairs), 2 * at.shape[-1]))


def _places(rows: IntArray, layout: Layout) -> IntArray:
    """(n, b) the rows of L of each node, -1 for those that points do not have."""
    place = np.empty(layout.size)
    place[rows] = np.arange(1.0, layout.size + 1.0)
    return layout.unpack(place).astype(np.intp) - 1


def _blocks(L: CSC, at: IntArray, *, above: bool = False) -> FloatArray:
    """(k, q, q) blocks of (L L^T)^-1 for rows (k, q) of L, each in one front; zero for rows -1."""
    firsts = np.where(at >= 0, at, L.shape[0]).min(axis=1, initial=L.shape[0])
    order = np.argsort(firsts, kind="stable")
    blocks = np.empty((*at.shape, at.shape[1]))
    if compiled.AVAILABLE:
        parts = L.indptr, L.indices, at, order
        indptr, indices, of, by = (np.ascontiguousarray(part, dtype=np.int64) for part in parts)
        is_large = float((np.diff(indptr) ** 2.0).sum()) >= PARALLEL
        with one_thread.unless(is_large):
            done = compiled.kernel.inverse_blocks(indptr, indices, L.data, of, by, above, blocks)
        if done:
            return blocks
        if done is False:
            raise NumericalError(ILL_CONDITIONED)
    firsts = firsts[order]
    for front, k, Z in fronts_of_inverse(L, above=above):
        own = order[slice(*np.searchsorted(firsts, [front[0], front[0] + k]))]
        known = at[own] >= 0
        rows = np.where(known, at[own], front[0])
        within = np.minimum(np.searchsorted(front, rows), len(front) - 1)
        if (front[within] != rows).any():
            raise NumericalError("a factor without the whole blocks of nodes")
        both = known[:, :, None] & known[:, None, :]
        one, other = within[:, :, None], within[:, None, :]
        blocks[own] = np.where(both, Z[np.maximum(one, other), np.minimum(one, other)], 0.0)
    return blocks


def fronts_of_inverse(L: CSC, *, above: bool = False) -> Iterator[tuple[IntArray, int, FloatArray]]:
    """Runs of k columns with one pattern, from the last to the first, with the inverse's block.

    Takahashi's recursion from the last column to the first (Takahashi, Fagan, Chen 1973), in dense
    blocks: with pivots p and rows r below them, Z_rp = -Z_rr L_rp L_pp^-1, where Z_rr is known.

    The block is J Z_rr J^T + (L_pp L_pp^T)^-1 with J = [-L_pp^-T L_rp^T; I]. So an upper bound on
    Z_rr, of which the difference is >= 0, gives one on the block, to which the rounding of this
    step is added: it does not grow, as differences are carried on by J alone.
    """
    from scipy.linalg.lapack import dtrtri

    starts, rows, above_of = _supernodes(L)
    waiting = np.bincount(above_of[above_of >= 0], minlength=len(above_of))  # children that need Z
    known: dict[int, FloatArray] = {}
    for s in range(len(rows) - 1, -1, -1):
        front, k = _front(starts, rows, s), int(starts[s + 1] - starts[s])
        Z = np.empty((len(front),) * 2)
        if (parent := int(above_of[s])) >= 0:
            place = np.searchsorted(_front(starts, rows, parent), rows[s])
            Z[k:, k:] = known[parent][place[:, None], place]
            waiting[parent] -= 1
            if not waiting[parent]:
                del known[parent]
        P = _panel(L, front, k)
        inverse = np.asarray(dtrtri(P[:k], lower=1)[0])
        carried = P[k:] @ inverse
        Z[k:, :k] = -Z[k:, k:] @ carried
        Z[:k, k:] = Z[k:, :k].T
        Z[:k, :k] = inverse.T @ inverse - carried.T @ Z[k:, :k]
        if above:
            _round_up(Z, P, inverse, carried)
        if waiting[s]:
            known[s] = Z
        yield front, k, Z


def _round_up(Z: FloatArray, P: FloatArray, inverse: FloatArray, carried: FloatArray) -> None:
    """Add the rounding of a step to the diagonal of its block, in place.

    Norms are Frobenius'; a product of matrices with inner dimension q is off by at most (q + 2) U
    times the product of their norms.
    """
    m, k = P.shape
    x, q, c, w = map(_norm, (inverse, P[k:], carried, Z[k:, k:]))
    unit = (m + 8.0) * U
    # L_pp^-1 = (I - E)^-1 X for the computed X, E = I - X L_pp.
    e = _norm(np.eye(k) - inverse @ P[:k]) + unit * (x * _norm(P[:k]) + 1.0)
    if not e < 0.5:
        raise NumericalError(ILL_CONDITIONED)
    off = 2.0 * e * x
    off_carried = q * off + unit * q * x
    missed = off * (2.0 * x + off) + off_carried * w * (1.0 + 2.0 * c + off_carried)
    Z[:k, :k] = 0.5 * (Z[:k, :k] + Z[:k, :k].T)
    Z[np.diag_indices(m)] += 1.01 * (missed + 4.0 * unit * (x * x + w * (1.0 + c) ** 2))


def _norm(A: FloatArray) -> float:
    return math.sqrt(np.vdot(A, A))


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
