"""Levenberg-Marquardt on the poses, for the costs of other programs."""

from __future__ import annotations

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
#: Actual over predicted decrease from which the damping is reduced.
GOOD_GAIN = 0.5


def descend(
    problem: InformationProblem,
    initial: Estimate,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 200,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` to a stationary point of the problem's cost.

    Parameters
    ----------
    tolerance : stationarity at which to stop, see `InformationProblem.stationarity`
    """
    problem.check(initial)
    progress = Progress(monitor, tolerance, max_iterations, watch or Stopwatch())
    point, damping, step_norm, gain = initial, 0.0, 0.0, None
    cost, gradient, H = problem.normal_equations(point)
    first_pose = np.arange(problem.n) == problem.chordal.poses[0]
    gauge = problem.tangent_layout.pack(np.tile(first_pose[:, None], (1, gradient.shape[1])))
    while progress.advance(cost, problem.stationarity_of(gradient, H), step_norm, gain=gain):
        first = H.diagonal()
        slope = problem.tangent_layout.pack(gradient)
        pinned = np.where(gauge, first, 0.0)
        with progress.watch.phase("descend"):
            while damping <= LARGEST_DAMPING:
                damped = damping * first
                A = add_to_diagonal(H, damped + pinned)
                factor = problem.chordal.symbolic(A).factor(A)
                if factor is not None:
                    step = -factor.solve(slope)
                    candidate = _retract(problem, point, step)
                    lower, following, matrix = problem.normal_equations(candidate)
                    predicted = float(step @ (damped * step - slope))
                    gain = (cost - lower) / predicted if predicted > 0.0 else 0.0
                    if gain > 1e-3 or predicted <= ROUNDING * cost:
                        break
                damping = 10.0 * damping or FIRST_DAMPING
            else:
                progress.status = Status.STALLED
                break
        if predicted <= ROUNDING * cost:
            before = problem.stationarity_of(gradient, H)
            if problem.stationarity_of(following, matrix) < before and lower <= cost * (
                1.0 + 2.0 * ROUNDING
            ):
                point, cost, gradient, H = candidate, lower, following, matrix
                continue
            progress.status = Status.STALLED
            break
        if gain > GOOD_GAIN:
            damping = damping / 10.0 if damping > LEAST_DAMPING else 0.0
        point, cost, gradient, H = candidate, lower, following, matrix
        step_norm = float(np.linalg.norm(step))
    return progress.solution(point, cost)


def _retract(problem: InformationProblem, point: Estimate, step: FloatArray) -> Estimate:
    moves = problem.tangent_layout.unpack(step)
    turned = so.project(so.turned(point.rotations, moves[:, problem.d :]))
    return Estimate.trusted(turned, translations_of(point) + moves[:, : problem.d])
