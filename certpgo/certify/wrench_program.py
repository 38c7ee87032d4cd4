"""The split of wrenches over given cycles that leaves each edge most of its weights: an SDP.

Per cycle of m symmetric springs Q_1 ... Q_m and skew wrench Om, with P_1 = Q_1, the fold is

    [[P_(k-1) + Q_k, Q_k - Om], [Q_k + Om, Q_k - P_k]] >= 0  (k = 2 ... m-1),   P_(m-1) + Q_m >= 0.

Clarabel solves it; what it returns proves nothing before it is rounded and checked in fractions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from certpgo.graph.cycles import Cycles
from certpgo.linalg.arrays import FloatArray, IntArray


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
    rows = _Rows(total)
    # Wrenches add up, on the edges outside a forest.
    at = np.full(m, -1)
    at[cycles.chords] = a * np.arange(len(cycles.chords))
    on = np.flatnonzero(at[cycles.edges] >= 0)
    signed = cycles.signs[on, None, None] * np.eye(a)
    rows.add(at[cycles.edges[on]], om[cycles.owners[on]], signed)
    rows.close(wrenches[cycles.chords][:, pairs[0], pairs[1]].ravel(), "zero")
    # What is left of an edge, in its own unit.
    turned = np.einsum("mba,sbc,mcd->msad", units[cycles.edges], symmetric, units[cycles.edges])
    rows.add(s * cycles.edges, q, np.swapaxes(_svec(turned, D), 1, 2))
    ones = np.broadcast_to(_svec(np.eye(D), D)[:, None], (m, s, 1))
    rows.add(s * np.arange(m), np.full(m, total - 1), ones)
    own = _svec(np.swapaxes(units, 1, 2) @ springs @ units, D)
    rows.close(own.ravel(), "positive", D)
    # Folds, and their ends.
    zero = np.zeros((s, D, D))
    by_spring = -_svec(np.block([[symmetric, symmetric], [symmetric, symmetric]]), 2 * D).T
    before = -_svec(np.block([[symmetric, zero], [zero, zero]]), 2 * D).T
    after = _svec(np.block([[zero, zero], [zero, symmetric]]), 2 * D).T
    none = np.zeros((a, D, D))
    by_wrench = _svec(np.block([[none, skews], [-skews, none]]), 2 * D).T
    start = D * (2 * D + 1) * np.arange(len(inner))
    for columns, block in (
        (q[inner], by_spring),
        (p[inner - 1], before),
        (p[inner], after),
        (om[cycles.owners[inner]], by_wrench),
    ):
        rows.add(start, columns, np.broadcast_to(block, (len(inner), *block.shape)))
    rows.close(np.zeros(D * (2 * D + 1) * len(inner)), "positive", 2 * D)
    last = cycles.starts[1:] - 1
    for columns in (q[last], p[last - 1]):
        block = np.broadcast_to(-_svec(symmetric, D).T, (len(last), s, s))
        rows.add(s * np.arange(len(last)), columns, block)
    rows.close(np.zeros(s * len(last)), "positive", D)
    x, margin, status = rows.maximised(seconds)
    found = np.tensordot(x[om[:, None] + np.arange(a)], skews, 1)
    stiff = np.tensordot(x[q[:, None] + np.arange(s)], symmetric, 1)
    return WrenchSplit(found, stiff, margin, status)


class _Rows:
    """The rows of a cone program in its standard form, cone by cone."""

    def __init__(self, width: int) -> None:
        self.width, self.height = width, 0
        self.entries: list[tuple[IntArray, IntArray, FloatArray]] = []
        self.right: list[FloatArray] = []
        self.cones: list[tuple[str, int, int]] = []

    def add(self, rows: IntArray, columns: IntArray, blocks: FloatArray) -> None:
        """Blocks (k, r, c) whose first entries are at these rows of the cone, and columns."""
        _, r, c = blocks.shape
        at = self.height + rows[:, None, None] + np.arange(r)[:, None]
        to = columns[:, None, None] + np.arange(c)
        shape = blocks.shape
        entries = (np.broadcast_to(at, shape), np.broadcast_to(to, shape), blocks)
        kept = blocks.ravel() != 0.0
        self.entries.append(tuple(part.ravel()[kept] for part in entries))

    def close(self, right: FloatArray, kind: str, side: int = 1) -> None:
        """The right-hand sides of the rows since the last ones, and in which cones they are."""
        self.right.append(right)
        self.height += len(right)
        self.cones.append((kind, len(right), side))

    def maximised(self, seconds: float) -> tuple[FloatArray, float, str]:
        """The point with the largest last variable, this variable, and how the solver ended."""
        import clarabel  # type: ignore[import-untyped]

        cones: list[Any] = []
        for kind, length, side in self.cones:
            if kind == "zero":
                cones.append(clarabel.ZeroConeT(length))
            else:
                each = side * (side + 1) // 2
                cones += [clarabel.PSDTriangleConeT(side)] * (length // each)
        row, column, value = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        A = sparse.csc_matrix((value, (row, column)), shape=(self.height, self.width))
        cost = np.zeros(self.width)
        cost[-1] = -1.0
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.time_limit = False, seconds
        P = sparse.csc_matrix((self.width, self.width))
        right = np.concatenate(self.right)
        found = clarabel.DefaultSolver(P, cost, A, right, cones, settings).solve()
        x = np.asarray(found.x)
        return x, float(x[-1]), str(found.status)


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
