"""The split of wrenches over given cycles that leaves each edge most of its weights: an SDP.

Per cycle of m symmetric springs Q_1 ... Q_m and skew wrench Om, with P_1 = Q_1, the fold is

    [[P_(k-1) + Q_k, Q_k - Om], [Q_k + Om, Q_k - P_k]] >= 0  (k = 2 ... m-1),   P_(m-1) + Q_m >= 0.

Clarabel solves it; what it returns proves nothing before it is rounded and checked in fractions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from certpgo.certify.cone_program import Cones, solved
from certpgo.graph.cycles import Cycles
from certpgo.linalg.arrays import CSC, FloatArray, IntArray

#: Rows and columns where blocks begin, and these.
Blocks = tuple[IntArray, IntArray, FloatArray]


@dataclass(frozen=True, eq=False)
class WrenchSplit:
    """Wrenches and springs of cycles, as a solver found them.

    Attributes
    ----------
    wrenches : (c, D, D) skew, D = d + 1
    springs : (p, D, D) symmetric, of each edge of each cycle, in the order of the cycles
    margin : the largest t with Q_e - sum_C Q_eC >= t times the weights of the edge
    status : what the solver says of its solution
    """

    wrenches: FloatArray
    springs: FloatArray
    margin: float
    status: str


def split_wrenches(
    cycles: Cycles,
    springs: FloatArray,
    wrenches: FloatArray,
    units: FloatArray,
    seconds: float = math.inf,
) -> WrenchSplit:
    """Split the wrenches of edges such that most of their springs is left.

    Parameters
    ----------
    springs, wrenches : (m, D, D) symmetric Q_e and skew Om_e
    units : (m, D, D) with U^T W U = I for the weights W of each edge
    seconds : after which the solver gives up
    """
    m, D = springs.shape[:2]
    pairs, upper = np.triu_indices(D, 1), _upper(D)
    skews, symmetric = _basis(pairs, D, -1.0), _basis(upper, D, 1.0)
    a, s, place = len(skews), len(symmetric), np.arange(len(cycles.edges))
    within = place - cycles.starts[cycles.owners]
    inner = np.flatnonzero((within > 0) & (within < cycles.lengths[cycles.owners] - 1))
    om = a * np.arange(len(cycles))
    q = a * len(cycles) + s * place
    p = q.copy()  # after the first spring, that spring
    p[inner] = a * len(cycles) + s * (len(place) + np.arange(len(inner)))
    total = a * len(cycles) + s * (len(place) + len(inner)) + 1
    # Wrenches add up, on the edges outside a forest.
    at = np.full(m, -1)
    at[cycles.chords] = a * np.arange(len(cycles.chords))
    on = np.flatnonzero(at[cycles.edges] >= 0)
    signed = cycles.signs[on, None, None] * np.eye(a)
    right = wrenches[cycles.chords][:, pairs[0], pairs[1]].ravel()
    wrench = _matrix([(at[cycles.edges[on]], om[cycles.owners[on]], signed)], len(right), total)
    # What is left of an edge, in its own unit.
    turned = np.einsum("mba,sbc,mcd->msad", units[cycles.edges], symmetric, units[cycles.edges])
    ones = np.broadcast_to(_svec(np.eye(D), D)[:, None], (m, s, 1))
    taken = [
        (s * cycles.edges, q, np.swapaxes(_svec(turned, D), 1, 2)),
        (s * np.arange(m), np.full(m, total - 1), ones),
    ]
    own = _svec(np.swapaxes(units, 1, 2) @ springs @ units, D)
    # Folds, and their ends.
    zero = np.zeros((s, D, D))
    by_spring = -_svec(np.block([[symmetric, symmetric], [symmetric, symmetric]]), 2 * D).T
    before = -_svec(np.block([[symmetric, zero], [zero, zero]]), 2 * D).T
    after = _svec(np.block([[zero, zero], [zero, symmetric]]), 2 * D).T
    none = np.zeros((a, D, D))
    by_wrench = _svec(np.block([[none, skews], [-skews, none]]), 2 * D).T
    start = D * (2 * D + 1) * np.arange(len(inner))
    folds = [
        (start, columns, np.broadcast_to(block, (len(inner), *block.shape)))
        for columns, block in (
            (q[inner], by_spring),
            (p[inner - 1], before),
            (p[inner], after),
            (om[cycles.owners[inner]], by_wrench),
        )
    ]
    last = cycles.starts[1:] - 1
    block = np.broadcast_to(-_svec(symmetric, D).T, (len(last), s, s))
    ends = [(s * np.arange(len(last)), columns, block) for columns in (q[last], p[last - 1])]

    def semidefinite(blocks: Iterable[Blocks], right: FloatArray, side: int) -> Cones:
        return Cones("semidefinite", _matrix(blocks, len(right), total), right, side)

    cost = np.zeros(total)
    cost[-1] = -1.0
    parts = [
        Cones("zero", wrench, right),
        semidefinite(taken, own.ravel(), D),
        semidefinite(folds, np.zeros(D * (2 * D + 1) * len(inner)), 2 * D),
        semidefinite(ends, np.zeros(s * len(last)), D),
    ]
    x, _, status = solved(cost, parts, seconds)
    found = np.tensordot(x[om[:, None] + np.arange(a)], skews, 1)
    stiff = np.tensordot(x[q[:, None] + np.arange(s)], symmetric, 1)
    return WrenchSplit(found, stiff, float(x[-1]), status)


def _matrix(parts: Iterable[Blocks], height: int, width: int) -> CSC:
    """Sums of blocks (k, r, c) whose first entries are at these rows and columns (k,)."""
    entries = []
    for rows, columns, blocks in parts:
        _, r, c = shape = blocks.shape
        at = np.broadcast_to(rows[:, None, None] + np.arange(r)[:, None], shape)
        to = np.broadcast_to(columns[:, None, None] + np.arange(c), shape)
        kept = blocks != 0.0
        entries.append((at[kept], to[kept], blocks[kept]))
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sparse.csc_array((value, (row, column)), shape=(height, width))


def _upper(n: int) -> tuple[IntArray, IntArray]:
    """The upper triangle by columns, as Clarabel stores it."""
    columns, rows = np.tril_indices(n)
    return rows, columns


def _basis(pairs: tuple[IntArray, IntArray], n: int, sign: float) -> FloatArray:
    """Matrices with ones at these entries, and a sign at the mirrored ones."""
    r, c = pairs
    found = np.zeros((len(r), n, n))
    k = np.arange(len(r))
    found[k, c, r] = sign
    found[k, r, c] = 1.0
    return found


def _svec(A: FloatArray, n: int) -> FloatArray:
    """Upper triangles (..., n (n + 1) / 2), off-diagonal entries times the root of 2."""
    r, c = _upper(n)
    return np.asarray(A[..., r, c] * np.where(r == c, 1.0, math.sqrt(2.0)))
