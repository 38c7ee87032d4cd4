"""The compiled factorization: fronts of any sizes, against dense algebra."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from strategies import random_edges, rng_of, seeds

import certpgo
from certpgo.io.datasets.synthetic import grid3d
from certpgo.linalg import compiled, factor
from certpgo.linalg.arrays import CSC
from certpgo.linalg.blocks import BlockPattern, add_to_diagonal
from certpgo.linalg.multifrontal import Fronts, Tree, minimum_degree
from certpgo.objective.quadratic import Quadratic

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")


def definite(rng, P, sizes):
    """A definite matrix of that pattern whose nodes have these sizes; all blocks are stored."""
    starts = np.concatenate([[0], np.cumsum(sizes)])
    N = int(starts[-1])
    A, stored = np.zeros((N, N)), np.zeros((N, N), dtype=bool)
    for i in range(P.num_nodes):
        stored[starts[i] : starts[i + 1], starts[i] : starts[i + 1]] = True
    for i, j in P.edges:
        rows, columns = slice(starts[i], starts[i + 1]), slice(starts[j], starts[j + 1])
        A[rows, columns] = rng.standard_normal((sizes[i], sizes[j]))
        A[columns, rows] = A[rows, columns].T
        stored[rows, columns] = stored[columns, rows] = True
    A += np.diag(abs(A).sum(axis=1) + rng.uniform(0.1, 1.0, N))
    column, row = np.nonzero(stored)
    return CSC(sparse.csc_array((A[row, column], row, np.r_[0, np.cumsum(stored.sum(axis=0))])))


def fronts(P, sizes, order=None):
    order = minimum_degree(P.indptr, P.indices) if order is None else order
    return Fronts(Tree.of(P.indptr, P.indices, order), sizes)


@settings(max_examples=60)
@given(seeds, st.integers(2, 14), st.integers(0, 20), st.booleans())
def test_blocks_of_any_sizes(seed, n, extra, mixed):
    rng = rng_of(seed)
    P = BlockPattern(n, random_edges(rng, n, extra))
    sizes = rng.integers(1, 7, n) if mixed else np.full(n, rng.integers(1, 7))
    A = definite(rng, P, sizes)
    F = fronts(P, sizes, rng.permutation(n) if seed % 2 else None)
    panels = F.factor(A.data)
    L, p = panels.lower()
    lower, dense = L.toarray(), A.toarray()
    np.testing.assert_array_equal(np.sort(p), np.arange(F.size))
    np.testing.assert_allclose(lower @ lower.T, dense[np.ix_(p, p)], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(lower, np.tril(lower))
    assert (L.diagonal() > 0.0).all()
    # Analysed for the graph, not for these numbers: but nothing is longer than foreseen.
    assert np.all(np.count_nonzero(lower, axis=1) <= F.lengths[p])
    B = rng.standard_normal((F.size, 3))
    for right in (B, B[:, 0]):
        np.testing.assert_allclose(dense @ panels.solve(right), right, rtol=0, atol=1e-11)
    np.testing.assert_allclose(F.multiply(A.data, B[:, 0]), dense @ B[:, 0], rtol=0, atol=1e-11)
    w = rng.uniform(0.1, 10.0, (F.size, 2))
    sums, squares = F.row_sums(A.data, w)
    expected = np.empty_like(sums)
    expected[p] = abs(lower) @ (abs(lower).T @ w[p])
    np.testing.assert_allclose(sums, expected, rtol=1e-12)
    np.testing.assert_allclose(squares, A.diagonal(), rtol=1e-12)


@settings(max_examples=20)
@given(seeds, st.sampled_from([-100, 0, 100]), st.booleans())
def test_factors_kept_in_single_precision(seed, power, mixed):
    rng = rng_of(seed)
    P, sizes = BlockPattern(12, random_edges(rng, 12, 12)), rng.integers(1, 5, 12)
    A, F = definite(rng, P, sizes), fronts(P, sizes)
    unit = np.ldexp(1.0, power)
    panels = F.factor_kept_single(unit * A.data, unit * A.diagonal(), mixed=mixed)
    assert panels.panels.dtype == np.float32
    b = rng.standard_normal(F.size)
    np.testing.assert_allclose(A @ panels.solve(b) * unit, b, rtol=0, atol=1e-3 * abs(b).max())
    # No unit is out of range, and none matters.
    again = F.factor_kept_single(A.data, A.diagonal(), mixed=mixed)
    np.testing.assert_array_equal(again.panels, panels.panels)


def test_mixed_precision_takes_what_single_does_not():
    n = 30
    P = BlockPattern(n, np.c_[np.arange(n - 1), np.arange(1, n)])
    A = P.assemble(np.full((n, 1, 1), 2.0), -np.ones((n - 1, 1, 1)))
    A = add_to_diagonal(A, np.r_[-1.0 + 1e-9, np.zeros(n - 2), -1.0])
    F = fronts(P, np.ones(n, dtype=int), np.arange(n))
    assert F.factor_kept_single(A.data, A.diagonal()) is None
    assert F.factor_kept_single(A.data, A.diagonal(), mixed=True) is not None


@pytest.mark.parametrize("edges", ["star", "chain", "complete", "none"])
def test_graphs_whose_factors_are_known(edges):
    n = 9
    pairs = {
        "star": [(0, k) for k in range(1, n)],
        "chain": [(k, k + 1) for k in range(n - 1)],
        "complete": [(i, j) for j in range(n) for i in range(j)],
        "none": [],
    }[edges]
    P = BlockPattern(n, np.array(pairs, dtype=int).reshape(-1, 2))
    order = minimum_degree(P.indptr, P.indices)
    np.testing.assert_array_equal(np.sort(order), np.arange(n))
    lengths = Tree.of(P.indptr, P.indices, order).lengths
    # Without fill: of star, chain and nothing; the complete graph's triangle is full.
    assert lengths.sum() == n + len(pairs)


@settings(max_examples=40)
@given(seeds, st.integers(2, 60), st.integers(0, 80))
def test_minimum_degree_permutes_any_graph(seed, n, extra):
    P = BlockPattern(n, random_edges(rng_of(seed), n, extra))
    order = minimum_degree(P.indptr, P.indices)
    np.testing.assert_array_equal(np.sort(order), np.arange(n))


@pytest.mark.parametrize("name", ["MIT", "sphere2500", "torus3D", "manhattan"])
def test_minimum_degree_fills_as_little_as_scipys(name, dataset, monkeypatch):
    P = Quadratic(dataset(name).graph).pattern
    ours = Tree.of(P.indptr, P.indices, minimum_degree(P.indptr, P.indices)).lengths.sum()
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    other = factor.fill_reducing_order(P.indptr, P.indices)
    theirs = Tree.of(P.indptr, P.indices, other).lengths.sum()
    assert ours <= 1.2 * theirs


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e300])
def test_what_is_not_definite_is_refused(value):
    rng = rng_of(0)
    P, sizes = BlockPattern(8, random_edges(rng, 8, 8)), np.full(8, 2)
    A, F = definite(rng, P, sizes), fronts(P, sizes)
    for place in range(0, A.nnz, 5):
        data = A.data.copy()
        data[place] = value
        data[CSC((np.arange(A.nnz), A.indices, A.indptr), A.shape).T.tocsc().data[place]] = value
        assert F.factor(data) is None
        assert F.row_sums(data, np.ones((16, 1))) is None
        assert F.factor_kept_single(data, A.diagonal()) is None


def test_arrays_that_do_not_belong_together_are_refused():
    rng = rng_of(0)
    P, sizes = BlockPattern(8, random_edges(rng, 8, 8)), np.full(8, 2)
    A, F = definite(rng, P, sizes), fronts(P, sizes)
    kernel, rest = compiled.kernel, (None, None, None, False)
    with pytest.raises(ValueError, match="another pattern"):
        F.factor(A.data[:-1])
    with pytest.raises(ValueError, match="another size"):
        F.multiply(A.data, np.ones(15))
    sums = np.ones(16), np.ones(15), np.ones(16)
    with pytest.raises(ValueError, match="differ in size"):
        kernel.factor(F.arrays, A.data, None, None, sums, None, False)
    for other in (np.float32, np.int64, np.complex128):
        with pytest.raises(TypeError, match="array of float64 expected"):
            kernel.factor(F.arrays, A.data.astype(other), None, *rest)
    with pytest.raises(ValueError, match="not C-contiguous"):
        kernel.factor(F.arrays, np.repeat(A.data, 2)[::2], None, *rest)
    panels, ones = F.factor(A.data).panels, np.ones(16)
    for L, scale, B, X in (
        (panels[:-1], None, ones, ones),
        (panels, ones[:-1], ones, ones),
        (panels, None, ones[:-1], ones[:-1]),
        (panels, None, np.ones(32), ones),
    ):
        with pytest.raises(ValueError, match="another matrix"):
            kernel.solve(F.arrays, L, scale, B, X.copy(), False)
    with pytest.raises(TypeError, match="array of float32 expected"):
        kernel.solve(F.arrays, panels, None, ones, ones.copy(), True)
    for place in range(12):
        parts = list(F.arrays)
        parts[place] = parts[place][:-1]
        with pytest.raises(ValueError, match="fronts"):
            kernel.multiply(tuple(parts), A.data, np.ones(16), np.zeros(16))


@pytest.mark.parametrize("place", range(15))
def test_fronts_that_contradict_themselves_are_refused(place):
    """Each number of each array, changed: refused, or without consequence."""
    rng = rng_of(0)
    P, sizes = BlockPattern(6, random_edges(rng, 6, 5)), rng.integers(1, 4, 6)
    A, F = definite(rng, P, sizes), fronts(P, sizes)
    kernel, N, right = compiled.kernel, F.size, F.arrays[place]
    x = rng.standard_normal(N)

    def answers(of):
        L, y, X = np.empty(F.entries), np.zeros(N), np.empty(N)
        heights, rows = np.zeros(N, dtype=np.int64), np.zeros(F.entries, dtype=np.int64)
        values = np.zeros(F.entries)
        for call in (
            lambda: kernel.factor(of, A.data, None, L, None, None, False),
            lambda: kernel.multiply(of, A.data, x, y),
            lambda: kernel.solve(of, L, None, x, X, False),
            lambda: kernel.lower(of, L, heights, rows, values),
        ):
            try:
                call()
            except (ValueError, MemoryError):
                L[:] = expected[0] if expected else np.nan
        return [L, y, X, heights, rows, values]

    expected = []
    expected = answers(F.arrays)
    np.testing.assert_allclose(A @ expected[2], x, atol=1e-12)
    for k, value in np.ndenumerate(right):
        for wrong in (value - 1, value + 1, -1, N, 2**40, 2**63 - 1, -(2**63)):
            part = wrong
            if np.ndim(right):
                part = right.copy()
                part[k] = wrong
            answers((*F.arrays[:place], part, *F.arrays[place + 1 :]))


def test_rows_of_other_patterns_are_refused():
    rows = np.full(8, 7, dtype=np.int32)
    for indptr, indices, b in (
        ([0, 2], [0, 1], 2),
        ([0, 1, 2], [0, 2], 2),
        ([0, 1, 2], [-1, 1], 2),
        ([0, 1, 2], [0, 2**40], 2),
        ([0, 1, 2], [0, 1], 0),
        ([0, 1, 2], [0, 1], -2),
        ([0, 1, 2], [0, 1], 2**31 - 1),
        ([0, 2, 1], [0, 1], 2),
        ([], [], 2),
    ):
        whole = (np.array(x, dtype=np.int64) for x in (indptr, indices))
        with pytest.raises(ValueError, match="another pattern"):
            compiled.kernel.expand(*whole, b, rows)
    assert (rows == 7).all()
    one = np.frombuffer(bytes(17), dtype=np.uint8)[1:].view(np.int64)
    with pytest.raises(TypeError, match="int64"):  # at odd addresses
        compiled.kernel.expand(one, one, 1, rows[:2])


def test_patterns_that_are_none_are_refused():
    P = BlockPattern(4, np.array([[0, 1], [1, 2], [2, 3]]))
    indptr, indices = (np.asarray(x, dtype=np.int64) for x in (P.indptr, P.indices))
    order, ones = np.arange(4), np.ones(4, dtype=np.int64)
    for pattern in (
        (indptr, indices, order[:-1], ones),
        (indptr, indices + 1, order, ones),
        (indptr[::-1].copy(), indices, order, ones),
        (indptr, indices, order + 1, ones),
    ):
        with pytest.raises(ValueError, match="not a pattern"):
            compiled.kernel.analyze(*pattern)
    with pytest.raises(ValueError, match="each node once"):
        compiled.kernel.analyze(indptr, indices, np.zeros(4, dtype=np.int64), ones)
    with pytest.raises(ValueError, match="not a pattern"):
        compiled.kernel.order(indptr[:0], indices[:0])


def test_sums_over_edges_that_name_other_nodes_are_refused():
    graph = grid3d(2, np.random.default_rng(0)).graph
    n, m = graph.num_nodes, graph.num_edges
    P, kappa, edges = np.tile(np.eye(3), (m, 1, 1)), np.ones(m), graph.edges
    R, terms, kernel = np.tile(np.eye(3), (n, 1, 1)), np.empty(m), compiled.kernel
    for why, wrong in (
        ("another graph", (edges + n, P, None, kappa, None, None, None)),
        ("expected", (edges, None, None, kappa, None, None, None)),
        ("expected", (edges, P, None, None, None, None, None)),
        ("expected", (edges, P, None, kappa, kappa, None, None)),
        ("length", (edges[:-1], P, None, kappa, None, None, None)),
    ):
        with pytest.raises(ValueError, match=why):
            kernel.gradient(wrong, 3, 3, R, np.zeros((n, 3)), None, terms)
        with pytest.raises(ValueError, match=why):
            kernel.hessian(wrong, 3, R, R, R, None, None, R.copy(), np.empty((m, 3, 3)))
        with pytest.raises(ValueError, match=why):
            kernel.first_order(wrong, 3, R, None, kappa[:n], None, R[0].copy(), R.copy(), terms)
    with pytest.raises(ValueError, match="2 or 3 dimensions"):
        kernel.gradient((edges, P, None, kappa, None, None, None), 4, 4, R, None, None, terms)
    with pytest.raises(IndexError, match="out of range"):
        kernel.scatter_sum(np.array([2]), np.ones((1, 2)), np.zeros((2, 2)), 2)
    with pytest.raises(ValueError, match="as many rows"):
        kernel.scatter_sum(np.array([0]), np.ones((1, 2)), np.zeros(5), 2)


def test_derivatives_of_another_graph_are_refused():
    graph = grid3d(2, np.random.default_rng(0)).graph
    n, m, rotation = graph.num_nodes, graph.num_edges, graph.rotations_alone
    measured = rotation.rotations, None, rotation.kappa, graph.tau, graph.translations, None
    R, t, ones = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.ones(n)
    hessian = [R, R, R, t, ones, np.empty((n, 6, 6)), np.empty((m, 6, 6))]
    first = [R, t, ones, ones, np.empty((n, 6)), R.copy(), np.empty(m)]
    kernel = compiled.kernel
    # The last is a place where None is taken of rotations alone.
    for function, arrays, without in ((kernel.hessian, hessian, 3), (kernel.first_order, first, 1)):
        function((rotation.edges, *measured), 3, *arrays)
        for place, array in enumerate(arrays):
            wrong = [*arrays[:place], array[:-1], *arrays[place + 1 :]]
            with pytest.raises(ValueError, match="another graph"):
                function((rotation.edges, *measured), 3, *wrong)
        wrong = [*arrays[:without], None, *arrays[without + 1 :]]
        with pytest.raises(ValueError, match="another graph"):
            function((rotation.edges, *measured), 3, *wrong)
        with pytest.raises(ValueError, match="another graph"):
            function((rotation.edges + n, *measured), 3, *arrays)


@pytest.mark.parametrize("exponent", [-900, -390, 390, 900])
def test_single_precision_serves_every_unit(exponent):
    rng = rng_of(1)
    P, sizes = BlockPattern(8, random_edges(rng, 8, 8)), np.full(8, 2)
    A, F, b = definite(rng, P, sizes), fronts(P, sizes), rng.standard_normal((16, 2))
    panels = F.factor_kept_single(np.ldexp(A.data, exponent), np.ldexp(A.diagonal(), exponent))
    x = np.linalg.solve(A.toarray(), b)
    np.testing.assert_allclose(panels.solve(np.ldexp(b, exponent)), x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(panels.solve(np.ldexp(b[:, 0], exponent)), x[:, 0], atol=1e-5)


def test_no_bound_where_products_underflow():
    rng = rng_of(2)
    P, sizes = BlockPattern(8, random_edges(rng, 8, 8)), np.full(8, 2)
    A = definite(rng, P, sizes)
    symbolic = factor.analyze(P.indptr, P.indices, engine="multifrontal").blocks(sizes)
    for exponent, bounded in ((0, True), (-700, True), (-900, False)):
        scaled = CSC((np.ldexp(A.data, exponent), A.indices, A.indptr), A.shape)
        assert (symbolic.rounding(scaled, np.ones(16)) is not None) == bounded
        assert (symbolic.residual(scaled, np.ones(16)) is not None) == bounded


def test_engines_agree_and_serve_alone(monkeypatch):
    graph = grid3d(4, np.random.default_rng(0)).graph
    found = certpgo.solve(graph)
    monkeypatch.setenv("CERTPGO_ENGINE", "superlu")
    other = certpgo.solve(graph)
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    monkeypatch.delenv("CERTPGO_ENGINE")
    alone = certpgo.solve(graph)
    assert found.certificate.engine == "multifrontal"
    assert other.certificate.engine == alone.certificate.engine == "superlu"
    for answer in (other, alone):
        assert answer.verdict is found.verdict
        assert answer.cost == pytest.approx(found.cost, rel=1e-9)
        bound = answer.certificate.lower_bound
        assert bound == pytest.approx(found.certificate.lower_bound, rel=1e-7)


def test_the_environment_leaves_the_kernel_out():
    program = """
