"""The sparse matrices of the papers, from measurements.

Matrices over poses are interleaved, one block of d + 1 rows per pose: the translation row, then the
d rotation rows, so that they multiply X = [t_1 R_1 ... t_n R_n]^T. That is a symmetric permutation
of SE-Sync's [t | R], and one ordering of the graph suits every factorization. A point has only the
first row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import symmetric
from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern, scatter_sum


def pattern(graph: Graph) -> BlockPattern:
    """The sparsity pattern shared by all matrices of the graph."""
    points = graph.is_point if graph.is_point.any() else None
    return BlockPattern(graph.num_nodes, graph.edges, points)


def degrees(edges: IntArray, weights: FloatArray, n: int) -> FloatArray:
    """(n,) weighted node degrees; parallel edges add."""
    return scatter_sum(edges.ravel(), np.repeat(weights, 2), n)


def laplacian(blocks: BlockPattern, weights: FloatArray) -> CSC:
    """Weighted graph Laplacian L_G = D - A, (n, n); Eriksson et al. eq. 2."""
    degree = degrees(blocks.edges, weights, blocks.num_nodes)
    return blocks.assemble(degree[:, None, None], -weights[:, None, None])


def spread(graph: Graph) -> FloatArray:
    """(n, d, d) sums at each node of the edges' weights: deg I, or the polar factors."""
    n, d = graph.num_nodes, graph.d
    if not graph.has_couplings:
        return np.asarray(degrees(graph.edges, graph.kappa, n)[:, None, None] * np.eye(d))
    i, j = graph.edges.T
    _, K, K_left = graph.polar
    return scatter_sum(i, K_left, n) + scatter_sum(j, K, n)


def moments(graph: Graph) -> tuple[FloatArray, FloatArray]:
    """(n, d) and (n, d, d) first and second moments, weighted by tau, of the arms at each node."""
    n, (i, j) = graph.num_nodes, graph.edges.T
    b, a = graph.translations, graph.arms
    at_i = graph.tau[:, None] * b
    first = scatter_sum(i, at_i, n)
    second = scatter_sum(i, at_i[:, :, None] * b[:, None, :], n)
    if a is not None:
        at_j = graph.tau[:, None] * a
        first += scatter_sum(j, at_j, n)
        second += scatter_sum(j, at_j[:, :, None] * a[:, None, :], n)
    return first, second


def connection_laplacian(blocks: BlockPattern, graph: Graph, shift: float = 0.0) -> CSC:
    """Rotation connection Laplacian L (plus ``shift`` I), (dn, dn).

    L_ii = deg_i I and L_ij = -kappa R_ij: the thesis' (Laplacian x 1) o Rtilde, eq. 4.6; in
    Eriksson et al. blkdiag(deg I) - Rtilde, eq. 9. F(R) = tr(R L R^T). Of general edges, the
    polar factors and -N.
    """
    return blocks.assemble(spread(graph) + shift * np.eye(graph.d), -graph.coupled)


def data_matrix(blocks: BlockPattern, graph: Graph, sums: NodeSums) -> CSC:
    """Quadratic form M of the pose objective, F(R, t) = tr(X M X^T), (N, N).

    Rosen et al. (SE-Sync, IJRR 2019) eq. 20, interleaved; ``sums`` are those of the graph.
    """
    n, d, tau = graph.num_nodes, graph.d, graph.tau
    diagonal = np.zeros((n, d + 1, d + 1))
    diagonal[:, 0, 0] = sums.degree
    diagonal[:, 0, 1:] = diagonal[:, 1:, 0] = sums.first
    diagonal[:, 1:, 1:] = sums.spread

    upper = np.zeros((graph.num_edges, d + 1, d + 1))
    upper[:, 0, 0] = -tau
    # Rotation of i against translation of j.
    upper[:, 1:, 0] = -tau[:, None] * graph.translations
    upper[:, 1:, 1:] = -graph.coupled
    if graph.arms is not None:
        upper[:, 0, 1:] = -tau[:, None] * graph.arms
        upper[:, 1:, 1:] += upper[:, 1:, :1] * graph.arms[:, None, :]
    return blocks.assemble(diagonal, upper, 1)


