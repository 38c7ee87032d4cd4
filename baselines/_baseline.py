"""The base of GTSAM's baselines: built, run, timed and reported in the package's terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

from ._gtsam import Model, library, translated


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run of GTSAM gives; the note is its own verdict, if any."""

    values: Any
    status: Status = Status.CLOSED_FORM
    iterations: int = 0
    note: str = ""
    counts: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Baseline(Settings):
    """A method of GTSAM; subclasses implement `ready`."""

    rotations: ClassVar[bool] = False
    own_costs: ClassVar[tuple[str, ...]] = ()
    compiled: ClassVar[bool] = True

    def ready(
        self, problem: Any, initial: Estimate | None, watch: Stopwatch
    ) -> tuple[Model, Callable[[], Outcome]]:
        """Build GTSAM's objects; the returned function runs the method on them.

        The problem is a `Problem`, or one under a cost of ``own_costs``.
        """
        raise NotImplementedError

    def prepared(
        self, problem: Quadratic | Sum, initial: Estimate | None = None
    ) -> Callable[[], Any]:
        """A function that runs the method alone, for timing, and returns GTSAM's Values.

        Graph and initial values are built before; errors are as in `solve`.
        """
        self._check(problem)
        with translated():
            _, step = self.ready(problem, initial, Stopwatch())

        def run() -> Any:
            with translated():
                return step().values

        return run

    def solve(
        self,
        problem: Quadratic | Sum,
        *,
        initial: Estimate | None = None,
        monitor: Monitor = silent,
    ) -> Solution:
        """Run the method; GTSAM calls nothing back, so the monitor is not used.

        Phases are ``build`` (GTSAM's graph), ``start`` and ``solve``; the note is GTSAM's own
        verdict if there is one, else the information that the factors used. GTSAM's exceptions
        become NumericalErrors with its text.
        """
        self._check(problem)
        if initial is not None:
            problem.check(initial)
        library()  # importing it is not timed
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

    def _check(self, problem: Quadratic | Sum) -> None:
        if isinstance(problem, Sum):
            if problem.cost_name not in self.own_costs:
                raise InputError(f"this method does not minimise {problem.title}")
            return
        require_capable(problem.graph, "isotropic method")
        if not (self.poses if problem.has_positions else self.rotations):
            taken = ("pose graphs, not rotations alone", "rotations alone, not pose graphs")
            raise InputError(f"this method of GTSAM takes {taken[not self.poses]}")