import numpy as np
import certpgo
from certpgo.cli import main
from certpgo.io.datasets.synthetic import grid3d
answer = certpgo.solve(grid3d(3, np.random.default_rng(0)).graph)
print(answer.verdict.value, answer.certificate.engine)
main(["list", "engines", "--json"])
"""
    own = {k: v for k, v in os.environ.items() if k != "CERTPGO_ENGINE"} | {"CERTPGO_KERNEL": "0"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=own, check=True)
    said, listed = done.stdout.split("\n", 1)
    assert said == "CERTIFIED superlu"
    here = {row["name"]: row["here"] for row in json.loads(listed)["engines"]}
    assert here["multifrontal"].startswith("no: CERTPGO_KERNEL=0 leaves it out; reading takes 2 to")
    assert here["superlu"] == "yes"


def test_patterns_and_trees_that_are_none_are_refused():
    """Unsymmetric or unsorted patterns, wrong pointers, parents and sizes: no crash."""

    def whole(*values):
        return np.array(values, dtype=np.int64)

    refused = pytest.raises(ValueError, match=r"pattern|tree of fronts|matrix|one row")
    for indptr, indices in (
        (whole(0, 2, 3), whole(0, 1, 1)),
        (whole(0, 2, 4), whole(1, 0, 0, 1)),
        (whole(0, 3, 5), whole(0, 1, 1, 0, 1)),
    ):
        with refused:
            compiled.kernel.order(indptr, indices)
        with refused:
            compiled.kernel.analyze(indptr, indices, whole(0, 1), whole(1, 1))
    two, three = np.zeros(2, dtype=np.int64), np.zeros(3, dtype=np.int64)
    right = [whole(0, 1, 2), whole(0, 1), whole(0, 1), whole(1, 1)]  # pattern, order, sizes
    right += [whole(0, 1, 2), whole(1, -1), whole(0, 1, 1), whole(1)]  # fronts
    right += [two, three, three.copy(), three.copy()]
    assert compiled.kernel.measure(*right) == (1, 2, 2)
    for place, wrong in (
        (0, whole(0, 2, 1)),
        (1, whole(0, 2)),
        (2, whole(0, 2)),
        (3, whole(1, 0)),
        (3, whole(1, 2**63 - 1)),
        (4, whole(-5, 1, 2)),
        (5, whole(500000000, -1)),
        (5, whole(0, -1)),
        (5, whole(-2, -1)),
        (6, whole(0, 2, 1)),
        (7, whole(2)),
        *((k, right[k][:-1]) for k in range(12)),
    ):
        with refused:
            compiled.kernel.measure(*right[:place], wrong, *right[place + 1 :])
    short = np.array([0, 2000000000, 2], dtype=np.int32)
    with refused:
        compiled.kernel.diagonal_places(short, short[:2], np.zeros(2, dtype=np.int64))
    with refused:
        compiled.kernel.assemble(
            (whole(-90000000, 1), whole(-90000000), whole(), whole()),
            np.ones(1),
            np.zeros(0),
            np.zeros(1),
        )
    tree = Tree.of(whole(0, 1, 2), whole(0, 1), whole(0, 1))
    with refused:
        Fronts(tree, whole(1, 0)).factor(np.ones(1))
    pattern = np.array([0, 1, 2], dtype=np.int32), np.array([0, 1], dtype=np.int32)
    for wrong in (
        (*pattern, np.ones(3), whole(0)),
        (*pattern, np.ones(2), whole(2)),
        (short, pattern[1], np.ones(2), whole(0)),
        (pattern[0], np.array([1, 1], dtype=np.int32), np.ones(2), whole(0)),
        (pattern[0], np.array([7, 1], dtype=np.int32), np.ones(2), whole(0)),
    ):
        with refused:
            compiled.kernel.pin(*wrong)
