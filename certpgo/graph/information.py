"""Full information matrices of measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.display import Brief
from certpgo.graph.edges import symmetric
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_floats,
    frozen_indices,
)
from certpgo.linalg.ball_arithmetic import Ball, is_positive_definite

#: What rotational information is about.
RotationAbout = Literal["tangent", "quaternion"]
#: What rounding changes entries by where matrices are turned, relative to the diagonal.
TURNED = 2.0**-48
#: Eigenvalues that turning may leave in place of zeros, relative to the largest.
ROUNDING = 1e-12
#: Matrices up to which equal ones of several parts are found.
FEW = 256


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
    about : what kappa, which averages the rotational part, takes that to be about: a tangent vector
        or the vector part of a quaternion. In the plane they are one

    Raises
    ------
    GraphError
        Matrices that are not square, finite and symmetric, or an index beyond them.
    """

    distinct: FloatArray
    index: IntArray
    residual: str | None = None
    about: RotationAbout = "tangent"

    def __post_init__(self) -> None:
        object.__setattr__(self, "distinct", frozen_floats(self.distinct))
        object.__setattr__(self, "index", frozen_indices(self.index))
        shape = self.distinct.shape
        if len(shape) != 3 or shape[1] != shape[2] or self.index.ndim != 1:
            raise GraphError(f"information must be square matrices and an index, not {shape}")
        if not np.isfinite(self.distinct).all():
            raise GraphError("information must be finite")
        if (self.distinct != np.swapaxes(self.distinct, 1, 2)).any():
            raise GraphError("information matrices must be symmetric")
        if ((self.index < 0) | (self.index >= len(self.distinct))).any():
            raise GraphError(f"information matrices are numbered 0 to {len(self.distinct) - 1}")

    def require_size(self, m: int, d: int) -> None:
        """Refuse matrices of another number of edges or another dimension, by a GraphError."""
        p = d * (d + 1) // 2
        expected, found = (m, p, p), (len(self.index), *self.distinct.shape[1:])
        if found != expected:
            raise GraphError(f"information must be {expected}, a matrix per edge, not {found}")

    @cached_property
    def matrices(self) -> FloatArray:
        """(m, p, p) matrices of the edges."""
        return frozen_floats(self.distinct[self.index])

    @cached_property
    def is_definite(self) -> BoolArray:
        """(m,) which matrices are proven to be positive definite, without rows of zeros."""
        return np.asarray(_definite(self.distinct)[self.index])

    @property
    def indefinite(self) -> str:
        """What those that are not `is_definite` are: the end of a sentence."""
        distinct = self.distinct[np.unique(self.index[~self.is_definite])]
        values = np.linalg.eigvalsh(distinct)
        if not (values[:, 0] >= -ROUNDING * values[:, -1]).all():
            return "not positive definite"
        return (
            "not positive definite (what they leave open is along no axis of their frames, as "
            "where poses are held or sensors mounted)"
        )

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

    @classmethod
    def of(
        cls, matrices: FloatArray, residual: str | None = None, about: RotationAbout = "tangent"
    ) -> Information:
        """These matrices (m, p, p), one for each edge."""
        return cls(matrices, np.arange(len(matrices)), residual, about)

    @classmethod
    def isotropic(
        cls,
        kappa: FloatArray,
        tau: FloatArray,
        d: int,
        residual: str | None = None,
        about: RotationAbout = "tangent",
    ) -> Information:
        """Multiples of the identity that are read as these weights (m,)."""
        q = d * (d - 1) // 2
        of_axes = kappa * (1.0 if d == 2 else 2.0 if about == "tangent" else 8.0)
        diagonal = np.concatenate([np.tile(tau, (d, 1)), np.tile(of_axes, (q, 1))]).T
        return cls.of(diagonal[:, :, None] * np.eye(d + q), residual, about)

    def stating(self, kappa: FloatArray, tau: FloatArray) -> Information:
        """What states these weights (k,) of other measurements for the same program."""
        d = 2 if self.distinct.shape[1] == 3 else 3
        return Information.isotropic(kappa, tau, d, self.residual, self.about)

    def of_residual(self, residual: str | None) -> Information:
        """The same matrices, which weigh the residuals of another program's cost."""
        return self._with(residual=residual)

    def _with(self, **changed: Any) -> Information:
        """The same with attributes that are known to be in order."""
        other = object.__new__(Information)
        known = (self.distinct, self.index, self.residual, self.about)
        names = ("distinct", "index", "residual", "about")
        other.__dict__.update(zip(names, known, strict=True))
        other.__dict__.update(changed)
        return other

    def about_tangents(self) -> Information:
        """The same noise in matrices about tangents, of which kappa is what it is."""
        d = 2 if self.distinct.shape[1] == 3 else 3
        if d == 2 or self.about == "tangent":
            return replace(self, about="tangent")
        unit = np.repeat([1.0, 0.5], d)  # a quaternion's vector part is half of a tangent vector
        return replace(self, distinct=self.distinct * np.outer(unit, unit), about="tangent")

    def __getitem__(self, chosen: IntArray | BoolArray) -> Information:
        """The matrices of some edges, given by index or mask (m,)."""
        index = self.index[chosen]
        if len(index) >= len(self.distinct):
            return replace(self, index=index)
        used, index = np.unique(index, return_inverse=True)
        return replace(self, distinct=self.distinct[used], index=index)

    def scaled(self, factor: float) -> Information:
        """All matrices times ``factor``."""
        other = replace(self, distinct=factor * self.distinct)
        known = self.__dict__.get("is_definite")
        if known is not None and math.frexp(factor)[0] == 0.5:  # a power of two rounds nothing
            other.__dict__["is_definite"] = known
        return other

    def reweighted(self, factors: FloatArray) -> Information:
        """Matrices times factors (m,); those with factor 0 are removed."""
        kept = factors != 0.0
        distinct = factors[kept, None, None] * self.matrices[kept]
        return Information.of(distinct, self.residual, self.about)

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
        return replace(self, distinct=np.concatenate([self.distinct, after]), index=index)


