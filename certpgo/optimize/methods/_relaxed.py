"""Scaling the convex relaxation for a solver, and making its solutions feasible."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import divided
from certpgo.linalg.eigen import krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.solution import Relaxation

#: Eigenvalues of Y, over the largest, that count towards its rank.
RANK_TOLERANCE = 1e-4
#: First shift over a node's weight, its growth factor, and bisections of its logarithm.
FIRST_SHIFT, GROWTH, BISECTIONS = 4e-15, 8.0, 5
#: A remark on poses from methods that work on their rotations.
ALONE = "of the rotations alone; the translations are optimal for them"
#: Power iterations for leading eigenvectors: few, as the other eigenvalues are much smaller.
POWERS = 4


@dataclass(frozen=True, eq=False)
class Scaled:
    """A rotation problem's matrix, divided by the weights of the nodes.

    With s_i the weight of node i and D = blkdiag(s_i^(-1/2) I), A = D L D has identities on its
    diagonal, so that a solver's tolerances do not depend on the weights.
    """

    problem: Quadratic

    @property
    def weights(self) -> FloatArray:
        """(n,) s_i."""
        return self.problem.node_weights

    @property
    def unit(self) -> float:
        """The factor from the scaled program's value to F."""
        return float(self.weights.mean())

    @property
    def shares(self) -> FloatArray:
        """(n,) s_i over their mean: the scaled Y has diagonal blocks share_i I."""
        return self.weights / self.unit

    @property
    def matrix(self) -> CSC:
        """A, (dn, dn)."""
        L = self.problem.matrix
        root = np.sqrt(np.repeat(self.weights, self.problem.d))
        return divided(L, root)

    def multipliers(self, scaled: FloatArray) -> FloatArray:
        """Lam (n, d, d) from the scaled program's D Lam D."""
        return np.asarray(scaled * self.weights[:, None, None])

    def gram(self, scaled: FloatArray) -> FloatArray:
        """Y (dn, dn) from the scaled program's, whose diagonal blocks are ``shares`` I."""
        root = np.sqrt(np.repeat(self.shares, self.problem.d))
        return np.asarray(scaled / root / root[:, None])


@dataclass(frozen=True, eq=False)
class Feasible:
    """Multipliers made feasible for (D): L - blkdiag(Lam - shift s I) is positive definite.

    Attributes
    ----------
    value : tr(Lam) - d shift sum(s) <= F*, or 0 if that is larger
    shift : in units of the nodes' weights s
    matrix, factor : L - blkdiag(Lam - shift s I), (dn, dn), and its factor
    """

    value: float
    shift: float
    matrix: CSC
    factor: Factor


def made_feasible(data: Scaled, multipliers: FloatArray) -> Feasible:
    """Nearly the best bound that multipliers (n, d, d) give when shifted.

    Positive definiteness is decided by a factorization, up to rounding.
    """
    failed, shift = 0.0, FIRST_SHIFT
    found = _shifted(data, multipliers, shift)
    while found is None:
        failed, shift = shift, GROWTH * shift
        found = _shifted(data, multipliers, shift)
    for _ in range(BISECTIONS if failed else 0):
        middle = math.sqrt(failed * found.shift)
        sharper = _shifted(data, multipliers, middle)
        if sharper is None:
            failed = middle
        else:
            found = sharper
    return found


def _shifted(data: Scaled, multipliers: FloatArray, shift: float) -> Feasible | None:
    problem, s, d = data.problem, data.weights, data.problem.d
    matrix = problem.certificate_matrix(multipliers - (shift * s)[:, None, None] * np.eye(d))
    factor = problem.symbolic(matrix).factor(matrix)
    if factor is None:
        return None
    value = float(np.trace(multipliers, axis1=1, axis2=2).sum()) - d * shift * float(s.sum())
    return Feasible(max(value, 0.0), shift, matrix, factor)


def remark_on(problem: Quadratic, found: Relaxation) -> str:
    """What a reader should know about the relaxation behind an estimate."""
    value = f"relaxation {found.value:.10g}, rank {found.rank or 'unknown'}"
    alone = f"; the relaxation is {ALONE}" if problem.has_positions else ""
    return f"{found.status}, {value}{alone}"


def leading_rows(Y: FloatArray, d: int) -> FloatArray:
    """Rows (n, r, d) with Y_ij = rows_i^T rows_j, from the r >= d largest eigenvalues of Y.

    By subspace iteration: Y is dense and of low rank.
    """
    N = len(Y)
    width, rng = min(2 * d + 4, N), np.random.default_rng(0)
    while True:
        basis = rng.standard_normal((N, width))
        for _ in range(POWERS):
            basis = np.linalg.qr(Y @ basis)[0]
        values, vectors = np.linalg.eigh(basis.T @ Y @ basis)
        counts = values >= RANK_TOLERANCE * values[-1]
        if width == N or not counts[0]:
            break
        width = min(2 * width, N)
    rank = max(int(counts.sum()), d)
    factor = (basis @ vectors[:, -rank:]) * np.sqrt(np.maximum(values[-rank:], 0.0))
    return np.ascontiguousarray(np.swapaxes(factor.reshape(-1, d, rank), 1, 2))


def null_space_rotations(problem: Quadratic, feasible: Feasible) -> FloatArray:
    """Rotations (n, d, d) from the d smallest eigenvectors of L - blkdiag(Lam)."""
    pairs = krylov_schur(feasible.matrix, feasible.factor.solve, problem.d, tol=1e-6)
    return spectral.round_to_rotations(pairs.vectors, problem.d)
