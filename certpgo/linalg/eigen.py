"""Smallest eigenpairs of a positive semidefinite matrix, by shift-and-invert on a factorization.

The smallest eigenvalues of a connection Laplacian are a cluster of d; a block method finds the
cluster at once, and a solve with d right-hand sides costs little more than one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from certpgo.errors import NumericalError
from certpgo.linalg.arrays import CSC, FloatArray

#: Rounding of the projected inverse over its norm times eps; up to 2 in cycles and planar graphs.
ROUNDING = 16.0


@dataclass(frozen=True, eq=False)
class Eigenpairs:
    """Smallest eigenvalues and their eigenvectors.

    Attributes
    ----------
    values : (k,) ascending Rayleigh quotients
    vectors : (N, k) orthonormal columns
    residuals : (k,) norms of A v - lambda v
    lower : (k,) the values minus their error bounds
    solves : number of right-hand sides
    """

    values: FloatArray
    vectors: FloatArray
    residuals: FloatArray
    lower: FloatArray
    solves: int


@dataclass(frozen=True, eq=False)
class Space:
    """The largest Ritz pairs of an inverse: rough smallest eigenvectors.

    Attributes
    ----------
    values : (k,) of the inverse, descending
    vectors : (N, k) orthonormal columns, up to rounding
    residuals : (k,) of the inverse
    solves : number of right-hand sides
    """

    values: FloatArray
    vectors: FloatArray
    residuals: FloatArray
    solves: int


Solve = Callable[[FloatArray], FloatArray]


class Symmetric(Protocol):
    """A symmetric matrix, known by its shape and its products with blocks (N, b)."""

    @property
    def shape(self) -> tuple[int, int]:
        """(N, N)."""
        ...

    def __matmul__(self, B: FloatArray, /) -> FloatArray:
        """The product with B."""
        ...


def krylov_schur(
    A: CSC | Symmetric,
    solve: Solve,
    k: int,
    *,
    shift: float = 0.0,
    start: FloatArray | None = None,
    tol: float = 1e-9,
    max_basis: int = 30,
    max_solves: int = 3000,
) -> Eigenpairs:
    """Smallest eigenpairs by the block Krylov-Schur method with thick restart.

    Stewart, "A Krylov-Schur algorithm for large eigenproblems" (2001), in its symmetric form; the
    method the thesis names in section 4.6.

    Parameters
    ----------
    A : (N, N) symmetric positive definite
    solve : B -> A^-1 B for blocks (N, b)
    k : number of pairs
    shift : what was added to the diagonal to make A definite; subtracted from the values
    start : (N, b) starting block, b >= 1; random (fixed seed) with b = k by default
    tol : a pair has converged when its residual for the inverse is below tol times its eigenvalue
    max_basis : columns of the basis at which to restart, at least 2 k + 3 b

    Raises
    ------
    NumericalError
        No convergence within ``max_solves`` right-hand sides.
    """
    space = smallest_space(
        A.shape[0], solve, k, start=start, tol=tol, max_basis=max_basis, max_solves=max_solves
    )
    pairs = _pairs(A, space.vectors, shift, space.solves)
    # An eigenvalue of the inverse lies within the residual of theta, up to rounding of H relative
    # to its norm theta_1, which is large for the other thetas if A is nearly singular. Residuals
    # of A are not affected. Both bounds hold, and the better one is used.
    error = space.residuals + ROUNDING * np.finfo(float).eps * space.values[0]
    return replace(pairs, lower=np.maximum(pairs.lower, 1.0 / (space.values + error) - shift))


def smallest_space(
    N: int,
    solve: Solve,
    k: int,
    *,
    start: FloatArray | None = None,
    tol: float = 1e-9,
    max_basis: int = 30,
    max_solves: int = 3000,
) -> Space:
    """The iteration of `krylov_schur` alone, with its parameters and errors, for N x N matrices."""
    if start is None:
        start = np.random.default_rng(0).random((N, k)) - 0.5
    b = min(start.shape[1], N)
    width = min(N, max(max_basis, 2 * k + 3 * b))
    V = np.empty((width, N))  # the basis, in rows for contiguous products
    H = np.zeros((width, width))
    block = np.linalg.qr(start[:, :b])[0].T
    size, solves = 0, 0
    while True:
        new = slice(size, size + len(block))
        V[new] = block
        size = new.stop
        W = solve(block.T).T
        solves += len(block)
        H[:size, new], basis, coupling = _next_block(W, V[:size])
        H[new, :size] = H[:size, new].T
        theta, Y = np.linalg.eigh(H[:size, :size])
        theta, Y = theta[::-1], Y[:, ::-1]
        residual = np.linalg.norm(coupling @ Y[new, :k], axis=0)
        if size == N or (size >= k and np.all(residual <= tol * theta[:k])):
            break
        if solves >= max_solves:
            raise NumericalError(f"no {k} smallest eigenpairs within {solves} solves")
        block = basis[:, : N - size].T
        if size + len(block) > width:
            kept = min(k + b, size - 1)
            V[:kept] = Y[:, :kept].T @ V[:size]
            H[:] = 0.0
            H[np.arange(kept), np.arange(kept)] = theta[:kept]
            size = kept
    return Space(theta[:k], (Y[:, :k].T @ V[:size]).T, residual, solves)


def arpack(A: CSC, solve: Solve, k: int, *, shift: float = 0.0, tol: float = 1e-9) -> Eigenpairs:
    """Smallest eigenpairs by ARPACK in shift-and-invert mode, one vector at a time.

    Parameters as `krylov_schur`. Not a block method: it may miss copies of a multiple eigenvalue,
    which the connection Laplacian has if d = 2 or all rotations share an axis.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    N = A.shape[0]
    solves = 0

    def counted(x: FloatArray) -> FloatArray:
        nonlocal solves
        solves += 1
        return solve(x)

    inverse = LinearOperator((N, N), matvec=counted, dtype=np.float64)
    v0 = np.random.default_rng(0).standard_normal(N)
    _, vectors = eigsh(A, k, sigma=0.0, OPinv=inverse, v0=v0, tol=tol)
    return _pairs(A, vectors, shift, solves)


def _next_block(W: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients h, orthonormal Q and R with W^T = V^T h + Q R and V Q = 0.

    Norms of rows of W may differ by the condition number, so that after projection a small one is
    not orthogonal to V; the projection is repeated on Q until it changes little.
    """
    h = V @ W.T
    Q, R = np.linalg.qr((W - h.T @ V).T)
    for _ in range(4):
        c = V @ Q
        if np.abs(c).max() < 1e-12:
            break
        h += c @ R
        Q, S = np.linalg.qr(Q - V.T @ c)
        R = S @ R
        if np.all(np.abs(np.diag(S)) > 0.7):
            break
    return h, Q, R


def _pairs(A: CSC | Symmetric, X: FloatArray, shift: float, solves: int) -> Eigenpairs:
    """Rayleigh-Ritz on the nearly orthonormal columns of X, for accurate eigenvalues of A."""
    AX = A @ X
    values, Y = np.linalg.eigh(X.T @ AX)
    X, AX = X @ Y, AX @ Y
    residuals = np.linalg.norm(AX - X * values, axis=0)
    defect = np.linalg.norm(X.T @ X - np.eye(len(values)))
    lower = values * (1.0 - defect) - residuals - shift
    return Eigenpairs(values - shift, X, residuals, lower, solves)
