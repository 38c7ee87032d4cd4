"""Damped Newton for the completion of M_B.

Buchanan and Fitzgibbon, "Damped Newton algorithms for matrix factorization with missing data",
CVPR 2005; Moreira 2020, algorithm 2. Theirs is the bilinear problem

    minimise f(C, D) = 1/2 ||W o (Mtilde_B - C D)||_F^2 + alpha/2 (||C||_F^2 + ||D||_F^2)

over a block column C and a block row D. The thesis writes M_C and M_C^-b, but algorithm 2 is not
for an f with a block inverse, which also requires the group's constraints, here relaxed. With the
residuals E_ij = C_i D_j - M_ij the Hessian has blocks

    C_i by C_i: I x sum_j D_j D_j^T        D_j by D_j: sum_i C_i^T C_i x I
    (C_i)_pq by (D_j)_rs: (C_i)_pr (D_j)_qs + (E_ij)_ps [q = r]

so with C_i and D_i together it is as sparse as the graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import NumericalError, SpecError
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, scatter_sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods import _memory
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Status

from ._blocks import block_size
from ._completion import Completion, Known, LowRank

#: Damping at which to give up.
STRONGEST = 1e16
#: Bytes per entry of the Hessian and of its factor, measured with either engine: from 180 MB to
#: 800 MB the sum is within a factor of two.
ENTRY, FILL = 60.0, 24.0


@dataclass(frozen=True)
class DampedNewton(Completion):
    """Newton steps of (H + damping I)^-1 from the spanning tree; no step increases the cost.

    C D is the same for C G and G^-1 D: damping also fixes that gauge. It grows tenfold when a step
    fails and shrinks tenfold otherwise; as printed it grows before every trial and shrinks once,
    and would never decrease.

    Attributes
    ----------
    tolerance : gradient of f, over the norms of the known blocks and of the factors, to stop at
    max_iterations : stop anyway
    start : ``"tree"``, or ``"measurements"``, with zeros for missing blocks
    damping : initial damping
    alpha : of the regularization, which shrinks the matrix; Newton's method does not need it
    force : run even if memory seems too small
    """

    tolerance: float = 1e-11
    max_iterations: int = 300
    damping: float = 0.01
    alpha: float = 0.0
    force: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.damping > 0.0 and self.alpha >= 0.0):
            raise SpecError("damping must be positive and alpha not negative")

    def check(self, problem: Quadratic) -> None:
        """Refuse a Hessian whose factor is too large."""
        if not self.force:
            _memory.refuse(bytes_needed(problem), "the Hessian of damped Newton")

    def complete(
        self, problem: Quadratic, known: Known, L: LowRank, progress: Progress
    ) -> FloatArray:
        """Algorithm 2."""
        point, damping, moved = Point(known, balanced(L), self.alpha), self.damping, 0.0
        while progress.advance(point.cost, point.stationarity, moved):
            with progress.watch.phase("completion"):
                following, damping = self.descended(problem, point, damping)
            if following is None:
                progress.status = Status.STALLED
                break
            moved = float(np.linalg.norm(following.x - point.x))
            point, damping = following, damping / 10.0
        return point.L.C

    def descended(
        self, problem: Quadratic, point: Point, damping: float
    ) -> tuple[Point | None, float]:
        """The next point, or None, and its damping."""
        H = point.hessian
        symbolic = problem.symbolic(H)
        while damping < STRONGEST:
            factor = symbolic.factor(add_to_diagonal(H, damping))
            if factor is not None:
                following = point.at(point.x - factor.solve(point.gradient))
                if following.cost <= point.cost:
                    return following, damping
            damping *= 10.0
        return None, damping


@dataclass(frozen=True, eq=False)
class Point:
    """Factors C and D, and the derivatives of f there; x lists each node's C_i, then D_i^T."""

    known: Known
    L: LowRank
    alpha: float

    @cached_property
    def blocks(self) -> tuple[FloatArray, FloatArray]:
        """C_i and V_i = D_i^T, (n, b, b)."""
        n, b = self.known.n, self.L.C.shape[1]
        return self.L.C.reshape(n, b, b), self.L.V.reshape(n, b, b)

    @cached_property
    def residuals(self) -> FloatArray:
        """(k, b, b) blocks E_ij."""
        return self.known.at(self.L) - self.known.blocks

    @cached_property
    def x(self) -> FloatArray:
        """(2 n b^2,) unknowns."""
        return np.stack(self.blocks, axis=1).ravel()

    def at(self, x: FloatArray) -> Point:
        """Another point."""
        b = self.L.C.shape[1]
        C, V = np.moveaxis(x.reshape(self.known.n, 2, b, b), 1, 0)
        return Point(self.known, LowRank(C.reshape(-1, b), V.reshape(-1, b)), self.alpha)

    @cached_property
    def cost(self) -> float:
        """The function f."""
        E, x = self.residuals, self.x
        return 0.5 * float((E * E).sum() + self.alpha * (x @ x))

    @cached_property
    def gradient(self) -> FloatArray:
        """(2 n b^2,) gradient of f."""
        E = self.known.matrix(self.residuals)
        C, V = self.L.C, self.L.V
        n, (_, b) = self.known.n, C.shape
        turned = np.stack([(E @ V).reshape(n, b, b), (E.T @ C).reshape(n, b, b)], axis=1)
        return np.asarray(turned.ravel() + self.alpha * self.x)

    @property
    def stationarity(self) -> float:
        """Norm of the gradient, over those of what is known and of x."""
        return float(np.linalg.norm(self.gradient) / (self.known.size * np.linalg.norm(self.x)))

    @cached_property
    def hessian(self) -> CSC:
        """(2 n b^2, 2 n b^2) second derivatives of f, with the pattern of the graph."""
        known, (C, V) = self.known, self.blocks
        n, b = known.n, C.shape[1]
        i, j = known.rows, known.columns
        # (C_i)_pq by (V_j)_sr.
        mixed = np.einsum("kpr,ksq->kpqsr", C[i], V[j]) + np.einsum(
            "kps,qr->kpqsr", self.residuals, np.eye(b)
        )
        mixed = mixed.reshape(-1, b * b, b * b)
        own = np.zeros((n, 2, b * b, 2, b * b))
        own[:, 0, :, 0] = _repeated(scatter_sum(i, np.swapaxes(V[j], 1, 2) @ V[j], n))
        own[:, 1, :, 1] = _repeated(scatter_sum(j, np.swapaxes(C[i], 1, 2) @ C[i], n))
        own[:, 0, :, 1] = mixed[i == j]
        own[:, 1, :, 0] = np.swapaxes(mixed[i == j], 1, 2)
        # Pairs i < j in the order of the pattern; back locates (j, i).
        above, back = i < j, np.lexsort((i, j))[i < j]
        upper = np.zeros((int(above.sum()), 2, b * b, 2, b * b))
        upper[:, 0, :, 1] = mixed[above]
        upper[:, 1, :, 0] = np.swapaxes(mixed[back], 1, 2)
        side = 2 * b * b
        H = known.pattern.assemble(own.reshape(n, side, side), upper.reshape(-1, side, side))
        return add_to_diagonal(H, self.alpha)


def balanced(L: LowRank) -> LowRank:
    """The same matrix with factors of equal norm, whatever the frame of the poses."""
    C, R = np.linalg.qr(L.C)
    V, S = np.linalg.qr(L.V)
    left, values, right = np.linalg.svd(R @ S.T)
    roots = np.sqrt(values)
    return LowRank(C @ left * roots, V @ right.T * roots)


def _repeated(blocks: FloatArray) -> FloatArray:
    """(n, b^2, b^2) I x S of blocks S (n, b, b)."""
    n, b, _ = blocks.shape
    out = np.einsum("pr,nqs->npqrs", np.eye(b), blocks)
    return np.asarray(out.reshape(n, b * b, b * b))


def bytes_needed(problem: Quadratic) -> float:
    """Approximate peak memory of a step: the Hessian and its factor."""
    rotation = problem.rotation
    factor = rotation.grounded_factor(rotation.laplacian)
    if factor is None:
        raise NumericalError("the graph Laplacian could not be factorized")
    entries = (2 * block_size(problem) ** 2) ** 2
    return float(entries * (ENTRY * rotation.laplacian.nnz + FILL * factor.lower()[0].nnz))


SOLVER = DampedNewton
