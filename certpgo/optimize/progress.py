"""What iterative methods share: their trace, when they end, and how they are told to."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType

from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch
from certpgo.optimize.solution import Status


@dataclass
class Progress:
    """The iterations of a descent so far, and how it ended.

    Attributes
    ----------
    tolerance : stationarity at which to stop
    max_iterations : stop anyway
    watch : stopwatch that times the method
    """

    monitor: Monitor
    tolerance: float
    max_iterations: int
    watch: Stopwatch
    trace: list[Iteration] = field(default_factory=list)
    status: Status = Status.ITERATION_LIMIT

    def advance(
        self,
        cost: float,
        stationarity: float,
        step: float,
        *,
        gain: float | None = None,
        accepted: bool = True,
    ) -> bool:
        """Record a point, see `Iteration`; returns whether the method should go on from it."""
        number = len(self.trace)
        here = Iteration(number, cost, stationarity, step, self.watch.total, gain, accepted)
        self.trace.append(here)
        if self.monitor(here):
            self.status = Status.INTERRUPTED
        elif stationarity <= self.tolerance:
            self.status = Status.CONVERGED
        return self.status is Status.ITERATION_LIMIT and number < self.max_iterations

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self.trace[-1].number


@dataclass
class Stop:
    """The monitor that several phases share: passes iterations on, and knows when to stop.

    Attributes
    ----------
    monitor : is told, in the units of the graph
    unit : what the phases' costs are multiplied by for that
    deadline : of `time.monotonic`
    watch : stopwatch of all phases
    trace : everything recorded
    interrupted : whether the monitor or Ctrl-C has asked to stop
    """

    monitor: Monitor
    unit: float
    deadline: float
    watch: Stopwatch = field(default_factory=Stopwatch)
    trace: list[Iteration] = field(default_factory=list)
    interrupted: bool = False

    @property
    def status(self) -> Status | None:
        """Why to stop now, or None."""
        if self.interrupted:
            return Status.INTERRUPTED
        return Status.TIME_LIMIT if time.monotonic() > self.deadline else None

    @property
    def asked(self) -> bool:
        """Whether to stop, by the monitor, Ctrl-C or the clock."""
        return self.status is not None

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle Ctrl-C: stop at the next occasion; the second time, at once."""
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    def __call__(self, iteration: Iteration) -> bool:
        """Pass an iteration on; whether to stop."""
        told = replace(
            iteration,
            number=len(self.trace),
            cost=self.unit * iteration.cost,
            seconds=self.watch.total,
        )
        self.trace.append(told)
        self.interrupted = self.monitor(told) or self.interrupted
        return self.asked


@contextmanager
def stoppable(monitor: Monitor, unit: float, time_limit: float | None) -> Iterator[Stop]:
    """A stop that also listens to Ctrl-C, where Python handles it."""
    deadline = math.inf if time_limit is None else time.monotonic() + time_limit
    stop = Stop(monitor, unit, deadline)
    main = threading.current_thread() is threading.main_thread()
    if not main or not callable(signal.getsignal(signal.SIGINT)):
        yield stop
        return
    before = signal.signal(signal.SIGINT, stop.interrupt)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
