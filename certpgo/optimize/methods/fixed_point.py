"""The thesis' fixed-point refinement of rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.methods.eigen_ra import EigenRA
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution


@dataclass(frozen=True)
class FixedPoint(Iterative):
    """R <- projection of Rtilde R, block by block; Moreira 2020, section 4.2.

    Initialized by EigenRA by default. Where it converges, the limit is a stationary point of the
    rotation objective; the thesis says that it always does, but it can also end in two points that
    alternate, of a higher cost than where it began: Rtilde need not be positive semidefinite.
    Translations, if any, are optimal for the rotations.

    Attributes
    ----------
    tolerance : largest change of a rotation at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> get_solver("fixed_point")(tolerance=1e-9).solve(problem).status.value
    'converged'
    """

    tolerance: float = 1e-8
    max_iterations: int = 1000

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Refined rotations, with optimal translations if the problem has any."""
        watch = Stopwatch()
        rotation = problem.rotation
        if initial is None:
            R, _ = EigenRA().rotations_of(rotation, watch)
        else:
            problem.check(initial)
            R = initial.rotations
        degree = (rotation.node_weights + 1.0)[:, None, None]  # Rtilde has diagonal identities
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        point, moved = Estimate(R), np.inf
        while progress.advance(
            rotation.cost(point),
            rotation.stationarity(point),
            moved,
            converged=moved <= self.tolerance,
        ):
            with watch.phase("fixed point"):
                new = so.project(degree * R - rotation.gradient(point))  # Rtilde R, transposed
                moved = float(so.angle(np.swapaxes(R, 1, 2) @ new).max())
                R, point = new, Estimate(new)
        estimate = problem.complete(R)
        return progress.solution(estimate, problem.cost(estimate))


SOLVER = FixedPoint
