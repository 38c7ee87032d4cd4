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
#: A factor serves the next step, too, where its last one reduced the stationarity by this factor.
FAST = 0.5


def descend(
    problem: InformationProblem,
    initial: Estimate,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 600,
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
    point, damping, last, layout = initial, 0.0, _FIRST, problem.tangent_layout
    here = problem.normal_equations(point)
    curvature, factor = here.curvature, None
    stationarity = problem.stationarity_of(here.gradient, curvature)
    anchor = np.arange(problem.n) == problem.chordal.anchor
    gauge = layout.pack(np.tile(anchor[:, None], (1, curvature.shape[1])))
    while progress.advance(
        here.cost, stationarity, last.length, gain=last.gain, accepted=last.accepted
    ):
        if damping > LARGEST_DAMPING:
            progress.status = Status.STALLED
            break
        reused, slope = factor is not None, layout.pack(here.gradient)
        with progress.watch.phase("descend"):
            if factor is None:
                diagonal = here.matrix.diagonal()
                curvature, damped = layout.unpack(diagonal), damping * diagonal
                A = add_to_diagonal(here.matrix, damped + np.where(gauge, diagonal, 0.0))
                factor = problem.symbolic(A).factor(A)
            if factor is None:
                damping, last = 10.0 * damping or FIRST_DAMPING, _REJECTED
                continue
            step = -factor.solve(slope)
            candidate = _retract(problem, point, step)
            there = problem.normal_equations(candidate)
        predicted = float(step @ (damped * step - slope))
        # Where the decrease is below rounding of the cost, the gradient may still show progress.
        gain = None
        if not predicted <= ROUNDING * here.cost:
            gain = float((here.cost - there.cost) / predicted)
            if not gain > MIN_GAIN:
                factor, last = None, _REJECTED
                damping = damping if reused else 10.0 * damping or FIRST_DAMPING
                continue
        ahead = problem.stationarity_of(there.gradient, curvature)
        risen = not there.cost <= (1.0 + 2.0 * ROUNDING) * here.cost
        if gain is None and (risen or not ahead < stationarity):
            if reused:
                factor, last = None, _REJECTED
                continue
            progress.status = Status.STALLED
            break
        if damping > 0.0 or not ahead < FAST * stationarity:
            factor = None
        if gain is not None and gain > GOOD_GAIN:
            damping = damping / 10.0 if damping > LEAST_DAMPING else 0.0
        last = _Step(float(np.linalg.norm(step)), gain, True)
        point, here, stationarity = candidate, there, ahead
    return progress.solution(point, here.cost)


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
