"""The loop of all descents: propose a step, and accept it by what it gains over what was predicted.

A step rule proposes steps from the quadratic model of the cost at a point, and learns from what
became of them: Newton's with eliminated translations (`certpgo.optimize.riemannian_newton`), that
of Levenberg and Marquardt (`certpgo.optimize.levenberg_marquardt`), and truncated Newton's at
points of any rank (`certpgo.optimize.low_rank_descent`).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.threads import one_thread
from certpgo.objective.quadratic_model import CostAtPoint
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Status

AnyHere = TypeVar("AnyHere", bound=CostAtPoint)


class Proposal(NamedTuple):
    """A step.

    Attributes
    ----------
    step : (N,) the step; None if it could not be computed
    predicted : the decrease of the cost that the model promises
    reused : whether it is by the factor of an earlier model, so that a new one may do better
    """

    step: FloatArray | None
    predicted: float = 0.0
    reused: bool = False


class Gain(NamedTuple):
    """What became of an accepted step.

    Attributes
    ----------
    proposal : the step
    ratio : actual over predicted decrease; None if rounding hides it
    before, after : the stationarities at its ends
    """

    proposal: Proposal
    ratio: float | None
    before: float
    after: float


class StepRule(Protocol):
    """What proposes steps, and learns from what became of them."""

    #: Phase of the stopwatch.
    phase: str
    #: Actual over predicted decrease from which a step is accepted.
    least_gain: float
    #: Whether a failed step counts as an iteration.
    counts_failures: bool

    def stationarity(self, here: Any) -> float:
        """How far a point is from being stationary."""

    def has_converged(self, here: Any, stationarity: float) -> bool | None:
        """Whether to stop; None if the tolerance of the stationarity decides."""

    def propose(self, here: Any) -> Proposal | None:
        """The next step to try; None if there is no other."""

    def accepted(self, here: Any, there: Any, gain: Gain) -> None:
        """Learn from a step that led there."""

    def rejected(self, here: Any, proposal: Proposal) -> bool:
        """Learn from a step that failed; returns whether others are worth trying."""


class _Step(NamedTuple):
    """The length of the last step, its actual over predicted decrease, whether it was accepted."""

    length: float = 0.0
    gain: float | None = None
    accepted: bool = True


@one_thread
def minimise(here: AnyHere, rule: StepRule, progress: Progress) -> AnyHere:
    """The last model of a descent from that of its start; ``progress`` has how it ended."""
    with progress.watch.phase(rule.phase):
        stationarity = rule.stationarity(here)
    last = _Step()
    while progress.advance(
        here.cost,
        stationarity,
        last.length,
        gain=last.gain,
        accepted=last.accepted,
        converged=rule.has_converged(here, stationarity),
    ):
        with progress.watch.phase(rule.phase):
            found = _next(here, stationarity, rule)
        if found is None:
            progress.status = Status.STALLED
            break
        here, stationarity, last = found
    return here


def _next(
    here: AnyHere, stationarity: float, rule: StepRule
) -> tuple[AnyHere, float, _Step] | None:
    """The point after a step, its stationarity and the step; None if there is none."""
    while (proposal := rule.propose(here)) is not None:
        step, predicted, reused = proposal
        ratio = None
        if step is not None and np.isfinite(step).all():
            there = here.moved(step)
            if not predicted <= here.rounding:
                ratio = (here.cost - there.cost) / predicted
                fits = ratio > rule.least_gain
                ahead = rule.stationarity(there) if fits else stationarity
            else:
                # The decrease is below rounding of the cost; the gradient still shows progress.
                ahead = rule.stationarity(there)
                fits = there.cost <= here.cost + 2.0 * here.rounding and ahead < stationarity
                if not (fits or reused):
                    return None
            if fits:
                rule.accepted(here, there, Gain(proposal, ratio, stationarity, ahead))
                return there, ahead, _Step(float(np.linalg.norm(step)), ratio)
        if not rule.rejected(here, proposal):
            return None
        if rule.counts_failures:
            return here, stationarity, _Step(0.0, ratio, accepted=False)
    return None
