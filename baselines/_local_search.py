"""What GTSAM's iterative optimizers share: where they start and how their end is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate
from certpgo.objective.problem import Problem
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._baseline import Baseline, Outcome
from ._gtsam import Model, initialization, isotropic_model, library, model_of

STARTS = ("chordal", "file")


@dataclass(frozen=True)
class LocalSearch(Baseline):
    """An optimizer of GTSAM with its default settings.

    Attributes
    ----------
    source : path of the file that the problem was read from; its full information is then used
        where GTSAM can read it
    start : where to start when no initial estimate is given: GTSAM's own ``"chordal"``
        initialization, or the vertices of the ``"file"``
    max_iterations : GTSAM's default is 100

    Raises
    ------
    SpecError
        An unknown start, a start from the file without a source, no iterations.
    """

    optimizer: ClassVar[str]

    source: str | None = None
    start: str = "chordal"
    max_iterations: int = 100

    def __post_init__(self) -> None:
        if self.start not in STARTS:
            raise SpecError.unknown("start", self.start, STARTS)
        if self.start == "file" and self.source is None:
            raise SpecError("start='file' needs source, the path of the file")
        if self.max_iterations < 1:
            raise SpecError(f"max_iterations must be at least 1, not {self.max_iterations}")

    def ready(
        self, problem: Problem, initial: Estimate | None, watch: Stopwatch
    ) -> tuple[Model, Callable[[], Outcome]]:
        """Build graph and start; the call constructs the optimizer and runs it."""
        gtsam = library()
        with watch.phase("build"):
            model = model_of(problem, self.source)
        with watch.phase("start"):
            values = self._start(model, problem, initial)
            graph = model.anchored(values)
        parameters = getattr(gtsam, f"{self.optimizer}Params")()
        parameters.setMaxIterations(self.max_iterations)

        def run() -> Outcome:
            # The constructor orders the variables, which counts.
            search = getattr(gtsam, f"{self.optimizer}Optimizer")(graph, values, parameters)
            allowed = search.error() + parameters.getAbsoluteErrorTol()
            result = search.optimize()
            return Outcome(result, self._status(search, allowed), search.iterations())

        return model, run

    def _start(self, model: Model, problem: Problem, initial: Estimate | None) -> Any:
        if initial is not None:
            return model.values(initial)
        if self.start == "file":
            if model.file_values is None:
                raise InputError(f"{self.source}: GTSAM finds no vertex for every node")
            return model.file_values
        if problem.d == 3:
            return initialization(model)()
        # LAGO refuses correlated information, so it starts from the isotropic factors.
        simple = isotropic_model(problem)
        return model.values(simple.estimate(initialization(simple)()))

    def _status(self, search: Any, allowed: float) -> Status:
        # GTSAM stops without a word when a step raises the error, and keeps the step.
        if not search.error() <= allowed:
            return Status.STALLED
        limited = search.iterations() >= self.max_iterations
        return Status.ITERATION_LIMIT if limited else Status.CONVERGED
