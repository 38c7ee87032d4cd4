"""Block assembly against a loop over the edges."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from strategies import random_edges, rng_of, seeds

from certpgo.linalg.blocks import (
    BlockPattern,
    add_to_diagonal,
    adjacency,
    diagonal_places,
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
    np.testing.assert_array_equal(A.data[diagonal_places(A)], A.diagonal())
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
