"""Covariances of poses at an estimate, from the sparse factor of the Gauss-Newton matrix."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import pinned
from certpgo.linalg.factor import Factor, Symbolic
from certpgo.linalg.selected_inverse import selected_inverse
from certpgo.objective.operators import lever

#: Variances, times the information of their own entry, beyond which rounding decides them.
LARGEST = 1e13
UNDETERMINED = "the measurements do not determine all nodes relative to the anchor: no covariances"


class Measured(Protocol):
    """A problem: measurements, and a cost that is a sum of squares."""

    @property
    def n(self) -> int:
        """Number of nodes."""
        ...

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph by an InputError."""
        ...

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """Gauss-Newton matrix of half the cost, over world translations and body rotations."""
        ...

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a block matrix of the graph."""
        ...


@dataclass(frozen=True, eq=False)
class Marginals:
    """Marginal covariances: blocks of the inverse Gauss-Newton matrix of half the cost.

    Under noise whose negative log-likelihood is half the cost, so that information matrices are
    inverse covariances. One node is fixed, relative to which the others are uncertain. Node i moves
    to t_i + R_i v, R_i exp(w), in its own frame; rows and columns are v (metres), then w (radians),
    or w alone for rotation graphs. To first order that is GTSAM's tangent, whose order in 3D is
    w, v.

    Attributes
    ----------
    problem : whose cost is half the negative log-likelihood, doubled
    estimate : n nodes, at a minimum
    anchor : node that is fixed

    Raises
    ------
    InputError
        An estimate of another graph, or a node that is not in it.
    NumericalError
        The measurements do not determine all nodes.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import helix
    >>> answer = certpgo.solve(helix(6, np.random.default_rng(0)).graph)
    >>> np.sqrt(np.diag(answer.covariance(35)))[:3].round(2)  # metres
    array([0.07, 0.04, 0.07])
    """

    problem: Measured = field(repr=False)
    estimate: Estimate = field(repr=False)
    anchor: int = 0

    def __post_init__(self) -> None:
        self.problem.check(self.estimate)
        self._require(self.anchor)

    def covariance(self, node: int) -> FloatArray:
        """(b, b) covariance of a node, zero for the anchor."""
        return self.joint(node)

    def relative(self, i: int, j: int) -> FloatArray:
        """(b, b) covariance of the pose of j in the frame of i, in the tangent of j.

        It does not depend on the anchor.
        """
        joint, b = self.joint(i, j), self._size
        J = np.concatenate([-self._carried(i, j), np.eye(b)], axis=1)
        return np.asarray(J @ joint @ J.T)

    def joint(self, *nodes: int) -> FloatArray:
        """(k b, k b) joint covariance of k nodes."""
        for node in nodes:
            self._require(node)
        b = self._size
        chosen = (np.array(nodes)[:, None] * b + np.arange(b)).ravel()
        right = np.zeros((self.problem.n * b, len(chosen)))
        right[chosen, np.arange(len(chosen))] = 1.0
        solved = self._factor.solve(right)[chosen]
        self._require_determined(np.diagonal(solved), chosen)
        blocks = solved.reshape(len(nodes), b, len(nodes), b)
        frames = self._frames[list(nodes)]
        blocks = np.einsum("iba,ibjc,jcd->iajd", frames, blocks, frames)
        fixed = np.array(nodes) == self.anchor
        blocks[fixed] = 0.0
        blocks[:, :, fixed] = 0.0
        return np.asarray(blocks.reshape(len(chosen), len(chosen)))

    @cached_property
    def covariances(self) -> FloatArray:
        """(n, b, b) covariances of all nodes."""
        L, rows = self._factor.lower()
        n, b = self.problem.n, self._size
        place = np.argsort(rows).reshape(n, b)
        first, second = place[:, :, None], place[:, None, :]
        lower, upper = np.maximum(first, second), np.minimum(first, second)
        found = selected_inverse(L)[lower.ravel(), upper.ravel()]
        blocks = np.asarray(found).reshape(n, b, b)
        self._require_determined(np.einsum("naa->na", blocks).ravel(), np.arange(n * b))
        blocks = np.swapaxes(self._frames, 1, 2) @ blocks @ self._frames
        blocks[self.anchor] = 0.0
        return np.asarray(blocks)

    def _require(self, node: int) -> None:
        if not 0 <= node < self.problem.n:
            raise InputError(f"node {node} is not among 0 to {self.problem.n - 1}")

    @property
    def _size(self) -> int:
        return int(self._frames.shape[1])

    @cached_property
    def _frames(self) -> FloatArray:
        """(n, b, b) orthogonal matrices from the nodes' tangents to those of the problem."""
        R = self.estimate.rotations
        (n, d, _), q = R.shape, so.tangent_dim(R.shape[1])
        if self.estimate.translations is None:
            return np.tile(np.eye(q), (n, 1, 1))
        frames = np.tile(np.eye(d + q), (n, 1, 1))
        frames[:, :d, :d] = R
        return frames

    @cached_property
    def _factor(self) -> Factor:
        factor = self.problem.symbolic(self._information).factor(self._information)
        if factor is None:
            raise NumericalError(UNDETERMINED)
        return factor

    @cached_property
    def _information(self) -> CSC:
        """The Gauss-Newton matrix, the anchor's rows and columns cut off."""
        H = self.problem.gauss_newton(self.estimate)
        b = H.shape[0] // self.problem.n
        return pinned(H, self.anchor * b + np.arange(b))

    def _require_determined(self, variances: FloatArray, rows: IntArray) -> None:
        """Refuse variances that rounding alone keeps finite: a factorization seldom fails."""
        if not (variances * self._information.diagonal()[rows] < LARGEST).all():
            raise NumericalError(UNDETERMINED)

    def _carried(self, i: int, j: int) -> FloatArray:
        """(b, b) the adjoint of X_j^-1 X_i: the motion of i in the tangent of j."""
        R, t = self.estimate.rotations, self.estimate.translations
        back, d = R[j].T @ R[i], R.shape[1]
        turned = back if d == 3 else np.eye(1)
        if t is None:
            return turned
        adjoint = np.zeros((self._size,) * 2)
        adjoint[:d, :d], adjoint[d:, d:] = back, turned
        adjoint[:d, d:] = lever((R[j].T @ (t[i] - t[j]))[None])[0] @ turned
        return adjoint
