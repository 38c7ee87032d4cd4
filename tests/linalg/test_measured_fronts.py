"""The residual that is measured front by front, against exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import random_edges, rng_of, seeds

from certpgo.linalg import compiled
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal
from certpgo.linalg.factor import analyze
from certpgo.linalg.residual import measured_residual

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")


def matrix(seed, n, b, decades):
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


def symbolic(P, b):
    return analyze(P.indptr, P.indices, engine="multifrontal").blocks(np.full(P.num_nodes, b))


def exact_rows(A, L, order, w):
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


@settings(max_examples=25)
@given(seeds, st.sampled_from([(6, 3), (10, 1), (4, 4)]), st.sampled_from([0.0, 2.0]))
def test_it_bounds_the_exact_residual_and_not_by_much(seed, shape, decades):
    (n, b), rng = shape, rng_of(seed)
    P, A = matrix(seed, n, b, decades)
    w = 10.0 ** rng.uniform(-2.0, 2.0, n * b)
    analysis = symbolic(P, b)
    # The same arithmetic in the same order gives the same factor.
    L, order = analysis.factor(A).lower()
    exact = exact_rows(A, L, order, w)
    measured, bounded = analysis.residual(A, w), analysis.rounding(A, w)
    assert np.all(exact <= measured.sums)
    assert np.all(exact <= bounded.sums)
    assert measured.sums.sum() <= 10.0 * exact.sum() + 1e-3 * bounded.sums.sum()


@pytest.mark.parametrize("wide", [False, True])
def test_it_is_much_sharper_than_the_bound(wide, monkeypatch):
    rng = rng_of(3)
    n, b = (60, 6) if wide else (400, 3)
    P = BlockPattern(n, random_edges(rng, n, 12 * n if wide else n))
    m = len(P.edges)
    A = P.assemble(np.zeros((n, b, b)), rng.standard_normal((m, b, b)))
    A = add_to_diagonal(A, 1.01 * abs(A).sum(axis=1))
    w = np.ones(n * b)
    analysis = symbolic(P, b)
    measured, bounded = analysis.residual(A, w), analysis.rounding(A, w)
    assert measured.sums.sum() < 0.2 * bounded.sums.sum()
    # It agrees with the residual measured from a stored factor, up to sums over fronts.
    L, order = analysis.factor(A).lower()
    stored = measured_residual(A, L, order, w)
    assert np.all(measured.sums <= 20.0 * stored)
    assert stored.sum() <= 1.5 * measured.sums.sum()


def test_what_is_not_definite_has_none():
    P, A = matrix(0, 8, 3, 0.0)
    analysis, w = symbolic(P, 3), np.ones(24)
    for broken in (add_to_diagonal(A, -0.999 * A.diagonal()), add_to_diagonal(A, -1e9)):
        assert analysis.residual(broken, w) is None
        assert analysis.rounding(broken, w) is None
