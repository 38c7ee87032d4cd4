"""Factorization engines: each against dense algebra, and against each other."""

import importlib.util
import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from strategies import random_edges, rng_of, seeds

from certpgo.errors import MissingDependency, SpecError
from certpgo.linalg import compiled, factor
from certpgo.linalg import rotations as so
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal


@pytest.fixture(params=["superlu", "multifrontal"])
def engine(request):
    if request.param not in factor.engines():
        pytest.skip("not compiled")
    return request.param


def analysis(A, engine, b=1, order=None):
    """That of a matrix of blocks of b rows, of which those of ``order`` are eliminated first."""
    nodes = A.shape[0] // b
    row, column = A.nonzero()
    blocks = sparse.csc_array((np.ones(len(row)), (row // b, column // b)), shape=(nodes, nodes))
    blocks.sort_indices()
    found = factor.analyze(blocks.indptr, blocks.indices, order=order, engine=engine)
    return found.blocks(np.full(nodes, b))


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
    F = factor.analyze(P.indptr, P.indices, engine=engine).blocks(np.full(12, 3)).factor(A)
    B = rng_of(seed).standard_normal((A.shape[0], 4))
    np.testing.assert_allclose(A @ F.solve(B), B, rtol=0, atol=1e-11)
    np.testing.assert_allclose(A @ F.solve(B[:, 0]), B[:, 0], rtol=0, atol=1e-11)
    assert F.log_det == pytest.approx(np.linalg.slogdet(A.toarray())[1], rel=1e-12)
    for _ in range(2):  # the second time from what was kept
        L, p = F.lower()
        np.testing.assert_array_equal(np.sort(p), np.arange(A.shape[0]))
        dense = A.toarray()[np.ix_(p, p)]
        np.testing.assert_allclose((L @ L.T).toarray(), dense, rtol=0, atol=1e-11)
        assert np.all(L.diagonal() > 0)
        assert (L.toarray() == np.tril(L.toarray())).all()
    assert L.nnz >= A.shape[0]


def test_the_order_that_is_given_is_used(engine):
    """A chain in random order fills its factor; in an order of the engine's own it would not."""
    n, rng = 40, rng_of(0)
    order = rng.permutation(n)
    P = BlockPattern(n, np.c_[np.arange(n - 1), np.arange(1, n)])
    A = add_to_diagonal(P.assemble(np.zeros((n, 1, 1)), -np.ones((n - 1, 1, 1))), 3.0)
    F = analysis(A, engine, order=order).factor(A)
    b = np.arange(n)  # of integers
    np.testing.assert_allclose(A @ F.solve(b), b, rtol=0, atol=1e-11)
    neighbours, entries = {k: {k - 1, k + 1} & set(range(n)) for k in range(n)}, n
    for k in order:
        mine = neighbours.pop(k)
        entries += len(mine)
        for other in mine:
            neighbours[other] = (neighbours[other] | mine) - {k, other}
    assert entries > 2 * n
    assert np.count_nonzero(F.lower()[0].toarray()) == entries  # of supernodes, some are zero


def test_refactoring_with_the_same_pattern(engine):
    _, A = definite(0)
    symbolic = analysis(A, engine, 3)
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
        symbolic = analysis(A, engine, 2)
        assert symbolic.factor(add_to_diagonal(A, -0.99 * smallest)) is not None
        assert symbolic.factor(add_to_diagonal(A, -1.01 * smallest)) is None
        assert symbolic.factor(A) is not None  # a failure leaves the analysis usable


def test_zero_pivot_is_not_definite(engine):
    A = BlockPattern(2, np.array([[0, 1]])).assemble(np.zeros((2, 1, 1)), np.ones((1, 1, 1)))
    assert factor.factorize(A, engine=engine) is None


def test_what_is_not_finite_is_not_definite(engine):
    _, A = definite(0)
    for value in (np.nan, np.inf):
        broken = A.copy()
        broken.data[:1] = value
        assert factor.factorize(broken, engine=engine) is None


def test_factorize_orders_by_itself(engine):
    _, A = definite(3)
    b = np.ones(A.shape[0])
    np.testing.assert_allclose(
        A @ factor.factorize(A, engine=engine).solve(b), b, atol=1e-11, rtol=0
    )


@pytest.mark.parametrize("available", [True, False])
def test_the_compiled_engine_is_preferred_where_it_is(available, monkeypatch):
    monkeypatch.setattr(compiled, "AVAILABLE", available)
    assert factor.engines() == (("multifrontal", "superlu") if available else ("superlu",))


def test_engine_choice(monkeypatch):
    _, A = definite(1)
    monkeypatch.delenv("CERTPGO_ENGINE", raising=False)
    assert factor.default_engine() == factor.engines()[0]
    monkeypatch.setenv("CERTPGO_ENGINE", "superlu")
    assert factor.default_engine() == "superlu"
    assert factor.analyze(A.indptr, A.indices).engine == "superlu"
    with pytest.raises(SpecError, match="did you mean superlu"):
        factor.analyze(A.indptr, A.indices, engine="superl")
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    with pytest.raises(MissingDependency, match=re.escape(compiled.COMPILED)):
        factor.analyze(A.indptr, A.indices, order=np.arange(A.shape[0]), engine="multifrontal")


def solves(A, F):
    B = np.random.default_rng(0).standard_normal((A.shape[0], 2))
    np.testing.assert_allclose(A @ F.solve(B), B, rtol=0, atol=1e-11)


def is_the_factor(lower, A):
    L, p = lower
    dense = A.toarray()[np.ix_(p, p)]
    np.testing.assert_allclose((L @ L.T).toarray(), dense, rtol=0, atol=1e-11)


def test_factors_of_one_analysis_live_side_by_side(engine):
    _, A = definite(0)
    B, C = add_to_diagonal(A, 5.0), add_to_diagonal(A, 50.0)
    symbolic = analysis(A, engine, 3)
    first, second, third = (symbolic.factor(M) for M in (A, B, C))
    for M, F in ((A, first), (B, second), (C, third)):
        solves(M, F)
    # One is used up, one goes, one comes, one fails: the others do not notice.
    lower = first.lower()
    del second
    fourth = symbolic.factor(B)
    assert symbolic.factor(add_to_diagonal(A, -1e3)) is None
    for M, F in ((C, third), (B, fourth)):
        solves(M, F)
        is_the_factor(F.lower(), M)
    is_the_factor(lower, A)
    is_the_factor(first.lower(), A)


def grid(side):
    """The pattern of a square grid."""
    index = np.arange(side**2).reshape(side, side)
    right = np.c_[index[:, :-1].ravel(), index[:, 1:].ravel()]
    down = np.c_[index[:-1].ravel(), index[1:].ravel()]
    return BlockPattern(side**2, np.concatenate([right, down]))


def grid_laplacian(side):
    P = grid(side)
    m = len(P.edges)
    A = P.assemble(np.full((side**2, 1, 1), 0.1), -np.ones((m, 1, 1)))
    return P, add_to_diagonal(A, np.bincount(P.edges.ravel()).astype(float))


def test_large_graphs_are_ordered_by_nested_dissection(engine, monkeypatch):
    pytest.importorskip("pymetis")
    P, A = grid_laplacian(145)
    assert P.num_nodes >= factor.NESTED_FROM
    order = factor.fill_reducing_order(P.indptr, P.indices)
    np.testing.assert_array_equal(np.sort(order), np.arange(P.num_nodes))
    np.testing.assert_array_equal(order, factor._nested_dissection(P.indptr, P.indices))
    nested = analysis(A, engine, order=order).factor(A)
    solves(A, nested)
    monkeypatch.setattr(factor, "NESTED_FROM", P.num_nodes + 1)
    degree = factor.fill_reducing_order(P.indptr, P.indices)
    assert not np.array_equal(order, degree)
    plain = analysis(A, engine, order=degree).factor(A)
    assert nested.lower()[0].nnz < 1.2 * plain.lower()[0].nnz


def test_without_metis_minimum_degree_orders_them_all(engine, monkeypatch):
    P, A = grid_laplacian(12)
    expected = factor.fill_reducing_order(P.indptr, P.indices)
    find = importlib.util.find_spec
    monkeypatch.setattr(factor, "NESTED_FROM", 1)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "pymetis" else find(name)
    )
    order = factor.fill_reducing_order(P.indptr, P.indices)
    np.testing.assert_array_equal(order, expected)
    solves(A, analysis(A, engine, order=order).factor(A))


def test_metis_is_given_the_neighbours_of_every_node(monkeypatch):
    pymetis = pytest.importorskip("pymetis")
    seen, dissection = [], pymetis.nested_dissection
    monkeypatch.setattr(
        pymetis, "nested_dissection", lambda g, **more: seen.append(g) or dissection(g, **more)
    )
    P = BlockPattern(5, np.array([[0, 2], [2, 1], [3, 2]]))  # nobody knows the last
    factor._nested_dissection(P.indptr, P.indices)
    starts, others = seen[0].adj_starts, seen[0].adjacent
    neighbours = [others[a:b].tolist() for a, b in pairwise(starts)]
    assert neighbours == [[2], [2], [0, 1, 3], [2], []]


@given(seeds, st.integers(2, 40), st.integers(0, 40))
def test_nested_dissection_permutes_any_graph(seed, n, extra):
    pytest.importorskip("pymetis")
    P = BlockPattern(n, random_edges(rng_of(seed), n, extra))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(factor, "NESTED_FROM", 1)
        order = factor.fill_reducing_order(P.indptr, P.indices)
    np.testing.assert_array_equal(np.sort(order), np.arange(n))


def test_the_inverse_is_symmetric_where_it_is_nearly_singular(engine):
    """Iterations for eigenvectors rest on it."""
    R = so.exp(np.array([0.0, 0.0, 0.5]))
    P = BlockPattern(2, np.array([[0, 1]]))
    A = P.assemble(np.tile(np.eye(3), (2, 1, 1)), -R[None])  # three directions cost nothing
    A = add_to_diagonal(A, np.full(6, 1e-11))
    F = factor.analyze(P.indptr, P.indices, engine=engine).blocks(np.full(2, 3)).factor(A)
    X = F.solve(np.eye(6))
    assert abs(X).max() > 1e9
    np.testing.assert_allclose(X, X.T, rtol=0, atol=1e-14 * abs(X).max())
