"""The block column of EIG-SE(3), from eigenvectors or singular vectors.

With w the edges' weights, A the block matrix of w M_ij (and w M_ij^-1 at (j, i)), D the weighted
degrees and c the weight of the identities M_ii, exact measurements have
(D + c I)^-1 (A + c I) M_C = M_C. With noise M_C is taken from the b leading eigenvectors, that is
from those of L v = lambda (D + c I) v, L = D - A, of smallest lambda.

As every block ends in [0 ... 0 1], L is block triangular: L [x; y] = [L_R x - T y; L_G y], y the
last entry of each block, L_R the connection Laplacian, L_G the graph Laplacian and T the measured
translations. So its spectrum is real, and its eigenvectors come from sparse *symmetric*
factorizations: [x; 0] with L_R x = lambda (D + c I) x, which are rotations; [t; 1] of lambda = 0
with L_R t = T 1, the translations; and spurious ones [x; y], y an eigenvector of L_G.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from certpgo.graph.capabilities import require_capable
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, scatter_sum
from certpgo.linalg.cg import conjugate_gradients
from certpgo.linalg.eigen import Eigenpairs, krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import factor_shifted

from ._blocks import block_matrix, block_size, edge_blocks, inverses

#: Difference below which eigenvalues of the normalized matrices, in [0, 2], count as equal.
INDISTINCT = 1e-13
#: Accuracy at which the graph's eigenvalues are first compared with the rotations'.
ROUGH = 1e-2
#: Square root of the shift that makes L^T L definite, over the mean degree.
SHIFT = 1e-7


def leading_eigenvectors(
    problem: Quadratic, weights: FloatArray, loop: float, *, tol: float
) -> FloatArray:
    """(bn, b) unit eigenvectors of the largest eigenvalues of (D + c I)^-1 (A + c I).

    Parameters
    ----------
    weights : (m,) positive w, parallel edges add
    loop : c >= 0
    tol : relative accuracy of the eigenpairs
    """
    require_capable(problem.graph, "isotropic method")
    rotation = problem.rotation
    n, d = problem.n, problem.d
    root = 1.0 / np.sqrt(operators.degrees(rotation.graph.edges, weights, n) + loop)
    roots = np.repeat(root, d)
    graph = rotation.graph.with_weights(weights)
    turns = _normalized(operators.connection_laplacian(rotation.pattern, graph), roots)
    R, factor = _smallest(rotation, turns, d, tol)
    if not problem.has_positions:
        return _unit(roots[:, None] * R.vectors)
    scalars = _normalized(operators.laplacian(rotation.pattern, weights), root)
    # Few eigenvalues first: inside a dense spectrum more converge slowly, if at all.
    G, _ = _smallest(rotation, scalars, 2, ROUGH)
    if G.lower[-1] <= R.values[-1]:
        G, _ = _smallest(rotation, scalars, d + 1, tol)

    def posed(y: FloatArray, value: float) -> FloatArray:
        """[x; y] of an eigenvalue of L_G, from (L_R - lambda (D + c I)) x = T y."""
        x = _resolvent(turns, R, factor, value, roots * _translated(problem, weights, y))
        return _interleaved(roots * x, y)

    # Besides [t; 1], eigenvectors of L_G displace rotations whose eigenvalues noise has increased.
    columns = [posed(np.ones(n), 0.0)]
    for k in np.argsort(np.r_[R.values, G.values[1:]], kind="stable")[:d]:
        if k < d:
            columns.append(_interleaved(roots * R.vectors[:, k], np.zeros(n)))
        else:
            columns.append(posed(root * G.vectors[:, k - d + 1], float(G.values[k - d + 1])))
    return _unit(np.column_stack(columns))


def trailing_singular_vectors(problem: Quadratic, weights: FloatArray, *, tol: float) -> FloatArray:
    """(bn, b) right singular vectors of the smallest singular values of L; thesis eq. 2.19, 2.20.

    From eigenvectors of L^T L + s^2 I, whose inverse is a block of an augmented sparse matrix.
    """
    n, b = problem.n, block_size(problem)
    pairs, forward = edge_blocks(problem)
    degree = operators.degrees(pairs, weights, n)
    w = -weights[:, None, None]
    diagonal = degree[:, None, None] * np.eye(b)
    L = block_matrix(n, pairs, w * forward, w * inverses(forward, problem.d), diagonal)
    s = SHIFT * float(degree.mean())
    eye = s * sparse.eye_array(b * n)
    lu = splu(sparse.block_array([[eye, L], [L.T, -eye]]).tocsc())

    def solve(B: FloatArray) -> FloatArray:
        return np.asarray(lu.solve(np.concatenate([np.zeros_like(B), B / -s]))[b * n :])

    square = CSC(L.T @ L + s * eye)
    return krylov_schur(square, solve, b, shift=s * s, tol=tol).vectors


def _unit(V: FloatArray) -> FloatArray:
    """V with columns of norm 1."""
    return np.asarray(V / np.linalg.norm(V, axis=0))


def _normalized(A: CSC, root: FloatArray) -> CSC:
    """diag(root) A diag(root), with the pattern of A."""
    data = A.data * root[A.indices] * np.repeat(root, np.diff(A.indptr))
    return CSC((data, A.indices, A.indptr), shape=A.shape)


def _smallest(problem: Quadratic, A: CSC, k: int, tol: float) -> tuple[Eigenpairs, Factor]:
    """The k smallest eigenpairs of a normalized matrix, and its shifted factor."""
    shifted, shift, factor = factor_shifted(problem, functools.partial(add_to_diagonal, A), 1.0)
    k = min(k, A.shape[0])
    return krylov_schur(shifted, factor.solve, k, shift=shift, tol=tol), factor


def _resolvent(
    A: CSC, pairs: Eigenpairs, factor: Factor, value: float, b: FloatArray
) -> FloatArray:
    """(A - value I)^-1 b, for a value of at most A's smallest eigenvalues.

    The component of b along their eigenvectors is divided explicitly; on the complement A - value I
    is definite. Along an eigenvector of the value itself, a gauge, the result is zero.
    """
    V, gap = pairs.vectors, pairs.values - value

    def rest(x: FloatArray) -> FloatArray:
        return np.asarray(x - V @ (V.T @ x))

    found = conjugate_gradients(
        lambda x: rest(A @ x - value * x),
        rest(b),
        lambda r: rest(factor.solve(rest(r))),
        tol=1e-13,
        max_iterations=200,
    ).x
    distinct = np.abs(gap) > INDISTINCT
    along = np.where(distinct, V.T @ b, 0.0) / np.where(distinct, gap, 1.0)
    return np.asarray(found + V @ along)


def _translated(problem: Quadratic, weights: FloatArray, y: FloatArray) -> FloatArray:
    """(dn,) T y: the sums of w t_ij y_j at i, and of -w R_ij^T t_ij y_i at j."""
    graph = problem.graph
    i, j = graph.edges.T
    t = weights[:, None] * graph.translations
    back = np.einsum("mba,mb->ma", graph.rotations, t)
    total = scatter_sum(i, t * y[j][:, None], problem.n)
    return np.asarray((total - scatter_sum(j, back * y[i][:, None], problem.n)).ravel())


def _interleaved(x: FloatArray, y: FloatArray) -> FloatArray:
    """(bn,) the vector with blocks [x_i; y_i]."""
    return np.column_stack([x.reshape(len(y), -1), y]).ravel()
