"""The base of GTSAM's iterative optimizers: initialization and status."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._baseline import Baseline, Outcome
from ._gtsam import Model, chordal_start, initialization, library, model_of


@dataclass(frozen=True)
class LocalSearch(Baseline):
    """An optimizer of GTSAM with its default settings.

    It gets isotropic information from the weights of F; under GTSAM's own cost, all of it.

    Attributes
    ----------
    source : path of the problem's file, whose full information is used if GTSAM can read it
    start : initialization if no estimate is given: GTSAM's own ``"chordal"`` one, or the vertices
        of the ``"file"``
    max_iterations : GTSAM's default is 100
    """

    optimizer: ClassVar[str]
    own_costs: ClassVar[tuple[str, ...]] = (GtsamCost.name,)

    source: str | None = None
    start: Literal["chordal", "file"] = "chordal"
    max_iterations: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start == "file" and self.source is None:
            raise SpecError("start='file' needs source, the path of the file")
        if self.max_iterations < 1:
            raise SpecError(f"max_iterations must be at least 1, not {self.max_iterations}")

    def ready(
        self,
        problem: Quadratic | Sum,
        initial: Estimate | None,
        watch: Stopwatch,
    ) -> Callable[[], Outcome]:
        """Build graph and initial values; the function constructs the optimizer and runs it."""
        gtsam = library()
        with watch.phase("build"):
            model = model_of(problem, self.source)
        with watch.phase("start"):
            values = self._start(model, problem, initial)
            graph = model.anchored(values)
        parameters = getattr(gtsam, f"{self.optimizer}Params")()
        parameters.setMaxIterations(self.max_iterations)

        def run() -> Outcome:
            # The constructor orders the variables, which is timed too.
            search = getattr(gtsam, f"{self.optimizer}Optimizer")(graph, values, parameters)
            allowed = search.error() + parameters.getAbsoluteErrorTol()
            result = search.optimize()
            return Outcome(model, result, self._status(search, allowed), search.iterations())

        return run

    def _start(self, model: Model, problem: Quadratic | Sum, initial: Estimate | None) -> Any:
        if initial is not None:
            return model.values(initial)
        if self.start == "file":
            if model.file_values is None:
                raise InputError(f"{self.source}: GTSAM does not find a vertex for every node")
            return model.file_values
        if problem.d == 3:
            return initialization(model)()
        # LAGO refuses correlated information, so it gets the isotropic factors.
        return model.values(chordal_start(problem))

    def _status(self, search: Any, allowed: float) -> Status:
        # GTSAM stops silently when a step increases the error, and keeps the step.
        if not search.error() <= allowed:
            return Status.STALLED
        limited = search.iterations() >= self.max_iterations
        return Status.ITERATION_LIMIT if limited else Status.CONVERGED
