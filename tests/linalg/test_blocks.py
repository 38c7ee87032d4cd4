"""Block assembly against a loop over the edges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import random_edges, rng_of, seeds

from certpgo.graph.edges import adjacency
from certpgo.linalg.blocks import (
    BlockPattern,
    add_to_diagonal,
    diagonal_of,
    pinned,
    scatter_sum,
)


def looped(n, edges, diagonal, upper):
    b = diagonal.shape[-1]
    A = np.zeros((n * b, n * b))
    for k in range(n):
        A[k * b : k * b + b, k * b : k * b + b] += diagonal[k]
    for e, (i, j) in enumerate(edges):
        A[i * b : i * b + b, j * b : j * b + b] += upper[e]
        A[j * b : j * b + b, i * b : i * b + b] += upper[e].T
    return A


def symmetric(rng, n, b):
    A = rng.standard_normal((n, b, b))
    return A + np.swapaxes(A, 1, 2)


@given(seeds, st.integers(1, 4), st.integers(2, 8))
def test_assembly_is_the_loop(seed, b, n):
    rng = rng_of(seed)
    edges = random_edges(rng, n, n)
    diagonal, upper = symmetric(rng, n, b), rng.standard_normal((len(edges), b, b))
    A = BlockPattern(n, edges).assemble(diagonal, upper)
    assert A.has_sorted_indices
    np.testing.assert_allclose(A.toarray(), looped(n, edges, diagonal, upper), rtol=0, atol=1e-13)


# --- Points


def with_points(seed, n=7, *, parallel=True):
    """A pattern some of whose nodes, at least one of either kind, are points."""
    rng = rng_of(seed)
    edges = random_edges(rng, n, 2 * n if parallel else 0)
    points = rng.random(n) < 0.5
    points[rng.choice(n, 2, replace=False)] = True, False
    return rng, BlockPattern(n, edges, points), points


def rows_of(points, b, of_points):
    """The rows that are left of the padded matrix."""
    within = np.tile(np.arange(b), (len(points), 1))
    return np.flatnonzero((within < np.where(points, of_points, b)[:, None]).ravel())


SIZES = [(3, 1), (4, 1), (3, 2), (6, 3), (1, 0), (3, 0)]


@pytest.mark.parametrize("parallel", [True, False])
@pytest.mark.parametrize(("b", "of_points"), SIZES)
@pytest.mark.usefixtures("compiled_form")
def test_rows_of_points_are_left_out(b, of_points, parallel):
    for seed in range(10):
        rng, pattern, points = with_points(seed, parallel=parallel)
        n, edges = pattern.num_nodes, pattern.edges
        diagonal, upper = symmetric(rng, n, b), rng.standard_normal((len(edges), b, b))
        A = pattern.assemble(diagonal, upper, of_points)
        rows = rows_of(points, b, of_points)
        whole = looped(n, edges, diagonal, upper)
        assert A.shape == (len(rows),) * 2
        assert A.has_sorted_indices
        assert A.indices.dtype == A.indptr.dtype == np.int32
        np.testing.assert_allclose(A.toarray(), whole[np.ix_(rows, rows)], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(diagonal_of(A), A.diagonal())
        assert pattern.layout_of(A) is pattern.layout(b, of_points)
        # The same nodes without points have blocks of one size.
        bare = BlockPattern(n, edges).assemble(diagonal, upper, of_points).toarray()
        np.testing.assert_allclose(bare, whole, rtol=0, atol=1e-13)
        again = pattern.assemble(0.0 * diagonal, 0.0 * upper, of_points)
        np.testing.assert_array_equal(again.indices, A.indices)
        np.testing.assert_array_equal(again.indptr, A.indptr)


@pytest.mark.parametrize(("b", "of_points"), SIZES)
def test_rows_are_packed_and_unpacked(b, of_points):
    rng, pattern, points = with_points(b)
    layout, n = pattern.layout(b, of_points), pattern.num_nodes
    values = rng.standard_normal((n, b, 2))
    kept = values.copy()
    kept[points, of_points:] = 0.0
    flat = layout.pack(values)
    np.testing.assert_array_equal(flat, values.reshape(-1, 2)[rows_of(points, b, of_points)])
    np.testing.assert_array_equal(layout.unpack(flat), kept)
    np.testing.assert_array_equal(layout.pack(layout.unpack(flat)), flat)
    np.testing.assert_array_equal(layout.sizes, np.where(points, of_points, b))
    np.testing.assert_array_equal(layout.whole, np.flatnonzero(~points))
    assert layout.size == len(flat)
    for node in range(n):
        size = layout.sizes[node]
        own = slice(layout.first_row(node), layout.first_row(node) + size)
        np.testing.assert_array_equal(flat[own], values[node, :size])


@pytest.mark.parametrize("k", [1, 2, 3])
def test_trailing_rows_are_those_of_poses(k):
    _, pattern, points = with_points(k)
    b, of_points = 5, 5 - k
    values = np.arange(7 * b).reshape(7, b) + 1.0
    layout = pattern.layout(b, of_points)
    found = layout.pack(values)[layout.trailing(k)]
    np.testing.assert_array_equal(found, values[~points, b - k :].ravel())
    whole = pattern.layout(b)
    np.testing.assert_array_equal(whole.pack(values)[whole.trailing(k)], values[:, b - k :].ravel())


@pytest.mark.parametrize(("b", "of_points"), [(3, 1), (6, 3), (3, 2)])
@pytest.mark.usefixtures("compiled_form")
def test_diagonal_blocks_of_poses_have_their_places(b, of_points):
    rng, pattern, points = with_points(b)
    diagonal = symmetric(rng, 7, b)
    upper = rng.standard_normal((len(pattern.edges), b, b))
    A = pattern.assemble(diagonal, upper, of_points)
    layout = pattern.layout(b, of_points)
    np.testing.assert_allclose(A.data[layout.diagonal], diagonal[~points], rtol=0, atol=1e-13)
    node = int(layout.whole[-1])
    rows = layout.first_row(node) + np.arange(b)
    cut, expected = pinned(A, rows), A.toarray()
    keep = np.diag(expected)[rows]
    expected[rows], expected[:, rows] = 0.0, 0.0
    expected[rows, rows] = keep
    np.testing.assert_array_equal(cut.toarray(), expected)


def test_every_matrix_of_a_block_size_has_one_pattern():
    rng = np.random.default_rng(0)
    edges = random_edges(rng, 9, 6)
    P = BlockPattern(9, edges)
    A = P.assemble(symmetric(rng, 9, 3), rng.standard_normal((len(edges), 3, 3)))
    B = P.assemble(np.zeros((9, 3, 3)), np.zeros((len(edges), 3, 3)))
    np.testing.assert_array_equal(A.indices, B.indices)
    np.testing.assert_array_equal(A.indptr, B.indptr)


def test_diagonal_and_pinning_keep_the_pattern():
    rng = np.random.default_rng(1)
    edges = random_edges(rng, 5, 4)
    A = BlockPattern(5, edges).assemble(symmetric(rng, 5, 2), rng.standard_normal((8, 2, 2)))
    np.testing.assert_array_equal(diagonal_of(A), A.diagonal())
    bump = rng.standard_normal(10)
    np.testing.assert_allclose(
        add_to_diagonal(A, bump).toarray(), A.toarray() + np.diag(bump), rtol=0, atol=1e-15
    )
    cut = pinned(A, np.array([3])).toarray()
    expected = A.toarray()
    keep = expected[3, 3]
    expected[3], expected[:, 3] = 0.0, 0.0
    expected[3, 3] = keep
    np.testing.assert_array_equal(cut, expected)
    np.testing.assert_array_equal(pinned(A, np.array([3])).indices, A.indices)


def test_scatter_sum():
    index = np.array([2, 0, 2])
    values = np.arange(12.0).reshape(3, 2, 2)
    out = scatter_sum(index, values, 4)
    np.testing.assert_array_equal(out[2], values[0] + values[2])
    np.testing.assert_array_equal(out[1], 0.0)


def test_adjacency_sums_repeated_pairs_in_32_bits():
    i, j = np.array([0, 2, 0], dtype=np.int64), np.array([1, 1, 1], dtype=np.int64)
    A = adjacency(3, i, j, np.array([1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(A.toarray(), [[0, 5, 0], [0, 0, 0], [0, 2, 0]])
    assert A.indices.dtype == np.int32
