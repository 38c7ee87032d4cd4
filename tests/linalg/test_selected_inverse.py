"""Entries of inverses, against dense ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, point_graph, pose_graph, rng_of, seeds

from certpgo.errors import NumericalError
from certpgo.linalg import compiled
from certpgo.linalg.arrays import CSC
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal
from certpgo.linalg.factor import analyze, engines
from certpgo.linalg.selected_inverse import blocks_of_pairs, diagonal_blocks, fronts_of_inverse
from certpgo.objective.quadratic import Quadratic


def selected_inverse(L):
    """The lower triangle of (L L^T)^-1 on the pattern of L, closed under fill."""
    columns = []
    for front, k, Z in fronts_of_inverse(L):
        columns += [(Z[c:, c], front[c:]) for c in range(k - 1, -1, -1)]
    columns.reverse()
    indptr = np.cumsum([0, *(len(values) for values, _ in columns)])
    values, indices = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    return CSC((values, indices, indptr), shape=L.shape)


def factors(rng, d):
    """A problem, a definite matrix of its pattern, and its factors by each engine."""
    problem = Quadratic(pose_graph(rng, int(rng.integers(2, 30)), d)[0])
    A = add_to_diagonal(problem.matrix, np.full(problem.n * (d + 1), 0.1))
    pattern, order = problem.pattern, problem.order
    for engine in engines():
        analysis = analyze(pattern.indptr, pattern.indices, order=order, engine=engine)
        yield problem, A, *analysis.blocks(np.full(problem.n, d + 1)).factor(A).lower()


@given(seeds, dimensions)
@settings(max_examples=15)
def test_entries_are_those_of_the_inverse(seed, d):
    for _, A, L, p in factors(rng_of(seed), d):
        found, Z = selected_inverse(L), np.linalg.inv(A.toarray())[np.ix_(p, p)]
        kept = L.toarray() != 0.0
        assert (found.toarray()[np.triu(np.ones_like(kept), 1) > 0] == 0.0).all()
        np.testing.assert_allclose(found.toarray()[kept], Z[kept], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("cut", [(2, 0), (3, 1)])
def test_entries_that_cancelled_are_filled_in(cut):
    """A pattern that is not closed: L has a zero where fill would be."""
    L = np.tril(rng_of(0).uniform(0.5, 1.0, (5, 5))) + 2.0 * np.eye(5)
    L[cut] = 0.0
    found = selected_inverse(CSC(L)).toarray()
    Z = np.linalg.inv(L @ L.T)
    kept = L != 0.0
    np.testing.assert_allclose(found[kept], Z[kept], rtol=1e-12)


def test_a_diagonal():
    L = CSC(np.diag([1.0, 2.0, 4.0]))
    assert selected_inverse(L).diagonal().tolist() == [1.0, 0.25, 0.0625]


def test_columns_of_other_patterns_are_told_apart():
    """The first column has one entry more than the second, which is not in its rows."""
    L = np.diag([2.0, 3.0, 4.0, 5.0])
    L[[1, 3], 0] = L[2, 1] = L[3, 2] = 1.0
    found, Z = selected_inverse(CSC(L)).toarray(), np.linalg.inv(L @ L.T)
    kept = L != 0.0
    np.testing.assert_allclose(found[kept], Z[kept], rtol=1e-12)


@pytest.mark.parametrize("engine", engines())
def test_zeros_of_the_factor_are_not_those_of_the_inverse(engine):
    """A block of two rows that only what comes later couples: nothing fills in."""
    A = CSC(np.array([[4.0, 0, 1, 0], [0, 4, 0, 1], [1, 0, 4, 2], [0, 1, 2, 4]]))
    dense = A.toarray()
    A = CSC((dense.T.ravel(), np.tile(np.arange(4), 4), np.arange(0, 17, 4)), shape=(4, 4))
    two = np.array([0, 2, 4]), np.array([0, 1, 0, 1])
    analysis = analyze(*two, order=np.arange(2), engine=engine)
    L, p = analysis.blocks(np.full(2, 2)).factor(A).lower()
    Z = np.linalg.inv(dense)[np.ix_(p, p)]
    np.testing.assert_allclose(selected_inverse(L).toarray(), np.tril(Z), rtol=1e-12, atol=1e-15)


@given(seeds, dimensions)
@settings(max_examples=15)
def test_blocks_are_those_of_the_inverse_or_above(seed, d):
    for problem, A, L, p in factors(rng_of(seed), d):
        layout, Z = problem.pattern.layout(d + 1), np.linalg.inv(A.toarray())
        nodes = np.arange(problem.n)
        exact = Z.reshape(problem.n, d + 1, problem.n, d + 1)[nodes, :, nodes]
        for kernel in {compiled.AVAILABLE, False}:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(compiled, "AVAILABLE", kernel)
                found, above = (diagonal_blocks(L, p, layout, above=up) for up in (False, True))
            np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(above, exact, rtol=1e-6, atol=1e-9)
            assert (np.linalg.eigvalsh(above - exact) > 0.0).all()


@pytest.mark.usefixtures("compiled_form")
def test_blocks_of_points_and_of_pairs():
    """Rows that points do not have are zero."""
    graph, _ = point_graph(rng_of(3), 6, 5, 3)
    problem = Quadratic(graph)
    A = add_to_diagonal(problem.matrix, np.full(problem.matrix.shape[0], 0.1))
    layout, edges = problem.pattern.layout_of(A), graph.edges
    L, p = problem.symbolic(A).factor(A).lower()
    Z, of_node = np.linalg.inv(A.toarray()), np.arange(4 * problem.n).reshape(-1, 4)
    whole = np.zeros((4 * problem.n,) * 2)
    rows = np.rint(layout.pack(of_node.astype(float))).astype(int)
    whole[np.ix_(rows, rows)] = Z
    assert len(rows) < 4 * problem.n
    both = of_node[edges].reshape(len(edges), 8)
    for found, at in (
        (diagonal_blocks(L, p, layout), of_node),
        (blocks_of_pairs(L, p, layout, edges), both),
        (blocks_of_pairs(L, p, layout, edges[:0]), both[:0]),
    ):
        np.testing.assert_allclose(found, whole[at[:, :, None], at[:, None, :]], 1e-9, 1e-12)


@pytest.mark.usefixtures("compiled_form")
def test_blocks_where_entries_cancelled():
    """A pattern that is not closed: the first column's rows are not all in the second's."""
    L = np.tril(rng_of(0).uniform(0.5, 1.0, (5, 5))) + 2.0 * np.eye(5)
    L[3, 1] = 0.0
    layout = BlockPattern(5, np.array([[0, 1]])).layout(1)
    found, Z = diagonal_blocks(CSC(L), np.arange(5), layout), np.linalg.inv(L @ L.T)
    np.testing.assert_allclose(found[:, 0, 0], np.diagonal(Z), rtol=1e-12)


@pytest.mark.usefixtures("compiled_form")
def test_factors_too_ill_conditioned_have_no_bounds():
    L = np.tril(np.ones((60, 60))) * np.logspace(0, -30, 60) + np.diag(np.full(60, 1e-20))
    pattern = BlockPattern(1, np.zeros((0, 2), dtype=int))
    with pytest.raises(NumericalError, match="ill-conditioned"):
        diagonal_blocks(CSC(L), np.arange(60), pattern.layout(60), above=True)


@pytest.mark.usefixtures("compiled_form")
def test_blocks_beyond_the_pattern_are_refused():
    layout = BlockPattern(3, np.zeros((0, 2), dtype=int)).layout(1)
    with pytest.raises(NumericalError, match="without the whole blocks"):
        blocks_of_pairs(CSC(np.eye(3)), np.arange(3), layout, np.array([[0, 1]]))


@pytest.mark.skipif(not compiled.AVAILABLE, reason="without a C compiler")
def test_arrays_that_do_not_belong_together_are_refused():
    """Each number of each array, changed: refused, or without consequence."""
    L = CSC(np.tril(np.ones((4, 4))) + np.eye(4))
    at, order = np.array([[0, 1], [2, -1]]), np.arange(2)
    right = [np.asarray(of, dtype=np.int64) for of in (L.indptr, L.indices, at, order)]

    def answer(indptr, indices, at, order, entries=L.data, size=8):
        out = np.zeros(size)
        found = compiled.kernel.inverse_blocks(indptr, indices, entries, at, order, True, out)
        return found, out

    assert answer(*right)[0] is True
    with pytest.raises(ValueError, match="lower triangle"):
        answer(*right, entries=L.data[:-1])
    with pytest.raises(ValueError, match="as many blocks"):
        answer(*right, size=7)
    for place, part in enumerate(right):
        for k in np.ndindex(part.shape):
            for wrong in (part[k] - 1, part[k] + 1, -1, 4, 2**40, 2**63 - 1, -(2**63)):
                changed = list(right)
                changed[place] = part.copy()
                changed[place][k] = wrong
                try:
                    assert answer(*changed)[0] in (True, None)
                except ValueError:
                    assert wrong != part[k]
