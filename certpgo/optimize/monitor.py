"""Monitors, which are called with each iteration, and timing, which leaves them out."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol, TextIO

from certpgo.objective.quadratic import CHORDAL


@dataclass(frozen=True, slots=True)
class Iteration:
    """One step of an iterative method.

    Attributes
    ----------
    number : 0 for the initial estimate
    cost : objective F there
    gradient : norm of the Riemannian gradient, relative to the problem's scale, or what else tells
        a method how far it has to go; infinite if nothing does
    step : norm of the step that led here (radians and scaled translations together)
    seconds : solver time so far, without monitoring
    gain : actual over predicted decrease of F, for trust-region methods
    accepted : whether the last step was accepted; a rejected one leaves the point unchanged
    objective : the cost that is minimised, as a certificate names it

    Examples
    --------
    >>> from certpgo import Iteration
    >>> Iteration(number=0, cost=13.8, gradient=0.1, step=0.0, seconds=0.0).cost
    13.8
    """

    number: int
    cost: float
    gradient: float
    step: float
    seconds: float
    gain: float | None = None
    accepted: bool = True
    objective: str = CHORDAL


class Monitor(Protocol):
    """Is called with each iteration; returns True to stop the method at its current point.

    Examples
    --------
    Record the costs, and stop at the second step:

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import cycle
    >>> import numpy as np
    >>> costs = []
    >>> def monitor(iteration):
    ...     costs.append(iteration.cost)
    ...     return iteration.number == 2
    >>> problem = certpgo.Quadratic(cycle(20, 0.5, np.random.default_rng(0)).graph)
    >>> solution = certpgo.get_solver("riemannian_gradient")().solve(problem, monitor=monitor)
    >>> solution.status.value, len(costs)
    ('interrupted', 3)
    """

    def __call__(self, iteration: Iteration) -> bool:
        """Whether the method should stop here."""
        ...


def silent(iteration: Iteration) -> bool:
    """Shows nothing and never stops."""
    return False


@dataclass(slots=True)
class TableMonitor:
    """Prints one line per iteration, under a heading that names the cost.

    Attributes
    ----------
    stream : where to print, stderr by default
    """

    stream: TextIO | None = None
    _shown: str = field(default="", init=False, repr=False)

    def __call__(self, iteration: Iteration) -> bool:
        """Print the iteration; never stop."""
        stream = self.stream or sys.stderr
        is_other = iteration.objective != self._shown
        if is_other:
            is_chordal = iteration.objective == CHORDAL
            stream.write(f"{'the chordal cost F' if is_chordal else iteration.objective}\n")
        if is_other or iteration.number == 0:
            heads = f"{'it':>4} {'cost':>22} {'gradient':>10} {'step':>10} {'gain':>9} {'s':>8}"
            stream.write(f"{heads}\n")
        self._shown = iteration.objective
        gradient, step = _brief(iteration.gradient), _brief(iteration.step)
        gain = "" if iteration.gain is None else f"{iteration.gain:.3g}"
        rejected = "" if iteration.accepted else "  rejected"
        stream.write(
            f"{iteration.number:4d} {iteration.cost:22.15g} {gradient:>10} "
            f"{step:>10} {gain:>9} {iteration.seconds:8.3f}{rejected}\n"
        )
        return False


def _brief(value: float) -> str:
    """A number for a column; nothing where a method has none."""
    return f"{value:.2e}" if math.isfinite(value) else ""


@dataclass(slots=True)
class Stopwatch:
    """Wall-clock seconds by named phase; nested phases are not counted twice.

    Attributes
    ----------
    seconds : phase name to seconds
    """

    seconds: dict[str, float] = field(default_factory=dict)
    _inner: list[float] = field(default_factory=list, repr=False)
    _since: float = field(default=0.0, repr=False)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time of the ``with`` block, less its nested phases, to ``name``."""
        start = time.perf_counter()
        if not self._inner:
            self._since = start
        self._inner.append(0.0)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            nested = self._inner.pop()
            self.seconds[name] = self.seconds.get(name, 0.0) + elapsed - nested
            if self._inner:
                self._inner[-1] += elapsed

    @property
    def total(self) -> float:
        """Seconds of all phases together, so far."""
        running = time.perf_counter() - self._since - sum(self._inner) if self._inner else 0.0
        return sum(self.seconds.values()) + running
