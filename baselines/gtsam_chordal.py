"""GTSAM's chordal initialization (Carlone et al., ICRA 2015); in 2D LAGO (RSS 2011)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch

from ._baseline import Baseline, Outcome
from ._gtsam import initialization, model_of


@dataclass(frozen=True)
class Chordal(Baseline):
    """InitializePose3 (rotations, then one Gauss-Newton step on the poses), in 2D LAGO.

    An initial estimate is not used. LAGO refuses correlated information, so in 2D such a source is
    an error.

    Attributes
    ----------
    source : path of the problem's file, whose full information is used if GTSAM can read it
    """

    source: str | None = None

    takes_initial: ClassVar[bool] = False

    def ready(
        self, problem: Quadratic, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build the graph with its prior; the function initializes from it."""
        with watch.phase("build"):
            model = model_of(problem, self.source)
            initialize = initialization(model)
        return lambda: Outcome(model, initialize())


SOLVER = Chordal
