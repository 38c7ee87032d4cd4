"""GTSAM's FastSync: synchronization by one elimination."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch

from ._baseline import Baseline, Outcome
from ._gtsam import library, uniform_model


@dataclass(frozen=True)
class FastSync(Baseline):
    """FastSync on poses or rotations, in 2D and 3D.

    Each measurement has a single isotropic weight, here 2 kappa; tau and an initial estimate are
    not used.
    """

    rotations: ClassVar[bool] = True
    takes_initial: ClassVar[bool] = False

    def ready(
        self, problem: Quadratic, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build the graph; the function synchronizes it."""
        with watch.phase("build"):
            model = uniform_model(problem)
        synchronize = getattr(library(), f"fastSync{model.kind}")
        return lambda: Outcome(model, synchronize(model.graph))


SOLVER = FastSync
