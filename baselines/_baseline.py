"""The base of other programs' methods: built, run, timed and reported in the package's terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

from ._programs import GTSAM, Program


class Built(Protocol):
    """A problem in another program; the note says which weights it has there."""

    note: str

    def estimate(self, values: Any) -> Estimate:
        """The program's values as an estimate; NumericalError if they are not finite."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run of another program gives.

    Attributes
    ----------
    model : what was run
    values : the program's own; of g2o and Ceres, until the next run
    status, iterations, counts : as in `certpgo.Solution`
    verdict : the program's own, if any
    evaluating : the share of the run's time that went to residuals written in Python
    """

    model: Built
    values: Any
    status: Status = Status.CLOSED_FORM
    iterations: int = 0
    verdict: str = ""
    counts: Mapping[str, int] = field(default_factory=dict)
    evaluating: float = 0.0

    @property
    def estimate(self) -> Estimate:
        """The values as an estimate; NumericalError if they are not finite."""
        return self.model.estimate(self.values)


@dataclass(frozen=True)
class Baseline(Settings):
    """A method of another program; subclasses implement `ready`."""

    program: ClassVar[Program] = GTSAM
    rotations: ClassVar[bool] = False
    own_costs: ClassVar[tuple[str, ...]] = ()
    compiled: ClassVar[bool] = True

    def ready(
        self, problem: Any, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build the program's objects; the returned function runs the method on them.

        The problem is a `Quadratic`, or one under a cost of ``own_costs``.
        """
        raise NotImplementedError

    def prepared(
        self, problem: Quadratic | Sum, initial: Estimate | None = None
    ) -> Callable[[], Outcome]:
        """A function that runs the method alone, for timing.

        Graph and initial values are built before; errors are as in `solve`.
        """
        self._check(problem)
        with self.program.translated():
            step = self.ready(problem, initial, Stopwatch())

        def run() -> Outcome:
            with self.program.translated():
                return step()

        return run

    def solve(
        self,
        problem: Quadratic | Sum,
        *,
        initial: Estimate | None = None,
        monitor: Monitor = silent,
    ) -> Solution:
        """Run the method; the program calls nothing back, so the monitor is not used.

        Phases are ``build`` (the program's graph), ``start`` and ``solve``; the note is the
        program's own verdict if there is one, else which weights it has. Its exceptions become
        NumericalErrors with its text.
        """
        self._check(problem)
        if initial is not None:
            problem.check(initial)
        self.program.library()  # importing it is not timed
        watch = Stopwatch()
        with self.program.translated():
            step = self.ready(problem, initial, watch)
            with watch.phase("solve"):
                outcome = step()
            estimate = outcome.estimate
        seconds = dict(watch.seconds)
        if outcome.evaluating:
            seconds["evaluate"] = outcome.evaluating * seconds["solve"]
            seconds["solve"] -= seconds["evaluate"]
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=outcome.status,
            iterations=outcome.iterations,
            seconds=seconds,
            counts=dict(outcome.counts),
            note=outcome.verdict or outcome.model.note,
        )

    def _check(self, problem: Quadratic | Sum) -> None:
        if isinstance(problem, Sum):
            if problem.cost_name not in self.own_costs:
                raise InputError(f"this method does not minimise {problem.title}")
            return
        require_capable(problem.graph, "isotropic method")
        if not (self.poses if problem.has_positions else self.rotations):
            taken = ("pose graphs, not rotations alone", "rotations alone, not pose graphs")
            raise InputError(f"this method of {self.program.name} takes {taken[not self.poses]}")
