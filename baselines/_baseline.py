"""What every baseline of GTSAM is: made ready, run, timed and told in the package's terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

from ._gtsam import Model, library, translated


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step of GTSAM gives: values, how it ended, what it did, and its own verdict if any."""

    values: Any
    status: Status = Status.CLOSED_FORM
    iterations: int = 0
    note: str = ""
    counts: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Baseline:
    """A method of GTSAM on a problem; subclasses say how it is made ready."""

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = False

    def ready(
        self, problem: Problem, initial: Estimate | None, watch: Stopwatch
    ) -> tuple[Model, Callable[[], Outcome]]:
        """Build GTSAM's objects; the call returned runs the method on them."""
        raise NotImplementedError

    def prepared(self, problem: Problem, initial: Estimate | None = None) -> Callable[[], Any]:
        """The method's step alone, for timing: graph and start are built before.

        Returns
        -------
        A call without arguments that runs the step anew each time and returns GTSAM's Values; a
        failure is a NumericalError as in `solve`.
        """
        self._check(problem)
        with translated():
            _, step = self.ready(problem, initial, Stopwatch())

        def run() -> Any:
            with translated():
                return step().values

        return run

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Run the method; GTSAM cannot be watched, so the monitor is told nothing.

        Returns
        -------
        Solution with seconds by phase: ``build`` (GTSAM's graph), ``start``, ``solve``; its note
        is GTSAM's own verdict where it gives one, else which information the factors carried.

        Raises
        ------
        InputError
            A kind of problem that the method does not take, or an initial estimate of another one.
        MissingDependency
            GTSAM is not installed.
        NumericalError
            GTSAM gave up; the text is its own.
        """
        self._check(problem)
        if initial is not None:
            problem.check(initial)
        library()  # its import is nobody's phase
        watch = Stopwatch()
        with translated():
            model, step = self.ready(problem, initial, watch)
            with watch.phase("solve"):
                outcome = step()
            estimate = model.estimate(outcome.values)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=outcome.status,
            iterations=outcome.iterations,
            seconds=dict(watch.seconds),
            counts=dict(outcome.counts),
            note=outcome.note or model.note,
        )

    def _check(self, problem: Problem) -> None:
        if not (self.poses if isinstance(problem, PoseProblem) else self.rotations):
            taken = ("pose graphs, not rotations alone", "rotations alone, not pose graphs")
            raise InputError(f"this method of GTSAM takes {taken[not self.poses]}")