def levers(graph: Graph) -> list[FloatArray]:
    """(m,) values tau |t_ij|^2, and tau |a|^2 if there are arms."""
    arms = (graph.translations, *(() if graph.arms is None else (graph.arms,)))
    return [graph.tau * np.einsum("ma,ma->m", arm, arm) for arm in arms]


def rotation_residuals(graph: Graph, R: FloatArray) -> FloatArray:
    """(m, r, d) matrices R_j - R_i R_ij, for rotations (n, r, d); R_j - R_i P if N = P K."""
    i, j = graph.edges.T
    measured = graph.polar[0] if graph.has_couplings else graph.rotations
    return np.asarray(R[j] - R[i] @ measured)


def steps(graph: Graph, point: Point) -> FloatArray:
    """(m, r) vectors R_i t_ij, minus R_j a where an edge has an arm a."""
    i, j = graph.edges.T
    R = point.rotations
    steps = (R[i] @ graph.translations[:, :, None])[:, :, 0]
    if graph.arms is not None:
        steps = steps - (R[j] @ graph.arms[:, :, None])[:, :, 0]
    return np.asarray(steps)


def translation_residuals(graph: Graph, point: Point) -> FloatArray:
    """(m, r) vectors t_j - t_i - R_i t_ij, plus R_j a where an edge has an arm a."""
    i, j = graph.edges.T
    t = translations_of(point)
    return np.asarray(t[j] - t[i] - steps(graph, point))


def multipliers(gradient: FloatArray, R: FloatArray) -> FloatArray:
    """Blocks Lam_i = sym(G_i^T R_i), (n, d, d), of half the Euclidean gradient G in the rotations.

    G_i^T is the block (M X^T)_i; Eriksson et al. eq. 16 is deg_i I - Lam_i.
    """
    return symmetric(np.swapaxes(gradient, 1, 2) @ R)


def tangent_gradient(gradient: FloatArray, R: FloatArray) -> FloatArray:
    """(n, p) Riemannian gradient of F/2 over body-frame tangents, from the Euclidean half."""
    return 2.0 * so.vee(np.swapaxes(R, 1, 2) @ gradient)


def first_order(
    graph: Graph,
    point: Estimate,
    turning: FloatArray,
    moving: FloatArray | None,
) -> tuple[float, FloatArray, FloatArray, float]:
    """F, its Riemannian gradient, multipliers and stationarity; see `certpgo.objective.edge_sums`.

    Parameters
    ----------
    turning : (n,) what the gradients of rotations are divided by
    moving : (n,) the same of translations, or None if they do not count
    """
    (G, terms), R = gradient(graph, point), point.rotations
    turn = tangent_gradient(G[:, :, -graph.d :], R)
    tangent, largest = turn, (np.linalg.norm(turn, axis=1) / turning).max()
    if graph.has_positions:
        move = G[:, :, 0]
        tangent = np.concatenate([move, turn], axis=1)
        if moving is not None:
            largest = max(largest, (np.linalg.norm(move, axis=1) / moving).max())
    return float(terms.sum()), tangent, multipliers(G[:, :, -graph.d :], R), float(largest)


def gradient(graph: Graph, point: Point) -> tuple[FloatArray, FloatArray]:
    """Half the Euclidean gradient of F, and its terms (m,), one per edge.

    The gradient is (n, r, d) for rotations; of poses (n, r, d + 1), the translation's column first.
    It is computed from residuals, which lose no digits.
    """
    n, (i, j), R = graph.num_nodes, graph.edges.T, point.rotations
    measured, K, _ = graph.polar
    E = R[j] - R[i] @ measured
    forces = E @ K
    terms = np.einsum("mab,mab->m", forces, E)
    turned = scatter_sum(j, forces, n) - scatter_sum(i, forces @ np.swapaxes(measured, 1, 2), n)
    if not graph.has_positions:
        return turned, terms
    t = translations_of(point)
    r = t[j] - t[i] - (R[i] @ graph.translations[:, :, None])[:, :, 0]
    if graph.arms is not None:
        r = r + (R[j] @ graph.arms[:, :, None])[:, :, 0]
    force = graph.tau[:, None] * r
    terms = terms + np.einsum("ma,ma->m", force, r)
    moved = scatter_sum(j, force, n) - scatter_sum(i, force, n)
    turned -= scatter_sum(i, force[:, :, None] * graph.translations[:, None, :], n)
    if graph.arms is not None:
        turned += scatter_sum(j, force[:, :, None] * graph.arms[:, None, :], n)
    return np.concatenate([moved[:, :, None], turned], axis=2), terms


