"""The residual that is measured front by front, against exact arithmetic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrices import exact_residual, uneven_matrix
from strategies import random_edges, rng_of, seeds

from certpgo.linalg import compiled
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal
from certpgo.linalg.factor import analyze
from certpgo.linalg.residual import measured_residual

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")


def symbolic(P, b):
    return analyze(P.indptr, P.indices, engine="multifrontal").blocks(np.full(P.num_nodes, b))


@settings(max_examples=25)
@given(seeds, st.sampled_from([(6, 3), (10, 1), (4, 4)]), st.sampled_from([0.0, 2.0]))
def test_it_bounds_the_exact_residual_and_not_by_much(seed, shape, decades):
    (n, b), rng = shape, rng_of(seed)
    P, A = uneven_matrix(seed, n, b, decades)
    w = 10.0 ** rng.uniform(-2.0, 2.0, n * b)
    analysis = symbolic(P, b)
    # The same arithmetic in the same order gives the same factor.
    L, order = analysis.factor(A).lower()
    exact = exact_residual(A, L, order, w)
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
    P, A = uneven_matrix(0, 8, 3, 0.0)
    analysis, w = symbolic(P, 3), np.ones(24)
    for broken in (add_to_diagonal(A, -0.999 * A.diagonal()), add_to_diagonal(A, -1e9)):
        assert analysis.residual(broken, w) is None
        assert analysis.rounding(broken, w) is None
