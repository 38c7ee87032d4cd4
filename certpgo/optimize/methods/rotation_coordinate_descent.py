"""Parra et al.'s rotation coordinate descent."""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.graph import Estimate
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods._coordinates import Sweeping, stacked
from certpgo.optimize.methods._relaxed import ALONE
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status


@dataclass(frozen=True)
class RotationCoordinateDescent(Sweeping):
    """Block coordinate descent at rank d, without a dense Y; Parra et al., CVPR 2021.

    From the same initial estimate it takes the same steps as `block_coordinate_descent`, in O(d)
    memory per node besides the graph, but to the nearest rotation instead of the polar factor,
    which may be a reflection. Initialized by a spanning tree by default. At rank d there are local
    minima, such as wound-up cycles, that descent from Y = I avoids: certify the result.

    Attributes
    ----------
    tolerance : largest change of a rotation in a sweep at which to stop, radians
    max_iterations : sweeps
    order : ``"colors"``, ``"cyclic"`` or ``"random"``; see `Coordinates`
    seed : of random orders

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("rotation_coordinate_descent")().solve(problem)
    >>> solution.status.value, solution.lower_bound
    ('converged', None)
    """

    tolerance: float = 1e-8
    max_iterations: int = 10_000

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations that no single block can improve, with optimal translations."""
        watch, rotation = Stopwatch(), problem.rotation
        if initial is not None:
            problem.check(initial)
        with watch.phase("start"):
            if initial is None:
                initial = tree_initialization(rotation.graph)
            point = self.coordinates(rotation, stacked(initial))
            cost, _ = point.evaluate()
        trace: list[Iteration] = []
        status = Status.ITERATION_LIMIT
        for sweep in range(1, self.max_iterations + 1):
            with watch.phase("sweeps"):
                decrease, moved = point.sweep()
                cost -= decrease
            trace.append(Iteration(sweep, cost, moved, moved, watch.total))
            if monitor(trace[-1]):
                status = Status.INTERRUPTED
                break
            if moved <= self.tolerance:
                status = Status.CONVERGED
                break
        with watch.phase("rounding"):
            estimate = problem.complete(so.project(point.blocks))
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=status,
            iterations=len(trace),
            seconds=watch.seconds,
            trace=tuple(trace),
            note=f"descent {ALONE}" if problem.has_positions else "",
        )


SOLVER = RotationCoordinateDescent