def explained(graph: Graph, estimate: Estimate) -> Graph:
    """The graph with the same weights that measures exactly the relative poses of an estimate."""
    i, j = graph.edges.T
    back = np.swapaxes(estimate.rotations[i], 1, 2)
    Q = back @ estimate.rotations[j]
    N = Q @ graph.polar[1] if graph.has_couplings else None
    turned = replace(graph, rotations=Q, couplings=N)
    if not graph.has_positions:
        return turned
    t = translations_of(estimate)
    v = (back @ (t[j] - t[i])[:, :, None])[:, :, 0]
    if graph.arms is not None:
        v += (Q @ graph.arms[:, :, None])[:, :, 0]
    return replace(turned, translations=v)


@dataclass(frozen=True, eq=False)
class NodeSums:
    """What the diagonals of M and of a Hessian at any point consist of.

    Attributes
    ----------
    spread : (n, d, d) weights of the rotations, with the second moments of the arms
    first, degree : (n, d) first moments and (n,) sums of tau, or None for rotations alone
    """

    spread: FloatArray
    first: FloatArray | None = None
    degree: FloatArray | None = None

    @staticmethod
    def of(graph: Graph) -> NodeSums:
        """The sums of a graph."""
        if not graph.has_positions:
            return NodeSums(spread(graph))
        first, second = moments(graph)
        degree = degrees(graph.edges, graph.tau, graph.num_nodes)
        return NodeSums(spread(graph) + second, first, degree)


def hessian_diagonal(sums: NodeSums, R: FloatArray, multipliers: FloatArray) -> FloatArray:
    """Diagonal blocks of the exact Riemannian Hessian of F/2 over body-frame tangents.

    For tangents R_i hat(w_i) it is the restriction of L - blkdiag(Lam), so a step solves
    H w = -gradient/2; of poses that of M - blkdiag(0, Lam), over (t_i, w_i).

    Parameters
    ----------
    R : (n, d, d) rotations
    multipliers : (n, d, d) the blocks Lam_i there

    Returns
    -------
    (n, b, b) blocks, b = d (d - 1) / 2 for rotations, and d more for poses, translations first
    """
    turned = tangent_restriction(sums.spread - multipliers)
    if sums.first is None or sums.degree is None:
        return turned
    (n, d, _), p = R.shape, turned.shape[1]
    diagonal = np.zeros((n, d + p, d + p))
    diagonal[:, :d, :d] = sums.degree[:, None, None] * np.eye(d)
    diagonal[:, :d, d:] = -R @ lever(sums.first)
    diagonal[:, d:, :d] = np.swapaxes(diagonal[:, :d, d:], 1, 2)
    diagonal[:, d:, d:] = turned
    return diagonal


def couplings(graph: Graph, R: FloatArray) -> FloatArray:
    """(m, b, b) blocks of edges (i, j) of the same Hessian, for rotations (n, d, d)."""
    i, j = graph.edges.T
    between = np.swapaxes(R[j], 1, 2) @ R[i]
    if graph.couplings is None:
        turned = -graph.kappa[:, None, None] * _tangent_coupling(graph.rotations, between)
    else:
        turned = -_general_coupling(graph.couplings, between)
    if not graph.has_positions:
        return np.asarray(turned)
    # The residual moves by dt_j - dt_i + R_i lever(t_ij) w_i - R_j lever(a) w_j.
    d, p, tau = graph.d, so.tangent_dim(graph.d), graph.tau
    upper = np.zeros((graph.num_edges, d + p, d + p))
    upper[:, np.arange(d), np.arange(d)] = -tau[:, None]
    at_i = R[i] @ lever(tau[:, None] * graph.translations)
    upper[:, d:, :d] = np.swapaxes(at_i, 1, 2)
    upper[:, d:, d:] = turned
    if graph.arms is not None:
        at_j = R[j] @ lever(graph.arms)
        upper[:, :d, d:] = tau[:, None, None] * at_j
        upper[:, d:, d:] -= np.swapaxes(at_i, 1, 2) @ at_j
    return upper


