"""The trace of iterative methods, and when they stop."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import Any

from certpgo.graph import Estimate
from certpgo.objective.quadratic import CHORDAL
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status


@dataclass
class Progress:
    """The iterations so far, and why they ended."""

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
        converged: bool | None = None,
    ) -> bool:
        """Record a point, see `Iteration`; returns whether the method should continue.

        It has converged if the stationarity is within the tolerance, unless ``converged`` is given.
        """
        number = len(self.trace)
        iteration = Iteration(number, cost, stationarity, step, self.watch.total, gain, accepted)
        self.trace.append(iteration)
        if self.monitor(iteration):
            self.status = Status.INTERRUPTED
        elif stationarity <= self.tolerance if converged is None else converged:
            self.status = Status.CONVERGED
        return self.status is Status.ITERATION_LIMIT and number < self.max_iterations

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self.trace[-1].number

    def solution(self, estimate: Estimate, cost: float, **others: Any) -> Solution:
        """A `Solution` with the status, iterations, seconds and trace so far."""
        return Solution(
            estimate=estimate,
            cost=cost,
            status=self.status,
            iterations=self.steps,
            seconds=self.watch.seconds,
            trace=tuple(self.trace),
            **others,
        )


@dataclass(repr=False)  # Python's signals show their handlers, whose trace may be long
class Stop:
    """A monitor shared by several phases: forwards iterations, and decides when to stop.

    Attributes
    ----------
    monitor : is called with costs in the units of the graph
    unit : factor from the phases' costs to those
    objective : the cost that iterations are about
    deadline : of `time.monotonic`
    watch : stopwatch of all phases
    trace : all iterations
    interrupted : whether the monitor or Ctrl-C requested a stop
    cut : why work was cut short or left out, or None if none was
    """

    monitor: Monitor = silent
    unit: float = 1.0
    objective: str = CHORDAL
    deadline: float = math.inf
    watch: Stopwatch = field(default_factory=Stopwatch)
    trace: list[Iteration] = field(default_factory=list)
    interrupted: bool = False
    cut: Status | None = None

    @property
    def request(self) -> Status | None:
        """Why to stop now, or None."""
        if self.interrupted:
            return Status.INTERRUPTED
        return Status.TIME_LIMIT if time.monotonic() > self.deadline else None

    @property
    def remaining(self) -> float:
        """Seconds until the deadline, infinite without one."""
        return self.deadline - time.monotonic()

    def limit_time(self, seconds: float) -> None:
        """Bring the deadline forward, to at most so many seconds from now."""
        self.deadline = min(self.deadline, time.monotonic() + seconds)

    @contextmanager
    def for_at_most(self, seconds: float = math.inf) -> Iterator[None]:
        """Limit a phase that must leave time for others; at its end the deadline is as before."""
        whole = self.deadline
        self.limit_time(seconds)
        try:
            yield
        finally:
            self.deadline = whole

    @property
    def stop_requested(self) -> bool:
        """Whether to stop, because of the monitor, Ctrl-C or the deadline."""
        return self.request is not None

    def should_stop(self) -> bool:
        """Whether to stop now; if so, the caller leaves work out, and `cut` keeps the reason."""
        self.cut = self.cut or self.request
        return self.stop_requested

    @property
    def ended_by(self) -> Status | None:
        """Why the phases did not end by themselves; None if they did, whatever the time is now."""
        return Status.INTERRUPTED if self.interrupted else self.cut

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle Ctrl-C: stop after this iteration; the second time, immediately."""
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True
        if sys.stderr is not None and sys.stderr.isatty():
            # Not print, which this may have interrupted.
            os.write(sys.stderr.fileno(), b"\nstopping after this step; Ctrl-C again aborts\n")

    def __call__(self, iteration: Iteration) -> bool:
        """Forward an iteration; returns whether to stop."""
        forwarded = self._in_units(iteration, iteration.cost)
        self.trace.append(forwarded)
        return self._heeded(forwarded)

    def of_minorant(self, constant: float) -> Monitor:
        """A monitor of work on a cost that is, plus a constant, nowhere above the phases' cost.

        Its iterations are forwarded with the constant, but they are not part of the trace.
        """

        def forward(iteration: Iteration) -> bool:
            of_phases = self._in_units(iteration, iteration.cost + constant)
            return self._heeded(replace(of_phases, objective=f"a minorant of {self.objective}"))

        return forward

    def _in_units(self, iteration: Iteration, cost: float) -> Iteration:
        return replace(
            iteration,
            number=len(self.trace),
            cost=self.unit * cost,
            seconds=self.watch.total,
            objective=self.objective,
        )

    def _heeded(self, iteration: Iteration) -> bool:
        self.interrupted = self.monitor(iteration) or self.interrupted
        return self.should_stop()

    @contextmanager
    def within(self, time_limit: float | None, *, ctrl_c: bool = True) -> Iterator[None]:
        """Start over: set the deadline and, if Python does, handle Ctrl-C during the block."""
        self.watch, self.trace = Stopwatch(), []
        self.interrupted, self.cut = False, None
        self.deadline = math.inf if time_limit is None else time.monotonic() + time_limit
        main = threading.current_thread() is threading.main_thread()
        if not (ctrl_c and main and callable(signal.getsignal(signal.SIGINT))):
            yield
            return
        before = signal.signal(signal.SIGINT, self.interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


@dataclass
class EarlyStopping:
    """A monitor that stops descents which, at their pace, would stay above the best.

    Attributes
    ----------
    stop : the monitor of all phases
    best : cost that is to be reached
    steps : each as good as the last ones, within which it must be
    over : number of last steps that make the pace; single ones may be short where a saddle is near
    """

    stop: Stop
    best: float
    steps: float
    over: int = 1
    costs: list[float] = field(default_factory=list)

    def __call__(self, iteration: Iteration) -> bool:
        """Forward an iteration; returns whether to stop."""
        if not iteration.accepted:
            return self.stop(iteration)
        self.costs = [*self.costs, iteration.cost][-self.over - 1 :]
        fallen = self.costs[0] - iteration.cost if len(self.costs) > self.over else math.inf
        return self.stop(iteration) or iteration.cost - self.best > self.steps * fallen / self.over
