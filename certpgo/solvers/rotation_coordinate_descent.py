"""Parra et al.'s rotation coordinate descent."""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.graph import Estimate
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg import so
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status
from certpgo.solvers._coordinates import Sweeping, stacked
from certpgo.solvers._relaxed import ALONE


@dataclass(frozen=True)
class RotationCoordinateDescent(Sweeping):
    """Block coordinate descent at rank d, without a dense Y; Parra et al., CVPR 2021.

    From the same estimate it takes the very steps of `block_coordinate_descent`, in O(d) memory a
    node besides the graph; a step takes the nearest rotation, not the polar factor, which may be a
    reflection. It starts from rotations composed along a spanning tree unless told otherwise. At
    rank d there are local minima, such as wound-up cycles, that a start from Y = I does not know:
    judge what it returns.

    Attributes
    ----------
    tolerance : stop when no rotation moves farther in a sweep, radians
    max_iterations : sweeps
    order : ``"colors"``, ``"cyclic"`` or ``"random"``; see `Coordinates`
    seed : of random orders

    Examples
    --------
    >>> from certpgo import RotationProblem, get_solver
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("rotation_coordinate_descent")().solve(problem)
    >>> solution.status.value, solution.lower_bound
    ('converged', None)
    """

    tolerance: float = 1e-8
    max_iterations: int = 10_000

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations that no block improves alone, completed by translations."""
        watch, rotation = Stopwatch(), problem.rotation
        if initial is not None:
            problem.check(initial)
        with watch.phase("start"):
            if initial is None:
                initial = compose(rotation.graph, spanning_tree(rotation.graph, root="center"))
            point = self.coordinates(rotation, stacked(initial))
            cost, _ = point.evaluate()
        trace: list[Iteration] = []
        status = Status.ITERATION_LIMIT
        for sweep in range(1, self.max_iterations + 1):
            with watch.phase("sweeps"):
                fallen, moved = point.sweep()
                cost -= fallen
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
            note=f"descent {ALONE}" if isinstance(problem, PoseProblem) else "",
        )


SOLVER = RotationCoordinateDescent
