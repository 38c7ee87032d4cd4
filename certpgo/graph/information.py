"""Measured poses with their full information matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import GraphError
from certpgo.graph.display import Brief
from certpgo.graph.edges import induced, symmetric
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.rotation_graph import RotationGraph
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_floats,
    frozen_indices,
)
from certpgo.linalg.ball_arithmetic import Ball, is_positive_definite

#: How far K stays from singular where it is clipped, relative to O's second eigenvalue.
_MARGIN = 2.0**-20


@dataclass(frozen=True, eq=False, repr=False)
class Information(Brief):
    """The information matrices of a file, each distinct one stored once.

    Attributes
    ----------
    distinct : (k, p, p) symmetric matrices, translation before rotation; the rotational part is
        zero for positions alone
    index : (m,) which of them belongs to each edge
    residual : the cost whose residuals they weigh in the program that the file is of, as named in
        `certpgo.objective.choose_cost`; None if that is not known

    Raises
    ------
    GraphError
        Matrices that are not square, finite and symmetric, or an index beyond them.
    """

    distinct: FloatArray
    index: IntArray
    residual: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "distinct", frozen_floats(self.distinct))
        object.__setattr__(self, "index", frozen_indices(self.index))
        shape = self.distinct.shape
        if len(shape) != 3 or shape[1] != shape[2] or self.index.ndim != 1:
            raise GraphError(f"information must be square matrices and an index, not {shape}")
        _refuse_asymmetric(self.distinct)
        if ((self.index < 0) | (self.index >= len(self.distinct))).any():
            raise GraphError(f"information matrices are numbered 0 to {len(self.distinct) - 1}")

    @property
    def matrices(self) -> FloatArray:
        """(m, p, p) matrices of the edges."""
        return np.asarray(self.distinct[self.index])

    @cached_property
    def is_definite(self) -> BoolArray:
        """(m,) which matrices are proven to be positive definite, without rows of zeros."""
        return np.asarray(_definite(self.distinct)[self.index])

    @cached_property
    def is_partial(self) -> BoolArray:
        """(m,) which blocks of matrices, of translations or rotations, have rows of zeros.

        A block that is zero as a whole is not counted: that is not measured at all.
        """
        d = 2 if self.distinct.shape[1] == 3 else 3
        unstated = unmeasured(self.distinct)
        some = [rows.any(axis=1) & ~rows.all(axis=1) for rows in np.split(unstated, [d], axis=1)]
        return np.asarray(some[0] | some[1])[self.index]

    @cached_property
    def anisotropy(self) -> tuple[float, float]:
        """How far matrices are from multiples of the identity, which kappa and tau stand for.

        The largest ratio of two eigenvalues of a block, for translation and for rotation; 1 where
        blocks are multiples of the identity, infinite for one that is singular.
        """
        d = 2 if self.distinct.shape[1] == 3 else 3
        of_poses = self.distinct[:, d:, d:].any(axis=(1, 2))
        blocks = (self.distinct[:, :d, :d], self.distinct[of_poses][:, d:, d:])
        return _largest_ratio(blocks[0]), _largest_ratio(blocks[1])

    def subset(self, chosen: IntArray | BoolArray) -> Information:
        """The matrices of some edges, given by index or mask (m,)."""
        return Information(self.distinct, self.index[chosen], self.residual)

    def in_first_frames(self, rotations: FloatArray) -> Information:
        """The matrices, of translations alone in the frame of the first node.

        A pose is weighed in the frame that it was measured to have, a position in that of the node
        it is measured from.

        Parameters
        ----------
        rotations : (m, d, d) measured
        """
        d = rotations.shape[1]
        unturned = np.asarray(unmeasured(self.distinct)[:, d:].all(axis=1))
        alone = unturned[self.index]
        return self.turned(np.where(alone[:, None, None], rotations, np.eye(d)))

    def turned(self, rotations: FloatArray) -> Information:
        """The matrices in frames that have these rotations (m, d, d) in their own."""
        d = rotations.shape[1]
        chosen = np.flatnonzero((rotations != np.eye(d)).any(axis=(1, 2)))
        if not len(chosen):
            return self
        R, before = rotations[chosen], self.distinct[self.index[chosen]]
        after = before.copy()
        # In the plane a rotation has one coordinate, which does not turn.
        blocks = [slice(0, d), *([slice(d, 2 * d)] if d == 3 else [])]
        for block in blocks:
            after[:, block] = R @ after[:, block]
        for block in blocks:
            after[:, :, block] = after[:, :, block] @ np.swapaxes(R, 1, 2)
        after = symmetric(after)
        for block in blocks:  # multiples of the identity stay what they are
            T = before[:, block, block]
            even = (T[:, :1, :1] * np.eye(d) == T).all(axis=(1, 2))
            after[even, block, block] = T[even]
        index = self.index.copy()
        index[chosen] = len(self.distinct) + np.arange(len(chosen))
        return Information(np.concatenate([self.distinct, after]), index, self.residual)


def _largest_ratio(blocks: FloatArray) -> float:
    """The largest ratio of two eigenvalues of one of these symmetric blocks (k, p, p)."""
    if not len(blocks) or blocks.shape[1] == 1:
        return 1.0
    values = np.linalg.eigvalsh(blocks)
    low, high = values[:, 0], values[:, -1]
    if not (low > 0.0).all():
        return math.inf
    return float((high / low).max())


def mahalanobis(graph: PoseGraph, information: Information, scale: float = 1.0) -> Mahalanobis:
    """The graph whose rotational terms are the Mahalanobis distances of the information.

    A term tr(E K E^T), E = R_j - R_i R_ij, is 4 sin^2(theta/2) n^T O n for a residual angle theta
    about n and K = tr(O)/2 I - O in space, K = O/2 I in the plane: theta^2 n^T O n to second order.
    K is positive definite if the largest eigenvalue of O is less than the sum of the others. It is
    lowered to that elsewhere, so that each term, and every bound, is below that of O.

    Parameters
    ----------
    graph : the measurements, isotropic; tau is kept
    information : of its edges
    scale : of the rotational part, to make it refer to the tangent space
    """
    omega, d = information.distinct[:, graph.d :, graph.d :], graph.d
    if d == 2:
        return Mahalanobis(graph.with_weights(0.5 * scale * omega[information.index, 0, 0]), 0)
    values, axes = np.linalg.eigh(omega)
    # The smallest eigenvalue of K is then the margin.
    most = values[:, 0] + values[:, 1] - 2.0 * np.minimum(_MARGIN * values[:, 1], values[:, 0] / 4)
    clipped = values[:, 2] > most
    values[:, 2] = np.minimum(values[:, 2], most)
    K = 0.5 * scale * (values.sum(axis=1)[:, None] - 2.0 * values)
    weights = symmetric((axes * K[:, None, :]) @ np.swapaxes(axes, 1, 2))[information.index]
    general = replace(graph, rotation=graph.rotation.with_matrix_weights(weights))
    return Mahalanobis(general, int(np.count_nonzero(clipped[information.index])))


class Mahalanobis(NamedTuple):
    """A graph with Mahalanobis weights, and on how many edges they are lowered."""

    graph: PoseGraph
    clipped: int


@dataclass(frozen=True, eq=False, repr=False)
class InformationGraph(Brief):
    """Relative poses between nodes, each with a full information matrix.

    Attributes
    ----------
    isotropic : the same measurements with the weights kappa and tau of the chordal cost
    information : (m, p, p) symmetric matrices, translation before rotation, p = 3 or 6; 1/m^2,
        1/m and dimensionless; the rotational part is zero for positions alone. What residual they
        weigh is the cost's: the rotational part refers to the vector part of a quaternion in g2o,
        to the tangent space in GTSAM

    Raises
    ------
    GraphError
        Matrices of another shape, not symmetric, not finite or beyond the range of weights.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.io.datasets.synthetic import helix
    >>> graph = helix(3, np.random.default_rng(0)).graph
    >>> information = np.tile(np.diag([4.0, 4, 4, 1, 1, 1]), (graph.num_edges, 1, 1))
    >>> full = InformationGraph(graph, information)
    >>> full.num_edges, bool(full.is_definite.all())
    (14, True)
    """

    isotropic: PoseGraph
    information: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "information", frozen_floats(self.information))
        m, p = self.num_edges, self.d * (self.d + 1) // 2
        if self.information.shape != (m, p, p):
            raise GraphError(
                f"information must be {(m, p, p)} matrices, not {self.information.shape}"
            )
        if not (np.abs(self.information) < FAR).all():
            raise GraphError(f"information must be finite, with entries below {FAR:.2g}")
        _refuse_asymmetric(self.information)

    @property
    def rotation(self) -> RotationGraph:
        """The graph of relative rotations."""
        return self.isotropic.rotation

    @property
    def rotations(self) -> FloatArray:
        """(m, d, d) measured rotations R_ij ~ R_i^T R_j."""
        return self.isotropic.rotation.rotations

    @property
    def translations(self) -> FloatArray:
        """(m, d) measured t_ij ~ R_i^T (t_j - t_i), metres."""
        return self.isotropic.translations

    @property
    def edges(self) -> IntArray:
        """(m, 2) node pairs (i, j)."""
        return self.isotropic.edges

    @property
    def num_nodes(self) -> int:
        """Number n of poses."""
        return self.isotropic.num_nodes

    @property
    def num_edges(self) -> int:
        """Number m of edges, parallel ones counted."""
        return self.isotropic.num_edges

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.isotropic.d

    @cached_property
    def is_definite(self) -> BoolArray:
        """(m,) which matrices are proven to be positive definite, without rows of zeros."""
        return _definite(self.information)

    @cached_property
    def scale(self) -> float:
        """W_f: the sum of the mean rotational and, times |t_ij|^2, translational information."""
        return self.scales.total

    @property
    def scales(self) -> Scale:
        """What it is made of."""
        diagonal = np.abs(np.diagonal(self.information, axis1=1, axis2=2))
        turn, move = diagonal[:, self.d :].mean(axis=1), diagonal[:, : self.d].mean(axis=1)
        return Scale.weighed(self.isotropic, turn, move)

    def scaled(self, factor: float) -> InformationGraph:
        """The same measurements with all weights times ``factor``."""
        isotropic = self.isotropic.reweighted(np.full(self.num_edges, factor))
        other = InformationGraph(isotropic, factor * self.information)
        if math.frexp(factor)[0] == 0.5:  # a power of two rounds nothing
            other.__dict__["is_definite"] = self.is_definite
        return other

    def reweighted(self, factors: FloatArray) -> InformationGraph:
        """Information times factors (m,); an edge with factor 0 is removed."""
        kept = factors != 0.0
        information = factors[kept, None, None] * self.information[kept]
        return InformationGraph(self.isotropic.reweighted(factors), information)

    def with_edges(self, chosen: IntArray | BoolArray) -> InformationGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return InformationGraph(self.isotropic.with_edges(chosen), self.information[chosen])

    def subgraph(self, nodes: IntArray) -> InformationGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        _, chosen = induced(self.num_nodes, self.edges, nodes)
        return InformationGraph(self.isotropic.subgraph(nodes), self.information[chosen])


def of_positions(T: FloatArray) -> FloatArray:
    """(k, p, p) information matrices of positions, from those of d coordinates (k, d, d)."""
    q = T.shape[1] * (T.shape[1] - 1) // 2
    return np.pad(T, ((0, 0), (0, q), (0, q)))


def joined_information(parts: Sequence[Information | None]) -> Information | None:
    """The information matrices of several parts, one after another; None unless each has some."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    offsets = np.cumsum([0, *(len(part.distinct) for part in known)])
    index = [part.index + offset for part, offset in zip(known, offsets[:-1], strict=True)]
    distinct = np.concatenate([part.distinct for part in known])
    return Information(distinct, np.concatenate(index), known[0].residual)


def unmeasured(information: FloatArray) -> BoolArray:
    """(k, p) which rows of matrices (k, p, p) are zero: nothing is stated of those directions."""
    return np.asarray(~np.any(information, axis=1))


def _definite(information: FloatArray) -> BoolArray:
    """(k,) which matrices are proven to be positive definite, without rows of zeros."""
    filled = information + unmeasured(information)[:, None, :] * np.eye(information.shape[-1])
    return is_positive_definite(Ball.exact(filled))


def _refuse_asymmetric(information: FloatArray) -> None:
    """Refuse matrices (m, p, p) that are not finite and symmetric."""
    if not np.isfinite(information).all():
        raise GraphError("information must be finite")
    if (information != np.swapaxes(information, 1, 2)).any():
        raise GraphError("information matrices must be symmetric")
