"""Covariances of poses at an estimate, from the sparse factor of the Gauss-Newton matrix."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral
from typing import Protocol

import numpy as np

from certpgo.errors import InputError, NumericalError, kind_of, require
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import Layout, pinned
from certpgo.linalg.factor import Factor, Symbolic
from certpgo.linalg.selected_inverse import blocks_of_pairs, diagonal_blocks
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

    def gauss_newton_blocks(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Its blocks of the nodes, and those of each edge between its nodes."""
        ...

    @property
    def tangent_layout(self) -> Layout:
        """Of that matrix."""
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
    or w alone for rotation graphs. Points move in the world's frame, to t_i + v. To first order
    that is GTSAM's tangent, whose order in 3D is w, v.

    Attributes
    ----------
    problem : whose cost is half the negative log-likelihood, doubled
    estimate : n nodes, at a minimum
    anchor : node that is fixed, a pose
    held : others that are fixed, such as those of `certpgo.graph.held`

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
    >>> from certpgo.io.datasets.synthetic import helix
    >>> answer = certpgo.solve(helix(6, np.random.default_rng(0)).graph)
    >>> np.sqrt(np.diag(answer.covariance(35)))[:3].round(2)  # metres
    array([0.09, 0.04, 0.09])
    """

    problem: Measured = field(repr=False)
    estimate: Estimate = field(repr=False)
    anchor: int = 0
    held: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not hasattr(self.problem, "tangent_layout"):
            raise InputError(f"a problem of poses expected, not {kind_of(self.problem)}")
        if getattr(self.problem, "kernel", None) is not None:
            raise InputError(
                "covariances are for costs without a robust kernel: it states no noise"
            )
        self.problem.check(self.estimate)
        for node in (self.anchor, *self.held):
            self._require(node)
        if self._layout.sizes[self.anchor] < self._size:
            raise InputError(f"node {self.anchor} is a point; the anchor must be a pose")

    def covariance(self, node: int) -> FloatArray:
        """(b, b) covariance of a node, zero for a fixed one; (d, d) of a point."""
        return self.joint(node)

    def relative(self, i: int, j: int) -> FloatArray:
        """(b, b) covariance of the pose of j in the frame of i, in the tangent of j.

        It does not depend on the anchor. Of a point j (d, d), of its position in the frame of i.
        """
        self._require(i)
        if self._layout.sizes[i] < self._size:
            raise InputError(f"node {i} is a point, which has no frame")
        joint, size = self.joint(i, j), int(self._layout.sizes[j])
        own = np.eye(size) if size == self._size else self.estimate.rotations[i].T
        J = np.concatenate([-self._carried(i, j)[:size], own], axis=1)
        return np.asarray(J @ joint @ J.T)

    def joint(self, *nodes: int) -> FloatArray:
        """Joint covariance of k nodes, (k b, k b) if none is a point."""
        from scipy.linalg import block_diag

        for node in nodes:
            self._require(node)
        layout = self._layout
        rows = [layout.rows_of(node) for node in nodes]
        chosen = np.concatenate(rows)
        right = np.zeros((layout.size, len(chosen)))
        right[chosen, np.arange(len(chosen))] = 1.0
        solved = self._factor.solve(right)[chosen]
        self._require_determined(np.diagonal(solved), chosen)
        sizes = [len(own) for own in rows]
        turned = block_diag(
            *(self._frames[k, :size, :size] for k, size in zip(nodes, sizes, strict=True))
        )
        covariance = turned.T @ solved @ turned
        fixed = np.repeat(np.isin(nodes, (self.anchor, *self.held)), sizes)
        covariance[fixed] = 0.0
        covariance[:, fixed] = 0.0
        return np.asarray(covariance)

    @cached_property
    def covariances(self) -> FloatArray:
        """(n, b, b) covariances of all nodes; zero for the rotations that points do not have."""
        layout = self._layout
        blocks = diagonal_blocks(*self._factor.lower(), layout)
        self._require_determined(layout.pack(np.einsum("naa->na", blocks)), np.arange(layout.size))
        blocks = np.swapaxes(self._frames, 1, 2) @ blocks @ self._frames
        blocks[[self.anchor, *self.held]] = 0.0
        return np.asarray(blocks)

    def relatives(self, pairs: IntArray) -> FloatArray:
        """(k, b, b) the `relative` covariance of each pair of poses (k, 2) with a measurement.

        In the time of `covariances`.
        """
        joint = blocks_of_pairs(*self._factor.lower(), self._layout, pairs)
        b, layout = self._size, self._layout
        variances = layout.unpack(self._information.diagonal())[pairs].reshape(len(pairs), -1)
        own = np.einsum("kaa->ka", joint) * variances
        still = np.isin(pairs, (self.anchor, *self.held)).repeat(b, axis=1)
        if not (own[~still] < LARGEST).all():
            raise NumericalError(UNDETERMINED)
        joint[still[:, :, None] | still[:, None, :]] = 0.0
        back, there = self.motions(pairs)
        J = np.concatenate([back, there], axis=2)
        return np.asarray(J @ joint @ np.swapaxes(J, 1, 2))

    def motions(self, pairs: IntArray) -> tuple[FloatArray, FloatArray]:
        """Two (k, b, b): how motions of i and of j move j in the frame of i, in its own tangent.

        Motions as in the problem's layout: of positions in the world, of rotations in the body.
        """
        (R, t), (i, j) = (self.estimate.rotations, self.estimate.translations), pairs.T
        there = np.swapaxes(self._frames[j], 1, 2)
        back = np.swapaxes(R[j], 1, 2) @ R[i]
        d, q = R.shape[1], so.tangent_dim(R.shape[1])
        turned = back if d == 3 else np.ones((len(pairs), 1, 1))
        if t is None:
            return -turned, there
        carried = np.zeros((len(pairs), d + q, d + q))
        carried[:, :d, :d], carried[:, d:, d:] = back, turned
        apart = np.einsum("kba,kb->ka", R[j], t[i] - t[j])
        carried[:, :d, d:] = lever(apart) @ turned
        return -carried @ np.swapaxes(self._frames[i], 1, 2), there

    def _require(self, node: int) -> None:
        require(node, Integral, "the number of a node")
        if isinstance(node, bool):
            raise InputError(f"the number of a node expected, not {node}")
        if not 0 <= node < self.problem.n:
            raise InputError(f"node {node} is not among 0 to {self.problem.n - 1}")

    @property
    def _layout(self) -> Layout:
        return self.problem.tangent_layout

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
        poses = self._layout.whole
        frames[poses, :d, :d] = R[poses]
        return frames

    @cached_property
    def _factor(self) -> Factor:
        factor = self.problem.symbolic(self._information).factor(self._information)
        if factor is None:
            raise NumericalError(UNDETERMINED)
        return factor

    @cached_property
    def _information(self) -> CSC:
        """The Gauss-Newton matrix, rows and columns of fixed nodes cut off."""
        H, layout = self.problem.gauss_newton(self.estimate), self._layout
        rows = [layout.rows_of(node) for node in {self.anchor, *self.held}]
        return pinned(H, np.concatenate(rows))

    def _require_determined(self, variances: FloatArray, rows: IntArray) -> None:
        """Refuse variances that rounding alone keeps finite: a factorization seldom fails."""
        if not (variances * self._information.diagonal()[rows] < LARGEST).all():
            raise NumericalError(UNDETERMINED)

    def _carried(self, i: int, j: int) -> FloatArray:
        """(b, b) the adjoint of X_j^-1 X_i: the motion of i in the tangent of j.

        The frame of a point is that of i.
        """
        R, t = self.estimate.rotations, self.estimate.translations
        there = R[j] if self._layout.sizes[j] == self._size else R[i]
        back, d = there.T @ R[i], R.shape[1]
        turned = back if d == 3 else np.eye(1)
        if t is None:
            return turned
        adjoint = np.zeros((self._size,) * 2)
        adjoint[:d, :d], adjoint[d:, d:] = back, turned
        adjoint[:d, d:] = lever((there.T @ (t[i] - t[j]))[None])[0] @ turned
        return adjoint
