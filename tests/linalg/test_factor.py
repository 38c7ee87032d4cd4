"""Factorization engines: each against dense algebra, and against each other."""

import numpy as np
import pytest
from hypothesis import given
from strategies import random_edges, rng_of, seeds

from certpgo.errors import MissingDependency, SpecError
from certpgo.linalg import factor
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal, expand


@pytest.fixture(params=["superlu", "cholmod"])
def engine(request):
    if request.param not in factor.engines():
        pytest.skip("the cvxopt wheel is not installed")
    return request.param


def definite(seed, n=12, b=3):
    rng = rng_of(seed)
    edges = random_edges(rng, n, n)
    P = BlockPattern(n, edges)
    upper = rng.standard_normal((len(edges), b, b))
    A = P.assemble(np.zeros((n, b, b)), upper)
    return P, add_to_diagonal(A, abs(A).sum(axis=1) + 0.1)


@pytest.mark.parametrize("seed", range(5))
def test_solve_lower_and_permutation(engine, seed):
    P, A = definite(seed)
    order = expand(factor.fill_reducing_order(P.indptr, P.indices, engine=engine), 3)
    F = factor.analyze(A, order=order, engine=engine).factor(A)
    B = rng_of(seed).standard_normal((A.shape[0], 4))
    np.testing.assert_allclose(A @ F.solve(B), B, rtol=0, atol=1e-11)
    np.testing.assert_allclose(A @ F.solve(B[:, 0]), B[:, 0], rtol=0, atol=1e-11)
    for _ in range(2):  # the second time from what was kept
        L, p = F.lower()
        np.testing.assert_array_equal(np.sort(p), np.arange(A.shape[0]))
        dense = A.toarray()[np.ix_(p, p)]
        np.testing.assert_allclose((L @ L.T).toarray(), dense, rtol=0, atol=1e-11)
        assert np.all(L.diagonal() > 0)
        assert (L.toarray() == np.tril(L.toarray())).all()
    np.testing.assert_allclose(A @ F.solve(B), B, rtol=0, atol=1e-11)
    assert F.nnz == L.nnz >= A.shape[0]


def test_refactoring_with_the_same_pattern(engine):
    _, A = definite(0)
    symbolic = factor.analyze(A, engine=engine)
    first = symbolic.factor(A)
    second = symbolic.factor(add_to_diagonal(A, 5.0))
    b = np.ones(A.shape[0])
    np.testing.assert_allclose(A @ first.solve(b), b, rtol=0, atol=1e-11)
    np.testing.assert_allclose(add_to_diagonal(A, 5.0) @ second.solve(b), b, rtol=0, atol=1e-11)
    assert symbolic.engine == engine


@given(seeds)
def test_definite_or_not_as_the_eigenvalues_say(seed):
    _, A = definite(seed, n=6, b=2)
    smallest = np.linalg.eigvalsh(A.toarray())[0]
    for engine in factor.engines():
        symbolic = factor.analyze(A, engine=engine)
        assert symbolic.factor(add_to_diagonal(A, -0.99 * smallest)) is not None
        assert symbolic.factor(add_to_diagonal(A, -1.01 * smallest)) is None
        assert symbolic.factor(A) is not None  # a failure leaves the analysis usable


def test_zero_pivot_is_not_definite(engine):
    A = BlockPattern(2, np.array([[0, 1]])).assemble(np.zeros((2, 1, 1)), np.ones((1, 1, 1)))
    assert factor.analyze(A, engine=engine).factor(A) is None


@pytest.mark.parametrize("seed", range(5))
def test_inertia_counts_signs(seed):
    _, A = definite(seed)
    eigenvalues = np.linalg.eigvalsh(A.toarray())
    middle = 0.5 * (eigenvalues[3] + eigenvalues[4])
    assert factor.inertia(add_to_diagonal(A, -middle)) == (4, 0, len(eigenvalues) - 4)


def test_factorize_orders_by_itself(engine):
    _, A = definite(3)
    b = np.ones(A.shape[0])
    np.testing.assert_allclose(
        A @ factor.factorize(A, engine=engine).solve(b), b, atol=1e-11, rtol=0
    )


def test_engine_choice(monkeypatch):
    _, A = definite(1)
    monkeypatch.setenv("CERTPGO_ENGINE", "superlu")
    assert factor.default_engine() == "superlu"
    assert factor.analyze(A).engine == "superlu"
    with pytest.raises(SpecError, match="did you mean superlu"):
        factor.analyze(A, engine="superl")
    monkeypatch.setattr(factor, "engines", lambda: ("superlu",))
    with pytest.raises(MissingDependency, match="pip install"):
        factor.analyze(A, order=np.arange(A.shape[0]), engine="cholmod")
