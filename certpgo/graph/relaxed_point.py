"""Points of the rank-r relaxation, and rounding to estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import GraphError, InputError, require
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Lift:
    """A point of the low-rank relaxation: rotations in r >= d dimensions.

    Attributes
    ----------
    rotations : (n, r, d) blocks Y_i with orthonormal columns
    translations : (n, r), or None
    """

    rotations: FloatArray
    translations: FloatArray | None = None

    @property
    def num_nodes(self) -> int:
        """Number n of nodes."""
        return len(self.rotations)

    @property
    def rank(self) -> int:
        """Number r of dimensions."""
        return int(self.rotations.shape[1])

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.rotations.shape[2])

    def with_translations(self, translations: FloatArray | None) -> Lift:
        """The same blocks with other translations."""
        return Lift(self.rotations, translations)

    def subset(self, nodes: IntArray) -> Lift:
        """The point of ``nodes`` alone, in that order."""
        t = self.translations
        return Lift(self.rotations[nodes], None if t is None else t[nodes])


#: An estimate, or a point of the relaxation: both have a cost.
Point = Estimate | Lift


def require_nodes(point: Point, n: int, d: int) -> None:
    """Refuse a point of other nodes by an InputError."""
    require(point, Estimate | Lift, "an Estimate")
    if (point.num_nodes, point.d) != (n, d):
        raise InputError(
            f"the estimate has {point.num_nodes} nodes in {point.d}D, the graph {n} in {d}D"
        )


def translations_of(point: Point) -> FloatArray:
    """The translations of a point, which has some; else a GraphError."""
    if point.translations is None:
        raise GraphError("the estimate has no translations")
    return point.translations


def lifted(point: Point, rank: int) -> Lift:
    """The same point padded with zeros to ``rank`` dimensions."""
    new = rank - point.rotations.shape[1]
    t = point.translations
    return Lift(
        np.pad(point.rotations, ((0, 0), (0, new), (0, 0))),
        None if t is None else np.pad(t, ((0, 0), (0, new))),
    )


def main_subspace(point: Lift) -> FloatArray:
    """(r, d) orthonormal basis of the main d-dimensional subspace of the rotations."""
    Y = point.rotations
    _, vectors = np.linalg.eigh(np.einsum("nra,nsa->rs", Y, Y))
    return np.asarray(vectors[:, -point.d :])


def rounded(point: Lift) -> Estimate:
    """The estimate nearest to a point of the relaxation.

    The point is projected to its main d-dimensional subspace, then each rotation to SO(d); Rosen
    et al. (SE-Sync, IJRR 2019), Algorithm 2.
    """
    d, Y = point.d, point.rotations
    basis = main_subspace(point)
    if so.is_mostly_reflected(np.swapaxes(basis.T @ Y, 1, 2)):
        basis = basis * np.r_[-1.0, np.ones(d - 1)]
    t = point.translations
    return Estimate(so.project(basis.T @ Y), None if t is None else t @ basis)
