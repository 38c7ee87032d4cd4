"""Effective resistances of edges: how little a certificate matrix opposes their residuals.

The residuals of an edge at poses X are X B, for a block column B that is zero but at two nodes. For
a certificate matrix S >= 0 that is zero on the poses of an estimate, as B is, and weights W,

    S - B W B^T >= 0   if and only if   W <= G^-1,   G = B^T S^+ B.

So W = s G^-1 can be taken off where s < 1: s is its load. What other edges have left afterwards
follows from all products B_e^T S^+ B_f by Woodbury's identity. Where the anchor's rows are cut off,
the inverse serves for S^+.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import pinned
from certpgo.linalg.factor import Factor
from certpgo.linalg.selected_inverse import blocks_of_pairs
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated import Truncation

#: Columns of edges that are packed one by one at most.
DENSE = 450
#: Edges whose loads are computed anew at once.
BEST = 16
#: Rows up to which an inverse is computed as a whole.
WHOLE = 5000
#: Load up to which edges are taken off, so that S stays definite despite rounding, and what those
#: of smallest load add up to if there are more than `DENSE` columns.
FULL, LIGHT = 0.98, 0.5


class Resistances:
    """Those of some edges at an estimate, as computed, without bounds on rounding.

    Parameters
    ----------
    problem, S : a certificate matrix at an estimate, with the pattern of all edges
    factor : of that without the anchor's rows
    at : the edges at the relative poses of that estimate
    """

    def __init__(self, problem: Quadratic, factor: Factor, at: Truncation) -> None:
        self._problem, self._factor, self._at = problem, factor, at
        self.B = _columns(problem, at)
        self.b = at.weights.shape[1]

    @staticmethod
    def of(problem: Quadratic, S: CSC, at: Truncation) -> Resistances | None:
        """Those at a certificate matrix; None if it is not definite beyond the anchor."""
        A = pinned(S, _anchor(problem))
        factor = problem.symbolic(A).factor(A)
        return None if factor is None else Resistances(problem, factor, at)

    @property
    def blocks(self) -> FloatArray:
        """(k, b, b) matrices G, of blocks of the inverse, which S couples."""
        problem, edges = self._problem, self._at.graph.edges
        layout = problem.pattern.layout_of(problem.matrix)
        Z, B = blocks_of_pairs(*self._factor.lower(), layout, edges), _ends(self._at)
        B[np.repeat(edges == problem.anchor, self.b, axis=1)] = 0.0
        return np.asarray(np.swapaxes(B, 1, 2) @ Z @ B)

    def products(self, edges: IntArray) -> FloatArray:
        """(h, b, h, b) products B_e^T S^+ B_f of h edges."""
        b, h = self.b, len(edges)
        columns = self.B[:, (b * edges[:, None] + np.arange(b)).ravel()]
        if self._inverse is not None:
            solved = (columns.T @ self._inverse).T
        else:
            solved = self._factor.solve(np.ascontiguousarray(columns.toarray()))
        return np.asarray(columns.T @ solved).reshape(h, b, h, b)

    @cached_property
    def _inverse(self) -> FloatArray | None:
        """(N, N) S^+, where that has fewer columns than all edges together."""
        rows, columns = self.B.shape
        return self._factor.solve(np.eye(rows)) if rows < columns and rows <= WHOLE else None


def packed(
    found: Resistances, at: Truncation, *, isotropic: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Weights W (k, b, b) that may all be taken off together, and loads (k,), as far as computed.

    The edges of smallest load come first; where that is too large, W is zero.

    Parameters
    ----------
    isotropic : whether W are diag(beta_t, beta_R, ...)
    """
    reaching = Truncation.splitting if isotropic else Truncation.reaching
    W, loads = reaching(at, found.blocks)
    order = np.argsort(loads, kind="stable")
    light = 0
    if len(loads) * found.b > DENSE:
        light = int(np.searchsorted(np.cumsum(loads[order]), LIGHT))
    used = float(loads[order[:light]].sum())
    dense = order[light : light + DENSE // found.b]
    W[order[light:]] = 0.0
    # With a load taken off, S is no less than the rest of itself.
    G = found.products(dense) / (1.0 - used)
    left = loads[
        dense
    ]  # of what is not taken; they only grow, and are brought up to date as needed
    while len(left) and left.min() < FULL:
        first = np.argsort(left)[: min(BEST, int(np.isfinite(left).sum()))]
        own = G[first, :, first]
        rest, left[first] = reaching(at.subset(dense[first]), own)
        k = int(np.argmin(left[first]))
        e = first[k]
        if left[e] > left.min() or not left[e] < FULL:
            continue
        W[dense[e]], loads[dense[e]], left[e] = rest[k], left[e], math.inf
        # S - B W B^T, by Woodbury's identity.
        taken = rest[k] @ G[e].reshape(found.b, -1)
        pull = np.linalg.solve(np.eye(found.b) - rest[k] @ own[k], taken)
        G = G + np.tensordot(G[:, :, e], pull.reshape(found.b, *G.shape[2:]), 1)
    loads[dense] = np.where(np.isfinite(left), left, loads[dense])
    return W, loads


def together(found: Resistances, W: FloatArray, part: IntArray, room: FloatArray) -> list[IntArray]:
    """Groups of some measurements whose weights may be taken off together, as far as is foreseen.

    S - sum B W B^T >= 0 if the blocks of W^1/2 B^T S^+ B W^1/2 have row sums of at most one. Those
    of each measurement's ``room`` (k,) are beyond its own load.
    """
    k = len(part)
    values, U = np.linalg.eigh(W[part])
    half = U * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    G = found.products(part)
    G = np.einsum("eax,eafc,fcy->exfy", half, G, half, optimize=True)
    shared = np.sqrt((G**2).sum(axis=(1, 3)))
    np.fill_diagonal(shared, 0.0)
    groups: list[list[int]] = []
    sums: list[FloatArray] = []  # over the members of each group
    for e in range(k):
        for group, total in zip(groups, sums, strict=True):
            if total[e] <= room[e] and (total[group] + shared[group, e] <= room[group]).all():
                break
        else:
            group, total = [], np.zeros(k)
            groups.append(group)
            sums.append(total)
        group.append(e)
        total += shared[e]
    return [part[group] for group in groups]


def _anchor(problem: Quadratic) -> IntArray:
    layout = problem.pattern.layout_of(problem.matrix)
    return layout.rows_of(problem.anchor)


def _ends(at: Truncation) -> FloatArray:
    """(k, 2b, b) the rows of both nodes in the block columns B, which are zero elsewhere."""
    (k, d), p = at.v.shape, at.moved
    b = p + d
    B = np.zeros((k, 2 * b, b))
    B[:, b:] = np.eye(b)
    B[:, p:b, p:] = -at.Q
    if p:
        B[:, 0, 0] = -1.0
        B[:, 1:b, 0], B[:, b + 1 :, 0] = -at.v, at.graph.own_arms
    return B


def _columns(problem: Quadratic, at: Truncation) -> CSC:
    """(N, k b) the block columns B, without the anchor's rows."""
    (i, j), ends, n = at.graph.edges.T, _ends(at), problem.n
    k, _, b = ends.shape
    layout = problem.pattern.layout_of(problem.matrix)
    place = np.full(n * b, -1)
    place[layout.pack(np.arange(n * b).reshape(n, b))] = np.arange(layout.size)
    place = place.reshape(n, b)
    place[problem.anchor] = -1
    rows = np.concatenate([place[i], place[j]])[:, :, None] + np.zeros(b, dtype=int)
    columns = np.tile(b * np.arange(k)[:, None] + np.arange(b), (2, 1))[:, None, :]
    columns = columns + np.zeros((b, 1), dtype=int)
    values, known = np.concatenate([ends[:, :b], ends[:, b:]]), rows >= 0
    shape = (layout.size, k * b)
    return csc_array((values[known], (rows[known], columns[known])), shape=shape)
