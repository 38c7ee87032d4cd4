"""Effective resistances of edges: how little a certificate matrix opposes their residuals.

For the residuals X B of an edge, in the matrix X of all poses, and a certificate matrix S that is
zero on the poses of the estimate, as B is,

    S >= beta B B^T   if and only if   beta lambda_max(B^T S^+ B) <= 1.

Where the anchor's rows are cut off, the inverse serves for S^+.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import PoseGraph
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import pinned
from certpgo.objective.problem import Problem
from certpgo.objective.truncated import Truncation

#: Edges whose columns are solved for at once.
BATCH = 64


def resistances(problem: Problem, S: CSC, at: Truncation) -> FloatArray | None:
    """(k, b, b) matrices B^T S^+ B of edges: of rotations b = d; of poses, translations first.

    As computed, without bounds on rounding. None if S is not definite beyond the anchor.

    Parameters
    ----------
    S : certificate matrix of the problem at an estimate, with the pattern of all edges
    at : the edges at the relative poses of that estimate
    """
    layout = problem.pattern.layout_of(S)
    anchor = layout.first_row(problem.anchor) + np.arange(layout.sizes[problem.anchor])
    A = pinned(S, anchor)
    factor = problem.symbolic(A).factor(A)
    if factor is None:
        return None
    found = []
    for first in range(0, len(at.prices), BATCH):
        B = _columns(problem, at, slice(first, first + BATCH))
        B[anchor] = 0.0
        N, k, b = B.shape
        Y = factor.solve(np.ascontiguousarray(B.reshape(N, k * b))).reshape(N, k, b)
        found.append(np.einsum("Nka,Nkb->kab", B, Y))
    return np.concatenate(found)


def _columns(problem: Problem, at: Truncation, chosen: slice) -> FloatArray:
    """(N, k, b) the columns B of some edges."""
    i, j = at.graph.edges[chosen].T
    v, Q = at.v[chosen], at.Q[chosen]
    (k, d), e = v.shape, np.arange(len(v))
    p = int(isinstance(at.graph, PoseGraph))
    B = np.zeros((problem.n, p + d, k, p + d))
    B[j, p:, e, p:] = np.eye(d)
    B[i, p:, e, p:] = -Q
    if p:
        B[j, 0, e, 0] = 1.0
        B[i, 0, e, 0] = -1.0
        B[i, 1:, e, 0] = -v
    return problem.pattern.layout_of(problem.matrix).pack(B)


def loads_of(found: FloatArray, at: Truncation) -> FloatArray:
    """(k, 2) weights of rotations and translations times their largest resistances."""
    d = at.graph.d
    turned = np.linalg.eigvalsh(found[:, -d:, -d:])[:, -1]
    moved = found[:, 0, 0] if found.shape[1] > d else np.zeros(len(found))
    _, _, weights = at.measured
    return np.asarray(weights * np.stack([turned, moved], axis=1))