def lifted_hessian(
    graph: Graph, basis: FloatArray, multipliers: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Blocks of the exact Hessian of F/2 at a point of rank r, over tangents sum_k w_k B_ik.

    The restriction of M - blkdiag(0, Lam) in each of the r dimensions; without multipliers, the
    Gauss-Newton matrix. At rank d and with B_ik = R_i hat(e_k) it is `hessian_diagonal`
    and `couplings`.

    Parameters
    ----------
    basis : (n, q, r, d) of the tangent space of the blocks Y_i
    multipliers : (n, d, d) the blocks Lam_i there

    Returns
    -------
    (n, b, b) diagonal blocks and (m, b, b) blocks of edges (i, j); b = r + q for poses, over
    translations first, and b = q for rotations
    """
    n, q, r, d = basis.shape
    i, j = graph.edges.T
    flat = basis.reshape(n, q, r * d)
    weights = spread(graph) if multipliers is None else spread(graph) - multipliers
    carried = (basis[i] @ _carrier(graph)[:, None]).reshape(-1, q, r * d)
    there = np.swapaxes(flat[j], 1, 2)
    coupling = carried @ there
    if not graph.has_couplings:
        coupling *= graph.kappa[:, None, None]
    if not graph.has_positions:
        return (basis @ weights[:, None]).reshape(n, q, r * d) @ np.swapaxes(flat, 1, 2), -coupling
    tau = graph.tau[:, None]
    first, second = moments(graph)
    weights = weights + second

    diagonal = np.zeros((n, r + q, r + q))
    diagonal[:, :r, :r] = degrees(graph.edges, graph.tau, n)[:, None, None] * np.eye(r)
    diagonal[:, r:, :r] = (basis @ first[:, None, :, None])[..., 0]
    diagonal[:, :r, r:] = np.swapaxes(diagonal[:, r:, :r], 1, 2)
    turned = (basis @ weights[:, None]).reshape(n, q, r * d)
    diagonal[:, r:, r:] = turned @ np.swapaxes(flat, 1, 2)

    upper = np.zeros((graph.num_edges, r + q, r + q))
    upper[:, np.arange(r), np.arange(r)] = -tau
    at_i = (basis[i] @ (tau * graph.translations)[:, None, :, None])[..., 0]
    upper[:, r:, :r] = -at_i
    upper[:, r:, r:] = -coupling
    if graph.arms is not None:
        at_j = (basis[j] @ graph.arms[:, None, :, None])[..., 0]
        upper[:, :r, r:] = -tau[:, None] * np.swapaxes(at_j, 1, 2)
        upper[:, r:, r:] -= at_i @ np.swapaxes(at_j, 1, 2)
    return diagonal, upper


def _carrier(graph: Graph) -> FloatArray:
    return graph.rotations if graph.couplings is None else graph.couplings


def tangent_restriction(S: FloatArray) -> FloatArray:
    """The form (v, w) -> tr(hat(v) hat(w)^T S) of S (..., d, d), as (..., p, p)."""
    trace = np.trace(S, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(trace if S.shape[-1] == 2 else trace * np.eye(3) - S)


def lever(t: FloatArray) -> FloatArray:
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


def _general_coupling(A: FloatArray, B: FloatArray) -> FloatArray:
    """(m, p, p) forms (v, w) -> tr(hat(v) A hat(w)^T B) for any matrices A."""
    basis = so.hat(np.eye(so.tangent_dim(A.shape[-1])))
    left = np.einsum("mab,kbc->mkac", B, basis)
    right = np.einsum("mab,lcb->mlac", A, basis)
    return np.asarray(np.einsum("mkac,mlca->mkl", left, right))
