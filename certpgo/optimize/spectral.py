"""Rotations from eigenvectors: the spectral relaxation, its rounding and its bound."""

from __future__ import annotations

import functools

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, pinned
from certpgo.linalg.eigen import Eigenpairs, arpack, krylov_schur, smallest_space
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import SHIFTS, Reduced, factor_shifted


def smallest_eigenpairs(
    problem: Quadratic,
    k: int | None = None,
    *,
    tol: float = 1e-5,
    method: str = "krylov_schur",
    start: Estimate | None = None,
    shift: float | None = None,
) -> Eigenpairs:
    """The k (by default d) smallest eigenpairs of the connection Laplacian; thesis section 4.2.

    Parameters
    ----------
    tol : relative accuracy of the pairs, as residual of the inverse
    method : ``"krylov_schur"`` or ``"arpack"``
    start : an estimate whose rotations span the first block of the former; by default random
    shift : added to the diagonal, by default just enough to factorize; for more than d pairs of
        nearly perfect measurements, use a small fraction of the larger eigenvalues, which would
        otherwise drown in the rounding of the inverse

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    k = min(k or problem.d, problem.d * problem.n)
    build = functools.partial(operators.connection_laplacian, problem.pattern, problem.graph)
    mean = float(problem.node_weights.mean())
    unit, shifts = (mean, SHIFTS) if shift is None else (shift, (1.0,))
    A, shift, factor = factor_shifted(problem, build, unit, shifts)
    if method == "arpack":
        return arpack(A, factor.solve, k, shift=shift, tol=tol)
    return krylov_schur(A, factor.solve, k, shift=shift, tol=tol, start=_block(start))


def deflated_eigenpairs(
    problem: Quadratic,
    A: CSC,
    null: FloatArray,
    k: int,
    *,
    start: FloatArray | None = None,
    tol: float = 1e-8,
) -> Eigenpairs:
    """The k smallest eigenpairs, without the zero, of a semidefinite n x n matrix.

    Parameters
    ----------
    A : with the graph's pattern, such as the graph Laplacian
    null : (n,) its null vector, such as ones
    k : at most n - 1
    start : (n, b) first block of the iteration; by default random
    tol : relative accuracy, as residual of the inverse

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    mean = float(A.diagonal().mean())
    build = functools.partial(add_to_diagonal, A)
    shifted, shift, factor = factor_shifted(problem, build, mean)
    unit = null[:, None] / np.linalg.norm(null)
    solve = factor.solve

    def deflated(B: FloatArray) -> FloatArray:
        X = solve(B - unit @ (unit.T @ B))
        return np.asarray(X - unit @ (unit.T @ X))

    if start is None:
        start = np.random.default_rng(0).standard_normal((problem.n, k + 1))
    start = start - unit @ (unit.T @ start)
    start = start[:, : problem.n - 1]
    return krylov_schur(shifted, deflated, k, shift=shift, start=start, tol=tol)


def eliminated_eigenpairs(
    problem: Quadratic,
    *,
    tol: float = 1e-3,
    start: Estimate | None = None,
) -> Eigenpairs:
    """The d smallest eigenpairs of the data matrix Q with the translations eliminated.

    As in spectral initialization (Doherty, Rosen, Leonard, ICRA 2022); see `Reduced`.

    Parameters
    ----------
    start : an estimate whose rotations span the first block; by default random

    Returns
    -------
    Vectors have the rows of poses, not of points.

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    Q, begin = Reduced(problem), None if start is None else start.subset(problem.poses)
    return krylov_schur(Q, Q.solve, problem.d, shift=Q.shift, tol=tol, start=_block(begin))


def rough_start(problem: Quadratic, *, tol: float, start: Estimate) -> Estimate:
    """The estimate of the smallest eigenvectors of Q, or of L for rotations, to a few digits.

    In single precision, and without the eigenvalues. Parameters and errors as
    `eliminated_eigenpairs`.
    """
    Q, begin = Reduced(problem, rough=True), _block(start.subset(problem.poses))
    space = smallest_space(Q.shape[0], Q.solve, problem.d, tol=tol, start=begin)
    return problem.complete(round_to_rotations(space.vectors, problem.d))


def _block(estimate: Estimate | None) -> FloatArray | None:
    """X^T = [R_1 ... R_n]^T, (dn, d)."""
    if estimate is None:
        return None
    return np.swapaxes(estimate.rotations, 1, 2).reshape(-1, estimate.d)


def spectral_bound(problem: Quadratic, pairs: Eigenpairs) -> float:
    """A bound n (lambda_1 + ... + lambda_d) <= F*, from computed eigenvalues; after thesis eq. 4.7.

    The pairs are those of the connection Laplacian, or for poses those of Q, whose bound is
    tighter. Computed eigenvalues lie above the true ones: their error and rounding are subtracted.
    """
    rounding = 64.0 * np.finfo(float).eps * float(problem.matrix.diagonal().max())
    d = problem.d
    return float(len(problem.poses) * np.maximum(pairs.lower[:d] - rounding, 0.0).sum())


def round_to_rotations(V: FloatArray, d: int) -> FloatArray:
    """Rotations (n, d, d) nearest to the blocks of eigenvectors V (dn, d).

    The columns of X^T = [R_1 ... R_n]^T lie near the span of V, which is determined only up to a
    common reflection: the one with more positive determinants is used.
    """
    blocks = np.swapaxes(V.reshape(-1, d, d), 1, 2)
    if so.is_mostly_reflected(blocks):
        blocks = blocks * np.r_[-np.ones(1), np.ones(d - 1)][:, None]
    return so.project(blocks)


def round_anchored(V: FloatArray, d: int) -> FloatArray:
    """Rotations from V V_1^-1, so that the first is the identity; thesis Appendix B.6.

    If the eigenvalues differ, the columns of V V_1^-1 are not eigenvectors, and the result depends
    on the anchor.
    """
    blocks = V.reshape(-1, d, d)
    return so.project(np.swapaxes(blocks @ np.linalg.inv(blocks[0]), 1, 2))


def solve_anchored(problem: Quadratic) -> FloatArray:
    """Rotations from L_2 X = -L_1 with the first fixed at the identity; thesis Appendix B.6.

    The chordal relaxation of Martinec and Pajdla, solved by one factorization.

    Raises
    ------
    NumericalError
        The reduced matrix could not be factorized.
    """
    d, n = problem.d, problem.n
    L = problem.matrix
    first = np.arange(d)
    reduced = pinned(L, first)
    factor = problem.symbolic(reduced).factor(reduced)
    if factor is None:
        raise NumericalError("the anchored connection Laplacian is not positive definite")
    right = -L[:, first].toarray()
    right[first] = 0.0
    X = factor.solve(right)
    X[first] = np.eye(d)
    return so.project(np.swapaxes(X.reshape(n, d, d), 1, 2))


def spectral_start(
    problem: Quadratic, *, tol: float = 1e-5, start: Estimate | None = None
) -> Estimate:
    """EigenRA's rotations, with the optimal translations if the problem has any.

    Parameters and errors as `smallest_eigenpairs`.
    """
    pairs = smallest_eigenpairs(problem.rotation, tol=tol, start=start)
    return problem.complete(round_to_rotations(pairs.vectors, problem.d))
