"""Smallest eigenpairs of a positive semidefinite matrix, by shift-and-invert on a factorization.

The wanted eigenvalues of a connection Laplacian are a cluster of d, nearly equal; a block method
finds the cluster at once, and a solve with d right-hand sides costs little more than one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from certpgo.errors import NumericalError
from certpgo.linalg.arrays import CSC, FloatArray


@dataclass(frozen=True, eq=False)
class Eigenpairs:
    """Smallest eigenvalues and their eigenvectors.

    Attributes
    ----------
    values : (k,) ascending Rayleigh quotients
    vectors : (N, k) orthonormal columns
    residuals : (k,) norms of A v - lambda v
    solves : right-hand sides solved for
    """

    values: FloatArray
    vectors: FloatArray
    residuals: FloatArray
    solves: int


Solve = Callable[[FloatArray], FloatArray]


def krylov_schur(
    A: CSC,
    solve: Solve,
    k: int,
    *,
    start: FloatArray | None = None,
    tol: float = 1e-9,
    max_basis: int | None = None,
    max_solves: int = 3000,
) -> Eigenpairs:
    """Smallest eigenpairs by the block Krylov-Schur method with thick restart.

    Stewart, "A Krylov-Schur algorithm for large eigenproblems" (2001), in its symmetric form; the
    method the thesis names in section 4.6.

    Parameters
    ----------
    A : (N, N) symmetric positive semidefinite
    solve : B -> (A + shift I)^-1 B for blocks (N, b) and some small shift >= 0
    k : how many pairs
    start : (N, b) starting block, b >= 1; random (fixed seed) with b = k by default
    tol : a pair has converged when its residual for the inverse is below tol times its eigenvalue
    max_basis : columns of the basis before a restart, at least 4 b by default

    Raises
    ------
    NumericalError
        No convergence within ``max_solves`` right-hand sides.
    """
    N = A.shape[0]
    if start is None:
        start = np.random.default_rng(0).standard_normal((N, k))
    b = min(start.shape[1], N)
    width = min(N, max(max_basis or 0, 6 * b + k, 20))
    V = np.empty((N, width))
    H = np.zeros((width, width))
    block = np.linalg.qr(start[:, :b])[0]
    size, solves = 0, 0
    while True:
        new = slice(size, size + block.shape[1])
        V[:, new] = block
        size = new.stop
        W = solve(block)
        solves += block.shape[1]
        H[:size, new], W = _orthogonalize(W, V[:, :size])
        H[new, :size] = H[:size, new].T
        theta, Y = np.linalg.eigh(H[:size, :size])
        theta, Y = theta[::-1], Y[:, ::-1]
        block, coupling = np.linalg.qr(W)
        residual = np.linalg.norm(coupling @ Y[new, :k], axis=0)
        wanted = min(k, size)
        if wanted == k and np.all(residual <= tol * theta[:k]):
            break
        if size == N:
            break
        if solves >= max_solves:
            raise NumericalError(f"no {k} smallest eigenpairs within {solves} solves")
        block = block[:, : N - size]
        if size + block.shape[1] > width:
            kept = min(k + b, size - 1)
            V[:, :kept] = V[:, :size] @ Y[:, :kept]
            H[:] = 0.0
            H[np.arange(kept), np.arange(kept)] = theta[:kept]
            size = kept
    return _pairs(A, V[:, :size] @ Y[:, :k], solves)


def arpack(A: CSC, solve: Solve, k: int, *, shift: float, tol: float = 1e-9) -> Eigenpairs:
    """Smallest eigenpairs by ARPACK in shift-and-invert mode, one vector a time.

    ``solve`` inverts A + shift I. Beside `krylov_schur` for comparison, and slower than it.
    """
    N = A.shape[0]
    solves = 0

    def counted(x: FloatArray) -> FloatArray:
        nonlocal solves
        solves += 1
        return solve(x)

    inverse = LinearOperator((N, N), matvec=counted, dtype=np.float64)
    v0 = np.random.default_rng(0).standard_normal(N)
    _, vectors = eigsh(A, k, sigma=-shift, OPinv=inverse, v0=v0, tol=tol)
    return _pairs(A, vectors, solves)


def _orthogonalize(W: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of W along the columns of V, and what is left; twice is enough."""
    first = V.T @ W
    W = W - V @ first
    second = V.T @ W
    return first + second, W - V @ second


def _pairs(A: CSC, X: FloatArray, solves: int) -> Eigenpairs:
    """Rayleigh-Ritz on the columns of X, so that the values are accurate for A itself."""
    X = np.linalg.qr(X)[0]
    AX = A @ X
    values, Y = np.linalg.eigh(X.T @ AX)
    X, AX = X @ Y, AX @ Y
    return Eigenpairs(values, X, np.linalg.norm(AX - X * values, axis=0), solves)
