"""Levenberg and Marquardt's method, for any cost that gives its quadratic model at a point.

A step solves (H + damping diag(scale)) x = -g. H is the Gauss-Newton matrix far from a minimum and
the exact Hessian near it, where the cost has one. The damping is zero until a step fails. A factor
serves later steps as long as they converge fast.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.factor import LinearSolver
from certpgo.objective.quadratic_model import QuadraticModel
from certpgo.optimize.descent_loop import Gain, Proposal, minimise
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

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
    here = problem.linearized(start)
    end = minimise(here, DampedSteps(here), progress)
    return progress.solution(problem.estimate_of(end.point), end.cost)


class DampedSteps:
    """Steps (H + damping diag(scale)) x = -g, whose factor serves as long as they converge fast."""

    phase, least_gain, counts_failures = "descend", MIN_GAIN, True

    def __init__(self, start: QuadraticModel) -> None:
        self._damping, self._exact = 0.0, False
        self._factor: LinearSolver | None = None
        self._scale = start.scale(start.gauss_newton)
        self._damped = np.zeros_like(self._scale)

    def stationarity(self, here: QuadraticModel) -> float:
        """The largest gradient, in units of the curvature where the last factor is from."""
        return here.stationarity(self._scale)

    def has_converged(self, here: QuadraticModel, stationarity: float) -> None:
        """The tolerance decides."""

    def propose(self, here: QuadraticModel) -> Proposal | None:
        """A step by the factor, or a new one; None if the damping is too large."""
        if self._damping > LARGEST_DAMPING:
            return None
        reused = self._factor is not None
        if self._factor is None:
            H = here.hessian if self._exact else here.gauss_newton
            self._scale = here.scale(H)
            self._damped = self._damping * self._scale
            self._factor = here.factor(add_to_diagonal(H, self._damped + here.gauge * self._scale))
        if self._factor is None:
            self._exact = False
            return Proposal(None)
        step = -self._factor.solve(here.gradient)
        return Proposal(step, float(step @ (self._damped * step - here.gradient)), reused)

    def accepted(self, here: QuadraticModel, there: QuadraticModel, gain: Gain) -> None:
        """Keep the factor after a good step, and reduce the damping."""
        if self._damping > 0.0 or not gain.after < FAST * gain.before:
            self._factor = None
        if gain.ratio is not None and gain.ratio > GOOD_GAIN:
            self._damping = self._damping / 10.0 if self._damping > LEAST_DAMPING else 0.0
        self._exact = self._exact or here.cost - there.cost < SLOW * abs(here.cost)

    def rejected(self, here: QuadraticModel, proposal: Proposal) -> bool:
        """Raise the damping, unless an old factor may be the reason."""
        self._factor = None
        if not proposal.reused:
            self._damping = here.raised(self._damping)
        return True
