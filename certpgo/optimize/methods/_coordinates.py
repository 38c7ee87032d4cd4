"""Coordinate descent on the semidefinite relaxation of rotations, with Y = X X^T.

A block X_i (d x r) has orthonormal rows, so that Y is positive semidefinite with identity blocks on
its diagonal, whatever the rank r. Minimising tr(L Y) over the k-th block row and column of Y alone,
Lemma 5.1 of Eriksson et al., gives X_k = (G G^T)^(-1/2) G with G = sum_j Rtilde_kj X_j. At rank d
that may be a reflection, and rotations mixed with reflections need not be near any stationary
rotations: there X_k is the rotation nearest to G, which minimises over rotations.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative

Order = Literal["colors", "cyclic", "random"]

#: Fraction of nonzeros from which products with dense rows are faster, and the most entries of a
#: dense matrix.
DENSE, LARGEST = 0.08, 5e7
#: Eigenvalues of G G^T, over the largest, below which its inverse root is inaccurate.
SINGULAR = 1e-12
#: Singular values of X, over the largest, that are negligible in Y.
NEGLIGIBLE = 1e-8


@dataclass(frozen=True)
class Sweeping(Iterative):
    """Settings of a block coordinate method."""

    order: Order = "colors"
    seed: int = 0

    def coordinates(self, problem: Quadratic, X: FloatArray) -> Coordinates:
        """The point X, to be improved in the chosen order."""
        return Coordinates(problem, X, self.order, np.random.default_rng(self.seed))


@dataclass(eq=False)
class Coordinates:
    """A point of the relaxation, and the sweeps that improve it.

    Attributes
    ----------
    problem : with L
    X : (dn, r) rows of the point
    order : of the blocks in a sweep: ``"colors"`` updates mutually unconnected blocks at once,
        equivalent to some order one by one; ``"cyclic"``; ``"random"``, a new one each sweep
    rng : for random orders
    """

    problem: Quadratic
    X: FloatArray
    order: Order
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.n, self.d = self.problem.n, self.problem.d
        self._rows = [
            (nodes[:, None] * self.d + np.arange(self.d)).ravel() for nodes in self._partition()
        ]
        self._by_dense_rows = self._dense_rows_pay
        self._groups = self._grouped()

    @property
    def _dense_rows_pay(self) -> bool:
        """Whether products with X are faster with dense rows of Rtilde."""
        L = self.problem.matrix
        full = L.nnz > DENSE * L.shape[0] ** 2 and L.shape[0] ** 2 < LARGEST
        return bool(full and self.X.shape[1] > 4 * self.d)

    def _grouped(self) -> list[tuple[IntArray, FloatArray | sparse.csr_array]]:
        """Rows of X that are updated at once, with the same rows of Rtilde."""
        L = self.problem.matrix
        Rtilde = -L + sparse.diags_array(L.diagonal())
        rows_of = Rtilde.toarray() if self._by_dense_rows else sparse.csr_array(Rtilde)
        return [(rows, rows_of[rows]) for rows in self._rows]

    def _partition(self) -> Iterator[IntArray]:
        """Blocks that are updated at once."""
        if self.order != "colors":
            yield from np.arange(self.problem.n)[:, None]
            return
        colors = _coloring(self.problem.n, self.problem.graph.edges)
        for color in range(int(colors.max()) + 1):
            yield np.flatnonzero(colors == color)

    def sweep(self) -> tuple[float, float]:
        """Update every block once; returns the decrease of tr(L Y) and the largest change."""
        groups = self._groups
        if self.order == "random":
            groups = [groups[k] for k in self.rng.permutation(len(groups))]
        decrease, moved = 0.0, 0.0
        for rows, Rtilde in groups:
            G = np.asarray(Rtilde @ self.X).reshape(-1, self.d, self.X.shape[1])
            before = self.X[rows].reshape(G.shape)
            after = _rotations(G) if self.X.shape[1] == self.d else _polar(G)
            decrease += 2.0 * float(np.vdot(G, after - before))
            moved = max(moved, float(np.abs(after - before).max()))
            self.X[rows] = after.reshape(len(rows), -1)
        return decrease, moved

    def evaluate(self) -> tuple[float, FloatArray]:
        """F, and the multipliers Lam_i = sym((L Y)_ii), whose traces add up to F."""
        LX = (self.problem.matrix @ self.X).reshape(self.n, self.d, -1)
        blocks = np.einsum("nar,nbr->nab", LX, self.X.reshape(LX.shape), optimize=True)
        Lam = 0.5 * (blocks + np.swapaxes(blocks, 1, 2))
        return float(np.einsum("naa->", Lam)), Lam

    def is_definite(self, Lam: FloatArray, shift: float) -> bool:
        """Whether L - blkdiag(Lam) + shift I has a Cholesky factor."""
        S: CSC = self.problem.certificate_matrix(Lam - shift * np.eye(self.d))
        return self.problem.symbolic(S).factor(S) is not None

    def compress(self) -> None:
        """Drop dimensions that are negligible in Y."""
        values, vectors = np.linalg.eigh(self.X.T @ self.X)
        kept = values > NEGLIGIBLE**2 * values[-1]
        kept[-2 * self.d :] = True
        if kept.sum() < 0.8 * len(kept):
            self.X = np.ascontiguousarray(self.X @ vectors[:, kept])
            if self._by_dense_rows and not self._dense_rows_pay:
                self._by_dense_rows = False
                self._groups = self._grouped()

    @property
    def blocks(self) -> FloatArray:
        """(n, r, d) with Y_ij = blocks_i^T blocks_j."""
        return np.ascontiguousarray(np.swapaxes(self.X.reshape(self.n, self.d, -1), 1, 2))


def _polar(G: FloatArray) -> FloatArray:
    """(G G^T)^(-1/2) G of blocks (k, d, r)."""
    gram = G @ np.swapaxes(G, 1, 2)
    values = np.linalg.eigvalsh(gram)
    if np.all(values[:, 0] > SINGULAR * values[:, -1]):
        return so.inverse_square_roots(gram) @ G
    # The singular vectors complete missing directions arbitrarily.
    U, _, Vt = np.linalg.svd(G, full_matrices=False)
    return np.asarray(U @ Vt)


def _rotations(G: FloatArray) -> FloatArray:
    """The rotations nearest to blocks (k, d, d)."""
    X = _polar(G)
    reflected = so.determinants(X) < 0.0
    if reflected.any():
        X[reflected] = so.project(G[reflected])
    return X


def stacked(estimate: Estimate) -> FloatArray:
    """X (dn, d) of an estimate: the R_i^T, stacked."""
    R = estimate.rotations
    return np.swapaxes(R, 1, 2).reshape(-1, R.shape[1]).copy()


def _coloring(n: int, edges: IntArray) -> IntArray:
    """(n,) colors, different at both ends of an edge, by decreasing degree."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    starts = np.searchsorted(ends[:, 0], np.arange(n + 1))
    colors = np.full(n, -1)
    for node in np.argsort(-np.diff(starts), kind="stable").tolist():
        taken = np.zeros(n + 1, dtype=bool)
        taken[colors[ends[starts[node] : starts[node + 1], 1]]] = True
        colors[node] = int(np.argmin(taken[:-1]))
    return colors
