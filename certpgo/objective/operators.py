"""The sparse matrices of the papers, from measurements.

Matrices over poses are interleaved, one block of d + 1 rows per pose: the translation row, then the
d rotation rows, so that they multiply X = [t_1 R_1 ... t_n R_n]^T. That is a symmetric permutation
of SE-Sync's [t | R], and one ordering of the graph suits every factorization.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern, scatter_sum


def pattern(graph: RotationGraph | PoseGraph) -> BlockPattern:
    """The sparsity pattern shared by all matrices of the graph."""
    return BlockPattern(graph.num_nodes, graph.edges)


def degrees(edges: IntArray, weights: FloatArray, n: int) -> FloatArray:
    """(n,) weighted node degrees; parallel edges add."""
    return scatter_sum(edges.ravel(), np.repeat(weights, 2), n)


def laplacian(blocks: BlockPattern, weights: FloatArray) -> CSC:
    """Weighted graph Laplacian L_G = D - A, (n, n); Eriksson et al. eq. 2."""
    degree = degrees(blocks.edges, weights, blocks.num_nodes)
    return blocks.assemble(degree[:, None, None], -weights[:, None, None])


def connection_laplacian(blocks: BlockPattern, graph: RotationGraph, shift: float = 0.0) -> CSC:
    """Rotation connection Laplacian L (plus ``shift`` I), (dn, dn).

    L_ii = deg_i I and L_ij = -kappa R_ij: the thesis' (Laplacian x 1) o Rtilde, eq. 4.6; in
    Eriksson et al. blkdiag(deg I) - Rtilde, eq. 9. F(R) = tr(R L R^T).
    """
    degree = degrees(graph.edges, graph.kappa, graph.num_nodes) + shift
    return blocks.assemble(
        degree[:, None, None] * np.eye(graph.d), -graph.kappa[:, None, None] * graph.rotations
    )


def data_matrix(blocks: BlockPattern, graph: PoseGraph) -> CSC:
    """Quadratic form M of the pose objective, F(R, t) = tr(X M X^T), ((d+1)n, (d+1)n).

    Rosen et al. (SE-Sync, IJRR 2019) eq. 20, interleaved.
    """
    n, d, i = graph.num_nodes, graph.d, graph.edges[:, 0]
    tau, t = graph.tau, graph.translations
    kappa = graph.rotation.kappa
    moment = tau[:, None] * t

    diagonal = np.zeros((n, d + 1, d + 1))
    diagonal[:, 0, 0] = degrees(graph.edges, tau, n)
    diagonal[:, 0, 1:] = diagonal[:, 1:, 0] = scatter_sum(i, moment, n)
    spread = scatter_sum(i, moment[:, :, None] * t[:, None, :], n)
    diagonal[:, 1:, 1:] = degrees(graph.edges, kappa, n)[:, None, None] * np.eye(d) + spread

    upper = np.zeros((graph.num_edges, d + 1, d + 1))
    upper[:, 0, 0] = -tau
    upper[:, 1:, 0] = -moment  # rotation of i against translation of j
    upper[:, 1:, 1:] = -kappa[:, None, None] * graph.rotation.rotations
    return blocks.assemble(diagonal, upper)


def multipliers(gradient: FloatArray, R: FloatArray) -> FloatArray:
    """Blocks Lam_i = sym(G_i^T R_i), (n, d, d), of half the Euclidean gradient G in the rotations.

    G_i^T is the block (M X^T)_i; Eriksson et al. eq. 16 is deg_i I - Lam_i.
    """
    product = np.swapaxes(gradient, 1, 2) @ R
    return np.asarray(0.5 * (product + np.swapaxes(product, 1, 2)))


def tangent_gradient(gradient: FloatArray, R: FloatArray) -> FloatArray:
    """(n, p) Riemannian gradient of F/2 over body-frame tangents, from the Euclidean half."""
    return 2.0 * so.vee(np.swapaxes(R, 1, 2) @ gradient)


def rotation_hessian(
    graph: RotationGraph, R: FloatArray, multipliers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Blocks of the exact Riemannian Hessian of F/2 over body-frame tangents.

    For tangents R_i hat(w_i) it is the restriction of S = L - blkdiag(Lam), so a step solves
    H w = -gradient/2.

    Parameters
    ----------
    R : (n, d, d) rotations
    multipliers : (n, d, d) the blocks Lam_i there

    Returns
    -------
    (n, p, p) diagonal blocks and (m, p, p) blocks of edges (i, j), p = d (d - 1) / 2
    """
    d = graph.d
    i, j = graph.edges.T
    degree = degrees(graph.edges, graph.kappa, graph.num_nodes)
    S = degree[:, None, None] * np.eye(d) - multipliers
    between = np.swapaxes(R[j], 1, 2) @ R[i]
    coupling = _tangent_coupling(graph.rotations, between)
    return tangent_restriction(S), -graph.kappa[:, None, None] * coupling