def _largest_ratio(blocks: FloatArray) -> float:
    """The largest ratio of two eigenvalues of one of these symmetric blocks (k, p, p)."""
    if not len(blocks) or blocks.shape[1] == 1:
        return 1.0
    values = np.linalg.eigvalsh(blocks)
    low, high = values[:, 0], values[:, -1]
    if not (low > 0.0).all():
        return math.inf
    return float((high / low).max())


def of_positions(T: FloatArray) -> FloatArray:
    """(k, p, p) information matrices of positions, from those of d coordinates (k, d, d)."""
    q = T.shape[1] * (T.shape[1] - 1) // 2
    return np.pad(T, ((0, 0), (0, q), (0, q)))


def joined_information(parts: Sequence[Information | None]) -> Information | None:
    """The information matrices of several parts, one after another.

    None unless each has some, for the residuals of the same program.
    """
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or len({(part.residual, part.about) for part in known}) > 1:
        return None
    distinct = np.concatenate([part.distinct for part in known])
    offsets = np.cumsum([0, *(len(part.distinct) for part in known)])
    index = np.concatenate(
        [part.index + offset for part, offset in zip(known, offsets[:-1], strict=True)]
    )
    if len(distinct) <= FEW:
        numbers: dict[bytes, int] = {}
        same = [numbers.setdefault(matrix.tobytes(), len(numbers)) for matrix in distinct]
        if len(numbers) < len(distinct):
            _, first = np.unique(same, return_index=True)
            distinct, index = distinct[first], np.array(same)[index]
    return known[0]._with(distinct=frozen_floats(distinct), index=frozen_indices(index))


def unmeasured(information: FloatArray) -> BoolArray:
    """(k, p) which rows of matrices (k, p, p) are zero: nothing is stated of those directions."""
    return np.asarray(~np.any(information, axis=1))


def _definite(information: FloatArray) -> BoolArray:
    """(k,) which matrices are proven to be positive definite, without rows of zeros."""
    filled = information + unmeasured(information)[:, None, :] * np.eye(information.shape[-1])
    sizes = np.sqrt(np.abs(np.diagonal(filled, axis1=1, axis2=2)))
    # Else rounding would say whether a singular matrix that was turned is definite.
    return is_positive_definite(Ball.within(filled, TURNED * sizes[:, :, None] * sizes[:, None, :]))
