"""Completing the block matrix M_B of rank b from its known blocks (Moreira 2020, section 2.3).

Missing blocks are never stored: a matrix is C D, of rank b, plus its difference on known blocks, so
that a step costs O(m + n) where the published methods fill (bn)^2 entries. Diagonal blocks are
known to be identities, although the mask of eq. 2.13 to 2.18 omits them: without them a bipartite
graph, such as a grid or tree, relates C_i of even nodes only to D_j of odd ones, and the two halves
are independent.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import sparse

from certpgo.graph import Estimate
from certpgo.graph.trees import tree_initialization
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.blocks import BlockPattern
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

from ._blocks import block_size, inverses, measured_both_ways, poses_of

#: Initialization: poses along a spanning tree, or the known blocks, with zeros for missing ones.
Start = Literal["tree", "measurements"]

NOTE = "equal edge weights: matrix completion does not support others"

#: Rounding of costs, over the cost of M_B = 0.
ROUNDING = 1e-16
#: Relative growth of the squared singular values at which to stop, and maximal number of rounds.
CONVERGED, ROUNDS = 1e-13, 100


@dataclass(frozen=True, eq=False)
class LowRank:
    """A matrix C D of rank b: ``C`` (bn, b), and ``V`` (bn, b), the transpose of D."""

    C: FloatArray
    V: FloatArray


@dataclass(frozen=True, eq=False)
class Known:
    """The known blocks of M_B: measurements in both directions, and identities.

    Attributes
    ----------
    n : number of block rows
    rows, columns : (k,) positions of the blocks, in order
    blocks : (k, b, b)
    """

    n: int
    rows: IntArray
    columns: IntArray
    blocks: FloatArray

    @classmethod
    def of(cls, problem: Quadratic) -> Known:
        """The known blocks of a problem."""
        n, b = problem.n, block_size(problem)
        pairs, forward, backward = measured_both_ways(problem)
        (i, j), k = pairs.T, np.arange(n)
        rows, columns = np.concatenate([k, i, j]), np.concatenate([k, j, i])
        identities = np.broadcast_to(np.eye(b), (n, b, b))
        blocks = np.concatenate([identities, forward, backward])
        order = np.lexsort((columns, rows))
        return cls(n, rows[order], columns[order], blocks[order])

    @cached_property
    def size(self) -> float:
        """Frobenius norm of the known blocks."""
        return float(np.linalg.norm(self.blocks))

    @cached_property
    def pattern(self) -> BlockPattern:
        """The pattern of symmetric matrices with the known blocks."""
        upper = self.rows < self.columns
        return BlockPattern(self.n, np.stack([self.rows, self.columns], axis=1)[upper])

    @cached_property
    def _indptr(self) -> IntArray:
        return np.searchsorted(self.rows, np.arange(self.n + 1))

    def at(self, L: LowRank) -> FloatArray:
        """(k, b, b) blocks of C D where they are known."""
        b = self.blocks.shape[-1]
        C, V = L.C.reshape(self.n, b, b), L.V.reshape(self.n, b, b)
        return np.asarray(C[self.rows] @ np.swapaxes(V[self.columns], 1, 2))

    def matrix(self, blocks: FloatArray) -> sparse.bsr_array:
        """(bn, bn) matrix of ``blocks`` (k, b, b) at the known positions, zero elsewhere."""
        N = self.n * blocks.shape[-1]
        return sparse.bsr_array((blocks, self.columns, self._indptr), shape=(N, N))


def nearest(change: sparse.bsr_array, L: LowRank) -> LowRank:
    """The matrix of rank b nearest to L + change, with orthonormal C.

    By block power iteration from L: each round is at least as near as L.
    """
    V, back = L.V, change.T
    grown, reached = np.inf, 0.0
    for _ in range(ROUNDS):
        C = np.linalg.qr(change @ V + L.C @ (L.V.T @ V))[0]
        V = back @ C + L.V @ (L.C.T @ C)
        grown, reached = float((V * V).sum()) - reached, float((V * V).sum())
        if grown <= CONVERGED * reached:
            break
    return LowRank(C, V)


@dataclass(frozen=True)
class Completion(Iterative):
    """A method that completes M_B and computes poses or rotations from its column space."""

    start: Start = "tree"

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses or rotations of the completed matrix, each projected separately.

        The trace shows the method's own cost, not F, and as gradient the quantity that is compared
        with the tolerance.
        """
        self.check(problem)
        watch = Stopwatch()
        with watch.phase("start"):
            known = Known.of(problem)
            estimate = initial or tree_initialization(problem.graph)
            problem.check(estimate)
            L = low_rank(estimate, problem)
            if initial is None and self.start == "measurements":
                L = nearest(known.matrix(known.blocks), LowRank(np.zeros_like(L.C), L.V))
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        column = self.complete(problem, known, L, progress)
        with watch.phase("poses"):
            # An orthonormal basis, so that rotations change by a rotation.
            estimate = poses_of(np.linalg.qr(column)[0], problem)
        return progress.solution(estimate, problem.cost(estimate), note=NOTE)

    def check(self, problem: Quadratic) -> None:
        """Refuse a problem that is too large for the method; by default none."""

    @abstractmethod
    def complete(
        self, problem: Quadratic, known: Known, L: LowRank, progress: Progress
    ) -> FloatArray:
        """Complete the matrix from L; returns its block column (bn, b)."""


@dataclass(frozen=True)
class Alternation(Completion):
    """Alternate between filling missing blocks and projecting to rank b.

    No step increases the cost.
    """

    @abstractmethod
    def loss(self, residuals: FloatArray) -> tuple[float, FloatArray]:
        """Cost of residuals on known blocks, and the correction for the next matrix."""

    def complete(
        self, problem: Quadratic, known: Known, L: LowRank, progress: Progress
    ) -> FloatArray:
        """Alternate until the cost stops decreasing."""
        rounding = ROUNDING * known.size**2
        blocks = known.at(L)
        cost, correction = self.loss(known.blocks - blocks)
        decrease, moved = np.inf, 0.0
        while progress.advance(cost, decrease, moved):
            before = cost, blocks
            with progress.watch.phase("completion"):
                L = nearest(known.matrix(correction), L)
                blocks = known.at(L)
                cost, correction = self.loss(known.blocks - blocks)
            decrease = (before[0] - cost) / max(before[0], rounding)
            moved = float(np.linalg.norm(blocks - before[1]))
        return L.C


def low_rank(estimate: Estimate, problem: Quadratic) -> LowRank:
    """The matrix M_B of an estimate."""
    n, d, b = problem.n, problem.d, block_size(problem)
    poses = np.zeros((n, b, b))
    poses[:, :d, :d] = estimate.rotations
    if problem.has_positions:
        poses[:, :d, d] = estimate.translations
        poses[:, d, d] = 1.0
    C, V = inverses(poses, d), np.swapaxes(poses, 1, 2)
    return LowRank(C.reshape(-1, b), V.reshape(-1, b))
