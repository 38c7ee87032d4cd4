"""Shifted multipliers, which also compensate the rounding of the translations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.edges import symmetric
from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.linalg import compiled
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import diagonal_of
from certpgo.linalg.compiled import LARGEST_RANK
from certpgo.objective.quadratic import Quadratic

#: Share of the largest diagonal entry of a rotation below which no measurement has a column, such
#: as those across gravity: its multipliers are rounding, which would be negative eigenvalues.
IDLE = 1e-12


@dataclass(frozen=True, eq=False)
class Shifted:
    """The family Lam' = Lam - shift of multipliers, for one point.

    Attributes
    ----------
    multipliers : (n, d, d) Lam
    blocks : (n, r, d) the point's rotations
    arms : (k, r) of each row of translations, from the pinned pose, and of blocks of unknown scale;
        none for rotations alone
    pin : the pose whose translation is pinned; None for rotations alone
    is_rotation : (N,) which rows of the certificate matrix belong to rotations of known scale
    weights : (N,) weights of its row sums: for translations, a typical arm
    unit : the unit of rounding of a typical diagonal entry
    poses : the nodes that have a rotation, of known scale
    """

    multipliers: FloatArray
    blocks: FloatArray
    arms: FloatArray
    pin: int | None
    is_rotation: BoolArray
    weights: FloatArray
    unit: float
    poses: IntArray

    @staticmethod
    def of(problem: Quadratic, point: Point, pin: int | None = None) -> Shifted:
        """The family of a point of any rank; the most central pose is pinned, or another one."""
        is_rotation = _held_rows(problem)
        arms, pinned = np.zeros((0, point.rotations.shape[1])), None
        weights = np.ones(len(is_rotation))
        if problem.has_positions and point.translations is not None:
            t = point.translations
            # Pinning the pose nearest the centroid costs least.
            central = int(np.argmin(np.linalg.norm(t - t.mean(axis=0), axis=1)))
            pinned = central if pin is None else pin
            arms = _loose_rows(problem, point, pinned)
            is_position = ~problem.rotation_rows
            weights[is_position] = 2.0 ** _exponent(arms[is_position[~is_rotation]])
            unscaled = ~(is_rotation | is_position)
            if unscaled.any():
                lengths = np.linalg.norm(arms[unscaled[~is_rotation]], axis=1)
                weights[unscaled] = np.exp2(np.round(np.log2(lengths)))
        sizes = np.abs(diagonal_of(problem.matrix)[is_rotation])
        unit = U * float(sizes.mean())
        multipliers = problem.multipliers(point)
        idle = (
            sizes.reshape(-1, problem.d) <= IDLE * sizes.reshape(-1, problem.d).max(axis=1)[:, None]
        )
        if idle.any():
            node, k = np.nonzero(idle)
            multipliers = multipliers.copy()
            multipliers[problem.held[node], k] = multipliers[problem.held[node], :, k] = 0.0
        blocks = point.rotations
        if problem.takes_scales:
            blocks = blocks / problem.sizes_of(blocks)[:, None, None]
        return Shifted(
            multipliers,
            blocks,
            arms,
            pinned,
            is_rotation,
            weights,
            unit,
            problem.held,
        )

    def less(self, shift: float, demand: FloatArray) -> FloatArray:
        """(n, d, d) Lam minus ``shift``, minus the compensation of ``demand`` (N,) on translations.

        Blocks of points stay zero. The null vectors of the certificate matrix are (Y_i^T u,
        arm_i u) for world directions u: in each, the shift of all rotations compensates the demand
        of all translations.
        """
        d, poses, gauge = self.multipliers.shape[1], self.poses, None
        if self.pin is not None:
            weighted = demand[~self.is_rotation, None] * self.arms
            gauge = self.arms.T @ weighted / len(poses)
        reduced = self.multipliers.copy()
        if compiled.AVAILABLE and self.blocks.shape[1] <= LARGEST_RANK:
            blocks = np.ascontiguousarray(self.blocks)
            compiled.kernel.lessen(shift, gauge, blocks, poses, d, reduced)
            return reduced
        less = shift * np.eye(d)
        if gauge is not None:
            blocks = self.blocks[poses]
            less = less + symmetric(np.swapaxes(blocks, 1, 2) @ gauge @ blocks)
        reduced[poses] -= less
        return reduced

    @cached_property
    def trace(self) -> float:
        """Sum of the traces of Lam."""
        return float(np.trace(self.multipliers[self.poses], axis1=1, axis2=2).sum())

    def trace_of_less(self, shift: float, demand: FloatArray) -> float:
        """What `less` takes off that sum at rank d, up to rounding."""
        rotations = shift * float(self.multipliers.shape[1] * len(self.poses))
        if self.pin is None:
            return rotations
        return rotations + float(demand[~self.is_rotation] @ np.sum(self.arms**2, axis=1))


def _held_rows(problem: Quadratic) -> BoolArray:
    """(N,) which rows of the matrix are of blocks whose columns have known lengths."""
    if len(problem.held) == len(problem.poses):
        return problem.rotation_rows
    layout = problem.pattern.layout_of(problem.matrix)
    rows = np.zeros((problem.n, layout.sizes.max()), dtype=bool)
    rows[problem.held, -problem.d :] = True
    return np.asarray(layout.pack(rows))


def _loose_rows(problem: Quadratic, point: Point, pin: int) -> FloatArray:
    """(k, r) rows of X^T whose lengths no constraint fixes, the pinned pose at the origin."""
    point = problem.blocks(point)
    t = translations_of(point)
    rows = problem.lifting.position_rows(t - t[pin])
    if len(problem.held) == len(problem.poses):
        return rows.reshape(-1, t.shape[1])
    rows = np.concatenate([rows, np.swapaxes(point.rotations, 1, 2)], axis=1)
    layout = problem.pattern.layout_of(problem.matrix)
    return np.asarray(layout.pack(rows)[~_held_rows(problem)])


def _exponent(arms: FloatArray) -> int:
    """Exponent of the power of two nearest to the root mean square of the arms.

    Raises
    ------
    NumericalError
        Their squares are beyond the range of doubles.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        rms = float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))
    if not math.isfinite(rms):
        raise NumericalError("squares of positions are beyond the range of doubles")
    return round(math.log2(rms)) if rms > 0.0 else 0
