"""The thesis' fixed-point refinement of rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg import so
from certpgo.objective.problem import Problem
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status
from certpgo.solvers.eigen_ra import EigenRA


@dataclass(frozen=True)
class FixedPoint(Iterative):
    """R <- projection of Rtilde R, block by block; Moreira 2020, section 4.2.

    Converges to a stationary point of the rotation objective. Starts at EigenRA's answer unless
    told otherwise; with translations, they are the best for the rotations found.

    Attributes
    ----------
    tolerance : stop when no rotation moves farther, radians
    max_iterations : stop anyway

    Examples
    --------
    >>> from certpgo import RotationProblem, get_solver
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> get_solver("fixed_point")(tolerance=1e-9).solve(problem).status.value
    'converged'
    """

    tolerance: float = 1e-8
    max_iterations: int = 1000

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Refined rotations, completed by translations where the problem has them."""
        watch = Stopwatch()
        rotation = problem.rotation
        if initial is None:
            R, _ = EigenRA().rotations_of(rotation, watch)
        else:
            problem.check(initial)
            R = initial.rotations
        degree = (rotation.node_weights + 1.0)[:, None, None]  # Rtilde has identities, too
        trace: list[Iteration] = []
        status, moved = Status.ITERATION_LIMIT, np.inf
        for number in range(self.max_iterations + 1):
            here = Estimate(R)
            G = rotation.gradient(here)
            size = rotation.stationarity(here)
            trace.append(Iteration(number, rotation.cost(here), size, moved, watch.total))
            if monitor(trace[-1]):
                status = Status.INTERRUPTED
                break
            if moved <= self.tolerance:
                status = Status.CONVERGED
                break
            if number == self.max_iterations:
                break
            with watch.phase("fixed point"):
                new = so.project(degree * R - G)  # = Rtilde R, transposed as our frames are
                moved = float(so.angle(np.swapaxes(R, 1, 2) @ new).max())
                R = new
        estimate = problem.complete(R)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=status,
            iterations=trace[-1].number,
            seconds=watch.seconds,
            trace=tuple(trace),
        )


SOLVER = FixedPoint