def pose_hessian(
    graph: PoseGraph, R: FloatArray, multipliers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Blocks of the exact Riemannian Hessian of F/2 over (t_i, w_i), translations first.

    The tangent restriction of M - blkdiag(0, Lam); see `rotation_hessian`. Blocks are
    (d + p, d + p).
    """
    d, n = graph.d, graph.num_nodes
    p = so.tangent_dim(d)
    i = graph.edges[:, 0]
    tau, t = graph.tau, graph.translations
    rotation_diagonal, rotation_upper = rotation_hessian(graph.rotation, R, multipliers)
    # The residual t_j - t_i - R_i t_ij moves by dt_j - dt_i + R_i lever(t_ij) w_i.
    moment = scatter_sum(i, tau[:, None] * t, n)
    spread = scatter_sum(i, (tau[:, None] * t)[:, :, None] * t[:, None, :], n)

    diagonal = np.zeros((n, d + p, d + p))
    diagonal[:, :d, :d] = degrees(graph.edges, tau, n)[:, None, None] * np.eye(d)
    diagonal[:, :d, d:] = -R @ _lever(moment)
    diagonal[:, d:, :d] = np.swapaxes(diagonal[:, :d, d:], 1, 2)
    diagonal[:, d:, d:] = rotation_diagonal + tangent_restriction(spread)

    upper = np.zeros((graph.num_edges, d + p, d + p))
    upper[:, np.arange(d), np.arange(d)] = -tau[:, None]
    upper[:, d:, :d] = np.swapaxes(R[i] @ _lever(tau[:, None] * t), 1, 2)
    upper[:, d:, d:] = rotation_upper
    return diagonal, upper


def lifted_hessian(
    graph: RotationGraph | PoseGraph, basis: FloatArray, multipliers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Blocks of the exact Hessian of F/2 at a point of rank r, over tangents sum_k w_k B_ik.

    The restriction of M - blkdiag(0, Lam) in each of the r dimensions; with zero multipliers, the
    Gauss-Newton matrix. At rank d and with B_ik = R_i hat(e_k) it is `pose_hessian`.

    Parameters
    ----------
    basis : (n, q, r, d) of the tangent space of the blocks Y_i
    multipliers : (n, d, d) the blocks Lam_i there

    Returns
    -------
    (n, b, b) diagonal blocks and (m, b, b) blocks of edges (i, j); b = r + q for poses, over
    translations first, and b = q for rotations
    """
    rotation = graph.rotation if isinstance(graph, PoseGraph) else graph
    n, q, r, d = basis.shape
    i, j = graph.edges.T
    spread = degrees(graph.edges, rotation.kappa, n)[:, None, None] * np.eye(d) - multipliers
    carried = (basis[i] @ rotation.rotations[:, None]).reshape(-1, q, r * d)
    there = np.swapaxes(basis[j].reshape(-1, q, r * d), 1, 2)
    coupling = -rotation.kappa[:, None, None] * (carried @ there)
    flat = basis.reshape(n, q, r * d)
    if not isinstance(graph, PoseGraph):
        return (basis @ spread[:, None]).reshape(n, q, r * d) @ np.swapaxes(flat, 1, 2), coupling
    tau, t = graph.tau, graph.translations
    moment = scatter_sum(i, tau[:, None] * t, n)
    spread = spread + scatter_sum(i, (tau[:, None] * t)[:, :, None] * t[:, None, :], n)

    diagonal = np.zeros((n, r + q, r + q))
    diagonal[:, :r, :r] = degrees(graph.edges, tau, n)[:, None, None] * np.eye(r)
    diagonal[:, r:, :r] = (basis @ moment[:, None, :, None])[..., 0]
    diagonal[:, :r, r:] = np.swapaxes(diagonal[:, r:, :r], 1, 2)
    turned = (basis @ spread[:, None]).reshape(n, q, r * d)
    diagonal[:, r:, r:] = turned @ np.swapaxes(flat, 1, 2)

    upper = np.zeros((graph.num_edges, r + q, r + q))
    upper[:, np.arange(r), np.arange(r)] = -tau[:, None]
    upper[:, r:, :r] = -(basis[i] @ (tau[:, None] * t)[:, None, :, None])[..., 0]
    upper[:, r:, r:] = coupling
    return diagonal, upper


def tangent_restriction(S: FloatArray) -> FloatArray:
    """The form (v, w) -> tr(hat(v) hat(w)^T S) of S (..., d, d), as (..., p, p)."""
    trace = np.trace(S, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(trace if S.shape[-1] == 2 else trace * np.eye(3) - S)


def _lever(t: FloatArray) -> FloatArray:
    """(m, d, p) matrices with lever(t) w = -hat(w) t."""
    if t.shape[-1] == 2:
        return np.stack([t[:, 1], -t[:, 0]], axis=1)[:, :, None]
    return so.hat(t)


def _tangent_coupling(A: FloatArray, B: FloatArray) -> FloatArray:
    """(m, p, p) forms (v, w) -> tr(hat(v) A hat(w)^T B) for rotations A.

    A hat(w)^T = hat(A w)^T A reduces them to `tangent_restriction`.
    """
    form = tangent_restriction(A @ B)
    return form if A.shape[-1] == 2 else np.asarray(form @ A)
