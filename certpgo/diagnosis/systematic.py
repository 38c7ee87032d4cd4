"""Constant errors of one sensor: its unit, where it is mounted, and the drift of its turns.

Residuals move with such an error by known slopes: a sensor that is mounted elsewhere moves as if
all poses that carry it were moved at once, a unit as if what is measured were further away, a bias
of turns as if the next pose were turned. So with the slopes B of an error, those A of the poses,
and the projection P on these (see `certpgo.diagnosis.study`), a fit of both steps by

    -(B^T (I - P) B)^+ B^T e,     and leaves  |e|^2 - e^T B (B^T (I - P) B)^+ B^T e

of the residuals e of the fit, to first order: the score test of the hypothesis.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, cast

import numpy as np

from certpgo.diagnosis.edge_readings import EdgeReading
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.study import Study, study
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph
from certpgo.graph.mounted import Frames, mounted
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, frozen_floats
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.normal_equations import moved
from certpgo.objective.sum import Sum

#: Steps to the best error, and the share of chi^2 that is not worth another.
STEPS, SMALL = 8, 1e-3
#: Directions of an error that leave this share of its squares are not determined.
OPEN = 1e-6
#: Names of what may be off, in the order of a step's coordinates.
METRES, TURN, ARM, BIAS = "metres", "turn", "arm", "bias"


@dataclass(frozen=True, eq=False)
class Systematic:
    """A constant error of some measurements.

    Attributes
    ----------
    of : what these are, in words
    rows : (m,) which of all measurements, which are edges
    carried : (m, 2) which of their nodes carry the sensor
    metres : what their lengths are multiplied by to be in metres
    turn, arm : (d, d) and (d,), where the sensor is on a pose
    bias : (q,) radians by which each turn is too large, from one pose to the next
    backward : (m,) which edges are from the later pose to the earlier one
    free : which of these are estimated
    before : another convention that they are read by first; None for none
    """

    of: str
    rows: BoolArray
    carried: BoolArray
    turn: FloatArray
    arm: FloatArray
    bias: FloatArray
    backward: BoolArray
    free: tuple[str, ...]
    metres: float = 1.0
    before: EdgeReading | None = None

    @property
    def _frames(self) -> tuple[Frames, Frames]:
        """Where the sensor is on both nodes of each measurement."""
        nowhere = np.eye(len(self.arm))
        first, second = (
            Frames(
                np.where(at[:, None, None], self.turn, nowhere),
                np.where(at[:, None], self.arm, 0.0),
            )
            for at in self.carried.T
        )
        return first, second

    def read(self, graph: Graph) -> Graph:
        """The measurements without the error."""
        m = graph.num_edges
        rows, rotations, translations = self.rows[:m], graph.rotations.copy(), graph.translations
        R, t = rotations[rows], translations[rows]
        if self.before is not None:
            _, R, t = self.before.read(graph.edges[rows], R, t)
        t = self.metres * t
        if self.bias.any():
            [turned], back = so.exp(self.bias[None]), self.backward[:m][rows]
            R = so.nearest_to_rounding(np.where(back[:, None, None], turned @ R, R @ turned.T))
            t = np.where(back[:, None], t @ turned.T, t)
        translations = translations.copy()
        rotations[rows], translations[rows] = R, t
        # Rotations remain rotations, and checks would take longer than trials.
        read = graph._with(
            rotations=frozen_floats(rotations), translations=frozen_floats(translations)
        )
        edges = np.arange(m)
        frames = (frame.subset(edges) for frame in self._frames)
        return mounted(read, graph.edges, *frames) if self.carried.any() else read

    def slopes(self, fit: Study, read: Graph) -> Iterator[FloatArray]:
        """Of each part (k, r, c): derivatives of residuals by what is free.

        Parameters
        ----------
        read : the measurements that the fit is to
        """
        R, d = fit.estimate.rotations, fit.problem.d
        m, lengths = read.num_edges, np.zeros((len(self.rows), d))
        lengths[:m] = read.translations - self._frames[0].translations[:m]
        for part in fit.parts:
            own, half = part.rows, part.slopes.shape[2] // 2
            at, nodes = (part.slopes[:, :, :half], part.slopes[:, :, half:]), fit.edges[own].T
            along = at[1][:, :, :d] @ R[nodes[0]] @ lengths[own][:, :, None]
            back = self.backward[own][:, None, None]
            carried = [
                np.where(on[:, None, None], slopes, 0.0)
                for on, slopes in zip(self.carried[own].T, at, strict=True)
            ]
            known = {
                METRES: -along,
                TURN: sum(slopes[:, :, d:] for slopes in carried),
                ARM: sum(of[:, :, :d] @ R[k] for of, k in zip(carried, nodes, strict=True)),
                BIAS: np.where(back, at[0][:, :, d:], at[1][:, :, d:]),
            }
            columns = np.concatenate([known[name] for name in self.free], axis=2)
            yield np.where(self.rows[own][:, None, None], columns, 0.0)

    def places(self, name: str) -> BoolArray:
        """(c,) which coordinates of a step are of one of what is free."""
        return np.repeat(
            [one == name for one in self.free], [self._sizes[one] for one in self.free]
        )

    def moved(self, by: FloatArray) -> Self:
        """After a step of what is free."""
        found, used = self, 0
        for name in self.free:
            size = self._sizes[name]
            step, used = by[used : used + size], used + size
            if name == METRES:
                found = replace(found, metres=found.metres * float(np.exp(np.clip(step[0], -2, 2))))
            elif name == TURN:
                [turned] = so.exp(step[None])
                found = replace(found, turn=turned @ found.turn, arm=turned @ found.arm)
            elif name == ARM:
                found = replace(found, arm=found.arm + step)
            else:
                found = replace(found, bias=found.bias + step)
        return found

    @property
    def _sizes(self) -> dict[str, int]:
        d, q = len(self.arm), len(self.bias)
        return {METRES: 1, TURN: q, ARM: d, BIAS: q}


@dataclass(frozen=True, eq=False)
class Score:
    """What an error explains, to first order.

    Attributes
    ----------
    step : (c,) of what is free
    left : chi^2 that it leaves
    information : (c, c) about such steps
    moves : (N,) of the poses with the step
    """

    step: FloatArray
    left: float
    information: FloatArray
    moves: FloatArray

    def costs_at_least(self, off: FloatArray, chosen: BoolArray) -> float:
        """By how much chi^2 rises with steps ``off`` of the chosen (c,), all others being free."""
        M = self.information
        own, rest = M[np.ix_(chosen, chosen)], M[np.ix_(~chosen, ~chosen)]
        across = M[np.ix_(chosen, ~chosen)]
        return float(off @ (own - across @ np.linalg.pinv(rest, hermitian=True) @ across.T) @ off)


def score(error: Systematic, fit: Study, read: Graph) -> Score:
    """The score test of an error at a fit to the measurements that are read."""
    slopes = [*error.slopes(fit, read)]
    count, (n, p) = slopes[0].shape[2], (len(fit.layout.sizes), fit.parts[0].slopes.shape[2] // 2)
    pulled, square, pull = np.zeros((n, p, count)), np.zeros((count, count)), np.zeros(count)
    for part, B in zip(fit.parts, slopes, strict=True):
        pull += np.einsum("kr,krc->c", part.residuals, B)
        square += np.einsum("kra,krb->ab", B, B)
        at = np.swapaxes(part.slopes, 1, 2) @ B
        for end, half in zip(fit.edges[part.rows].T, (at[:, :p], at[:, p:]), strict=True):
            pulled += scatter_sum(end, half, n)
    packed = fit.free[:, None] * fit.layout.pack(pulled)
    solved = fit.factor.solve(packed)
    left = square - packed.T @ solved
    unit = np.sqrt(np.maximum(np.diag(square), np.finfo(float).tiny))
    values, U = np.linalg.eigh(left / np.outer(unit, unit))
    known = values > OPEN
    along = (U.T @ (pull / unit))[known]
    step = -(U[:, known] @ (along / values[known])) / unit
    explained = float((along**2 / values[known]).sum())
    return Score(step, fit.fit.chi2 - explained, left, -solved @ step)


@dataclass(frozen=True, eq=False)
class Fitted:
    """An error, and the fit with it undone."""

    error: Systematic
    fit: Study

    @property
    def chi2(self) -> float:
        """Of the fit."""
        return self.fit.fit.chi2

    @cached_property
    def score(self) -> Score:
        """Of what is free of the error."""
        return score(self.error, self.fit, self.fit.problem.measured)


def fitted(examined: Examined, start: Fitted) -> Fitted:
    """The best error of a kind, by steps of Gauss and Newton of poses and error together."""
    found = start
    for _ in range(STEPS):
        if not found.error.free or not found.score.left < found.chi2 * (1.0 - SMALL):
            break
        moves = found.fit.layout.unpack(found.score.moves)
        error = found.error.moved(found.score.step)
        trial = at_error(examined, error, moved(found.fit.estimate, moves))
        if trial is None or not trial.chi2 < found.chi2:
            break
        found = trial
    return found


def at_error(examined: Examined, error: Systematic, near: Estimate) -> Fitted | None:
    """The fit with an error undone, near an estimate."""
    with suppress(CertPGOError, np.linalg.LinAlgError):
        fit = study(problem_at(examined, error), near, examined.anchor)
        return None if fit is None else Fitted(error, fit)
    return None


def problem_at(examined: Examined, error: Systematic) -> Sum:
    """Squares over the stated noise of the measurements without an error."""
    posed = cast("Sum", examined.studied)
    return posed.of_same_edges(error.read(posed.measured))
