"""The thesis' block matrices of measurements, and poses from their block columns.

Moreira 2020, section 2.3: with M_i the inverse of pose i, measured blocks are M_ij = M_i M_j^-1,
[R_ij t_ij; 0 1] for poses (b = d + 1) and R_ij for rotations alone (b = d), and the block column
M_C of the M_i gives the complete matrix M_B = M_C M_C^-b of rank b.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.quadratic import Quadratic


def block_size(problem: Quadratic) -> int:
    """b: d + 1 for poses, d for rotations alone."""
    return problem.d + problem.has_positions


def edge_blocks(problem: Quadratic) -> tuple[IntArray, FloatArray]:
    """Edges (m, 2) and their blocks M_ij (m, b, b)."""
    require_capable(problem.graph, "isotropic method")
    graph = problem.rotation.graph
    d, b = problem.d, block_size(problem)
    blocks = np.zeros((graph.num_edges, b, b))
    blocks[:, :d, :d] = graph.rotations
    if problem.has_positions:
        blocks[:, :d, d] = problem.graph.translations
        blocks[:, d, d] = 1.0
    return graph.edges, blocks


def measured_both_ways(problem: Quadratic) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pairs (p, 2) i < j, each once, their blocks M_ij (p, b, b), and their blocks M_ji.

    Backward measurements are inverted, and parallel ones averaged in each direction: the inverse of
    a mean is not the mean of the inverses, and this way i and j are interchangeable.
    """
    edges, blocks = edge_blocks(problem)
    i, j = edges.T
    ways = np.stack([blocks, inverses(blocks, problem.d)], axis=1)
    ways[i > j] = ways[i > j, ::-1]
    codes = np.minimum(i, j) * problem.n + np.maximum(i, j)
    distinct, place, count = np.unique(codes, return_inverse=True, return_counts=True)
    means = scatter_sum(place, ways, len(distinct)) / count[:, None, None, None]
    pairs = np.stack(np.divmod(distinct, problem.n), axis=1)
    return pairs, means[:, 0], means[:, 1]


def inverses(blocks: FloatArray, d: int) -> FloatArray:
    """Inverses of rotations (..., d, d), or of poses (..., d + 1, d + 1) [R t; 0 1]."""
    R = np.swapaxes(blocks[..., :d, :d], -1, -2)
    inverse = np.array(blocks)
    inverse[..., :d, :d] = R
    if blocks.shape[-1] > d:
        inverse[..., :d, d] = -(R @ blocks[..., :d, d:])[..., 0]
    return inverse


def block_matrix(
    n: int, pairs: IntArray, forward: FloatArray, backward: FloatArray, diagonal: FloatArray
) -> sparse.csr_array:
    """(bn, bn): blocks ``forward`` at (i, j), ``backward`` at (j, i), ``diagonal`` (n, b, b).

    Blocks at the same place are summed.
    """
    b = diagonal.shape[-1]
    k = np.arange(n)
    i, j = pairs.T
    data = np.concatenate([diagonal, forward, backward])
    row, column = np.concatenate([k, i, j]), np.concatenate([k, j, i])
    order = np.lexsort((column, row))
    indptr = np.searchsorted(row[order], np.arange(n + 1))
    matrix = sparse.bsr_array((data[order], column[order], indptr), shape=(b * n, b * n))
    return matrix.tocsr()


def poses_of(column: FloatArray, problem: Quadratic) -> Estimate:
    """The estimate nearest to a block column (bn, b) of orthonormal columns that the M_i span.

    For poses the last rows of the blocks are first made nearly [0 ... 0 1]. Then blocks are
    projected, without a common reflection, and inverted.
    """
    d, b = problem.d, block_size(problem)
    blocks = column.reshape(problem.n, b, b)
    if b > d:
        blocks = blocks @ _homogenizing(blocks[:, d])
    rotations = blocks[:, :d, :d]
    if so.is_mostly_reflected(rotations):
        rotations = rotations * np.r_[-np.ones(1), np.ones(d - 1)]
    R = np.swapaxes(so.project(rotations), 1, 2)
    if b == d:
        return Estimate(R)
    return Estimate(R, -(R @ blocks[:, :d, d:])[:, :, 0])


def _homogenizing(last: FloatArray) -> FloatArray:
    """(b, b) matrix Q that takes rows (n, b) nearest to [0 ... 0 1].

    Its first columns are the b - 1 directions in which the rows are smallest; the last is the
    least-squares solution of last Q_b = 1.
    """
    few = len(last) < last.shape[1]
    directions = np.linalg.svd(last, full_matrices=few)[2][::-1]
    solved = np.linalg.lstsq(last, np.ones(len(last)), rcond=None)[0]
    return np.column_stack([*directions[: last.shape[1] - 1], solved])
