"""Factors in single precision: solutions as accurate as promised, or double precision."""

import numpy as np
import pytest
from scipy import sparse

from certpgo.linalg import refined
from certpgo.linalg.factor import analyze, engines
from certpgo.linalg.refined import ACCURACY, SingleFirst

pytestmark = pytest.mark.skipif("multifrontal" not in engines(), reason="without a C compiler")


@pytest.fixture
def system(monkeypatch):
    """A shifted Laplacian of a path, its analysis, and which precisions were asked for."""
    monkeypatch.setattr(refined, "SINGLE_FROM", 0)

    def build(shift):
        n = 400
        rows = np.arange(n - 1)
        off = sparse.coo_array((-np.ones(n - 1), (rows, rows + 1)), shape=(n, n))
        A = (off + off.T + sparse.diags_array(np.full(n, 2.0 + shift))).tocsc()
        A.sort_indices()
        symbolic = analyze(A.indptr, A.indices).blocks(np.ones(n, dtype=int))
        asked, factor = [], symbolic.factor
        monkeypatch.setattr(type(symbolic), "products", 8.0)
        symbolic.factor = lambda A, precision="double": (
            asked.append(precision) or factor(A, precision)
        )
        return A, symbolic, asked

    return build


def test_a_factor_in_single_precision_suffices_where_conditions_are_good(system):
    A, symbolic, asked = system(1e-2)
    b = np.random.default_rng(0).standard_normal(A.shape[0])
    factor = SingleFirst().factor(symbolic, A)
    error = factor.solve(b) - np.linalg.solve(A.toarray(), b)
    assert error @ A @ error <= ACCURACY**2 * (b @ np.linalg.solve(A.toarray(), b))
    assert asked == ["single"]


def test_double_precision_takes_over_for_good_where_it_does_not(system, monkeypatch):
    A, symbolic, asked = system(1e-2)
    b = np.random.default_rng(0).standard_normal(A.shape[0])
    monkeypatch.setattr(refined, "ACCURACY", 1e-12)  # out of reach of as few products
    first = SingleFirst()
    monkeypatch.setattr(type(symbolic), "products", 1.0)
    factor = first.factor(symbolic, A)
    for _ in range(2):
        np.testing.assert_allclose(factor.solve(b), np.linalg.solve(A.toarray(), b), rtol=1e-10)
    first.factor(symbolic, A)
    assert asked == ["single", "double", "double"]


def test_a_factor_that_has_served_is_given_up(system, monkeypatch):
    A, symbolic, asked = system(1e-2)
    b = np.random.default_rng(0).standard_normal(A.shape[0])
    factor = SingleFirst().factor(symbolic, A)
    assert np.isfinite(factor.solve(b)).all()
    monkeypatch.setattr(refined, "ACCURACY", 1e-12)
    monkeypatch.setattr(type(symbolic), "products", 1.0)
    assert np.isnan(factor.solve(b)).all()
    assert asked == ["single"]


def test_what_is_not_definite_has_no_factor(system):
    A, symbolic, _ = system(-3.0)
    assert SingleFirst().factor(symbolic, A) is None
