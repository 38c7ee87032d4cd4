"""Levenberg and Marquardt's method, for any cost that gives its quadratic model at a point.

A step solves (H + damping diag(scale)) x = -g. H is the Gauss-Newton matrix far from a minimum and
the exact Hessian near it, where the cost has one. The damping is zero until a step fails. A factor
serves later steps as long as they converge fast.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.objective.quadratic_model import QuadraticModel
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

#: Damping above which the method stops, relative to the scale.
LARGEST_DAMPING = 1e9
#: Damping below which none is tried: a whole step may be too long where 1e-9 is right.
LEAST_DAMPING = 1e-12
#: Actual over predicted decrease from which a step is accepted, and the damping reduced.
MIN_GAIN, GOOD_GAIN = 1e-3, 0.5
#: A factor serves the next step, too, where its last one reduced the stationarity by this factor.
FAST = 0.5
#: Relative decrease of a step below which the exact Hessian is tried.
SLOW = 0.3


class Modelled(Protocol):
    """A problem whose cost has quadratic models."""

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph by an InputError."""

    def linearized(self, point: Any) -> QuadraticModel:
        """The model at an estimate."""

    def estimate_of(self, point: Any) -> Estimate:
        """The nearest estimate to the end of a descent."""


AnyModel = TypeVar("AnyModel", bound=QuadraticModel)


class _Step(NamedTuple):
    """The length of the last step, its actual over predicted decrease, whether it was accepted."""

    length: float
    gain: float | None
    accepted: bool


_FIRST, _REJECTED = _Step(0.0, None, True), _Step(0.0, None, False)


def descend(
    problem: Modelled,
    start: Estimate,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 600,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``start`` to a stationary point of the problem's cost.

    Parameters
    ----------
    tolerance : stationarity at which to stop, see `QuadraticModel.stationarity`
    max_iterations : accepted and rejected steps after which to stop
    watch : stopwatch that already timed the initialization

    Raises
    ------
    InputError
        An estimate of another graph.
    """
    problem.check(start)
    progress = Progress(monitor, tolerance, max_iterations, watch or Stopwatch())
    end = minimise(problem.linearized(start), progress)
    return progress.solution(problem.estimate_of(end.point), end.cost)


def minimise(here: AnyModel, progress: Progress) -> AnyModel:
    """The last model of a descent from that of its start; ``progress`` has how it ended."""
    damping, exact, factor, last = 0.0, False, None, _FIRST
    with progress.watch.phase("descend"):
        scale = here.scale(here.gauss_newton)
        stationarity = here.stationarity(scale)
    while progress.advance(
        here.cost, stationarity, last.length, gain=last.gain, accepted=last.accepted
    ):
        if damping > LARGEST_DAMPING:
            progress.status = Status.STALLED
            break
        reused = factor is not None
        with progress.watch.phase("descend"):
            if factor is None:
                H = here.hessian if exact else here.gauss_newton
                scale = here.scale(H)
                damped = damping * scale
                factor = here.factor(add_to_diagonal(H, damped + here.gauge * scale))
            if factor is None:
                damping, exact, last = here.raised(damping), False, _REJECTED
                continue
            step = -factor.solve(here.gradient)
            if not np.isfinite(step).all():
                factor, last = None, _REJECTED
                damping = damping if reused else here.raised(damping)
                continue
            there = here.moved(step)
        predicted = float(step @ (damped * step - here.gradient))
        # Where the decrease is below rounding of the cost, the gradient may still show progress.
        gain = None
        if not predicted <= here.rounding:
            gain = float((here.cost - there.cost) / predicted)
            if not gain > MIN_GAIN:
                factor, last = None, _REJECTED
                damping = damping if reused else here.raised(damping)
                continue
        with progress.watch.phase("descend"):
            ahead = there.stationarity(scale)
        risen = not there.cost <= here.cost + 2.0 * here.rounding
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
        exact = exact or here.cost - there.cost < SLOW * here.cost
        last = _Step(float(np.linalg.norm(step)), gain, True)
        here, stationarity = there, ahead
    return here
