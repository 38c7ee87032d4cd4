"""Propositions 3.2.1 to 3.2.5 of the thesis as laws, over invertible matrices M_i of GL_m.

M_B = M_C M_C^-b has the blocks M_i M_j^-1; over a graph, A = (L_G x 1) o M_B keeps those of its
edges and of the diagonal. Both have n m rows: where the thesis prints n - m for the multiplicity of
0 in 3.2.3 and for the rank in 3.2.5, n m - m and m (n - 1) are right.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import dimensions, random_edges, rng_of, rotation_graph, seeds

from certpgo.objective.quadratic import Quadratic

#: Rounding, relative to the scale named where it is used.
ROUNDING = 1e-9

sizes = st.integers(2, 7)
orders = st.integers(1, 4)


def invertible(rng, n, m):
    """(n, m, m) matrices with singular values of 1/2 to 2, of either determinant."""
    U, V = np.linalg.qr(rng.standard_normal((2, n, m, m)))[0]
    return (U * rng.uniform(0.5, 2.0, (n, 1, m))) @ V


def complete(M):
    """M_B, (nm, nm)."""
    n, m = M.shape[:2]
    return M.reshape(n * m, m) @ np.concatenate(list(np.linalg.inv(M)), axis=1)


def laplacian(rng, n):
    """Of a random simple connected graph; weights like the thesis', 1."""
    i, j = random_edges(rng, n, n).T
    A = np.zeros((n, n))
    A[i, j] = A[j, i] = 1.0
    return np.diag(A.sum(axis=1)) - A


def masked(L, M):
    """(L x 1) o M_B."""
    return np.kron(L, np.ones(M.shape[1:])) * complete(M)


@given(seeds, sizes, orders, st.integers(0, 4))
def test_3_2_1_powers_and_krylov_spaces(seed, n, m, p):
    rng = rng_of(seed)
    B = complete(invertible(rng, n, m))
    scale = n**p * np.abs(B).max()
    power = np.linalg.matrix_power(B, p + 1)
    np.testing.assert_allclose(power, n**p * B, rtol=0, atol=ROUNDING * scale)
    b = rng.standard_normal(n * m)
    krylov = np.stack([np.linalg.matrix_power(B / n, r) @ b for r in range(5)], axis=1)
    assert np.linalg.matrix_rank(krylov, tol=ROUNDING * np.abs(krylov).max()) <= 2


@given(seeds, sizes, orders)
def test_3_2_2_the_column_space_is_the_eigenspace_of_n(seed, n, m):
    rng = rng_of(seed)
    B = complete(invertible(rng, n, m))
    v = B @ rng.standard_normal(n * m)
    np.testing.assert_allclose(B @ v, n * v, rtol=0, atol=ROUNDING * n * np.abs(v).max())


@given(seeds, sizes, orders)
def test_3_2_3_eigenvalues_are_n_and_zero(seed, n, m):
    B = complete(invertible(rng_of(seed), n, m))
    values = np.linalg.eigvals(B)
    large = np.abs(values - n) < 1e-6 * n
    assert large.sum() == m
    assert np.abs(values[~large]).max() < 1e-6 * n
    assert (~large).sum() == n * m - m  # printed: n - m
    assert np.linalg.matrix_rank(B, tol=ROUNDING * np.linalg.norm(B, 2)) == m


@given(seeds, sizes, orders)
def test_3_2_4_eigenpairs_of_the_graph_carry_over(seed, n, m):
    rng = rng_of(seed)
    M, L = invertible(rng, n, m), laplacian(rng, n)
    A = masked(L, M)
    values, vectors = np.linalg.eigh(L)
    scale = np.linalg.norm(A, 2)
    for value, v in zip(values, vectors.T, strict=True):
        V = (v[:, None, None] * M).reshape(n * m, m)
        np.testing.assert_allclose(A @ V, value * V, rtol=0, atol=ROUNDING * scale)
        assert np.linalg.matrix_rank(V, tol=ROUNDING) == m
        copies = int((np.abs(values - value) < 1e-6).sum())
        gap = np.linalg.svd(A - value * np.eye(n * m), compute_uv=False)
        assert (gap < 1e-7 * scale).sum() == m * copies
    found = np.sort_complex(np.linalg.eigvals(A))
    np.testing.assert_allclose(found, np.repeat(values, m), rtol=0, atol=1e-6 * scale)


@given(seeds, sizes, orders)
def test_3_2_5_rank_and_invariance_of_the_column_space(seed, n, m):
    rng = rng_of(seed)
    M = invertible(rng, n, m)
    A = masked(laplacian(rng, n), M)
    U, s, _ = np.linalg.svd(A)
    rank = int((s > ROUNDING * s[0]).sum())
    assert rank == m * (n - 1)  # printed: n - m
    moved = A @ U[:, :rank]
    inside = U[:, :rank] @ (U[:, :rank].T @ moved)
    np.testing.assert_allclose(moved, inside, rtol=0, atol=ROUNDING * s[0])
    # The truth itself is what the matrix takes to zero.
    np.testing.assert_allclose(A @ M.reshape(n * m, m), 0.0, rtol=0, atol=ROUNDING * s[0])


@given(seeds, sizes, orders)
def test_3_2_5_takes_a_connected_graph(seed, n, m):
    rng = rng_of(seed)
    L = np.zeros((2 * n, 2 * n))
    L[:n, :n], L[n:, n:] = laplacian(rng, n), laplacian(rng, n)
    A = masked(L, invertible(rng, 2 * n, m))
    rank = np.linalg.matrix_rank(A, tol=ROUNDING * np.linalg.norm(A, 2))
    assert rank == m * (2 * n - 2)


@given(seeds, dimensions)
def test_the_connection_laplacian_of_exact_rotations_is_such_a_matrix(seed, d):
    graph, R = rotation_graph(rng_of(seed), 6, d, noise=0.0)
    problem = Quadratic(graph)
    # Our R_i is the thesis' R_i^T.
    A = masked(problem.laplacian.toarray(), np.swapaxes(R, 1, 2))
    L = problem.matrix.toarray()
    np.testing.assert_allclose(L, A, rtol=0, atol=1e-12 * graph.kappa.sum())


@given(seeds, st.integers(2, 12), st.sampled_from([1e-6, 0.1, 10.0]))
def test_weyl_s_inequality_and_the_norms_above_it(seed, n, size):
    rng = rng_of(seed)
    H, P = (X + np.swapaxes(X, 0, 1) for X in rng.standard_normal((2, n, n)))
    P *= size
    moved = np.abs(np.linalg.eigvalsh(H + P) - np.linalg.eigvalsh(H)).max()
    rounding = 1e-13 * (np.linalg.norm(H, 2) + np.linalg.norm(P, 2))
    assert moved <= np.linalg.norm(P, 2) + rounding
    assert np.linalg.norm(P, 2) <= np.linalg.norm(P, np.inf) + rounding


def test_weyl_s_inequality_is_sharp():
    H = np.diag([1.0, 2.0, 3.0])
    moved = np.linalg.eigvalsh(H + 0.25 * np.eye(3)) - np.linalg.eigvalsh(H)
    assert moved == pytest.approx([0.25] * 3, abs=1e-15)
