"""Levenberg-Marquardt on the poses, for the costs of other programs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from certpgo.costs.problem import InformationProblem
from certpgo.graph import Estimate
from certpgo.graph.lift import translations_of
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.newton import ROUNDING
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

#: Damping after the first rejected step without any, and the largest, relative to the diagonal.
FIRST_DAMPING, LARGEST_DAMPING = 1e-6, 1e9
#: Damping below which none is tried: a whole step may be too long where 1e-9 is right.
LEAST_DAMPING = 1e-12
#: Actual over predicted decrease from which a step is accepted, and the damping reduced.
MIN_GAIN, GOOD_GAIN = 1e-3, 0.5


def descend(
    problem: InformationProblem,
    initial: Estimate,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 300,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` to a stationary point of the problem's cost.

    Parameters
    ----------
    tolerance : stationarity at which to stop, see `InformationProblem.stationarity`
    max_iterations : accepted and rejected steps after which to stop
    """
    problem.check(initial)
    progress = Progress(monitor, tolerance, max_iterations, watch or Stopwatch())
    point, damping, last = initial, 0.0, _FIRST
    cost, gradient, H = problem.normal_equations(point)
    stationarity = problem.stationarity_of(gradient, H)
    first_pose = np.arange(problem.n) == problem.chordal.poses[0]
    gauge = problem.tangent_layout.pack(np.tile(first_pose[:, None], (1, gradient.shape[1])))
    while progress.advance(cost, stationarity, last.length, gain=last.gain, accepted=last.accepted):
        if damping > LARGEST_DAMPING:
            progress.status = Status.STALLED
            break
        with progress.watch.phase("descend"):
            first, slope = H.diagonal(), problem.tangent_layout.pack(gradient)
            damped = damping * first
            A = add_to_diagonal(H, damped + np.where(gauge, first, 0.0))
            factor = problem.chordal.symbolic(A).factor(A)
            if factor is None:
                damping, last = 10.0 * damping or FIRST_DAMPING, _REJECTED
                continue
            step = -factor.solve(slope)
            candidate = _retract(problem, point, step)
            lower, following, matrix = problem.normal_equations(candidate)
        predicted = float(step @ (damped * step - slope))
        # Where the decrease is below rounding of the cost, the gradient may still show progress.
        gain = None if predicted <= ROUNDING * cost else float((cost - lower) / predicted)
        if gain is not None and not gain > MIN_GAIN:
            damping, last = 10.0 * damping or FIRST_DAMPING, _REJECTED
            continue
        there = problem.stationarity_of(following, matrix)
        if gain is None and not (there < stationarity and lower <= (1.0 + 2.0 * ROUNDING) * cost):
            progress.status = Status.STALLED
            break
        last = _Step(float(np.linalg.norm(step)), gain, True)
        if gain is not None and gain > GOOD_GAIN:
            damping = damping / 10.0 if damping > LEAST_DAMPING else 0.0
        point, cost, gradient, H, stationarity = candidate, lower, following, matrix, there
    return progress.solution(point, cost)


class _Step(NamedTuple):
    """The length of the last step, its actual over predicted decrease, whether it was accepted."""

    length: float
    gain: float | None
    accepted: bool


_FIRST, _REJECTED = _Step(0.0, None, True), _Step(0.0, None, False)


def _retract(problem: InformationProblem, point: Estimate, step: FloatArray) -> Estimate:
    moves = problem.tangent_layout.unpack(step)
    turned = so.project(so.turned(point.rotations, moves[:, problem.d :]))
    return Estimate.trusted(turned, translations_of(point) + moves[:, : problem.d])
