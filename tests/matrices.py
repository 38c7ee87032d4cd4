"""Definite matrices, and what is left of them after a factorization."""

from fractions import Fraction

import numpy as np
from strategies import random_edges, rng_of

from certpgo.linalg.blocks import BlockPattern


def uneven_matrix(seed, n, b, decades):
    """A definite block matrix whose rows and columns are scaled by up to that many decades."""
    rng = rng_of(seed)
    P = BlockPattern(n, random_edges(rng, n, 2 * n))
    m = len(P.edges)
    scale = 10.0 ** rng.uniform(-decades, decades, (n, b))
    i, j = P.edges.T
    upper = rng.standard_normal((m, b, b)) * scale[i][:, :, None] * scale[j][:, None, :]
    sizes = np.zeros((n, b))
    for e, (k, other) in enumerate(P.edges):
        sizes[k] += (abs(upper[e]) / scale[other]).sum(axis=1) * scale[k]
        sizes[other] += (abs(upper[e]) / scale[k][:, None]).sum(axis=0) * scale[other]
    diagonal = (1.01 * sizes + 1e-3 * scale**2)[:, :, None] * np.eye(b)
    return P, P.assemble(diagonal, upper)


def exact_residual(A, L, order, w):
    """Row sums of |A - L L^T| w in rational arithmetic, in the order of A."""
    n = len(order)
    rows = [[Fraction(x) for x in row] for row in L.toarray()]
    dense = A.toarray()[np.ix_(order, order)]
    sums = np.empty(n)
    for a in range(n):
        total = Fraction(0)
        for c in range(n):
            product = sum(x * y for x, y in zip(rows[a][: c + 1], rows[c][: c + 1], strict=True))
            total += abs(Fraction(dense[a, c]) - product) * Fraction(w[order[c]])
        sums[order[a]] = float(total)
    return sums
