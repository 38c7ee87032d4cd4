"""Gradient descent on the rotation group, with a step rule that converges.

Tron and Vidal (CDC 2009; Moreira 2020, eq. 2.9): R_k <- R_k exp(-step grad_k), grad_k in so(d) the
gradient with respect to a turn of node k. Their step is a constant that must be guessed; here
gradients are divided by each node's own curvature, so that one constant is safe for every graph. It
is slow, and the default is a step found anew every time, after Barzilai and Borwein, and shortened
until it lowers F enough (Armijo), against the average of the costs before (Zhang and Hager 2004),
so that long steps may rise on the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.base import FirstOrder
from certpgo.objective.problem import Problem
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

Rule = Literal["barzilai_borwein", "constant"]

#: The decrease of F to ask for, over that of its tangent, and how a step is shortened.
SUFFICIENT, SHORTER = 1e-4, 0.5
#: How much the costs before weigh in the average that a step must improve.
MEMORY = 0.85
#: Steps in units of a node's own curvature. No curvature is above 2 of them, as the residuals of an
#: edge move by at most as much as its ends together: half a unit lowers F everywhere.
SAFE, SHORTEST, LONGEST = 0.5, 1e-10, 1e6


@dataclass(frozen=True)
class RiemannianGradient(Iterative):
    """Riemannian gradient descent from a spanning tree; translations are kept at their best.

    Local: it ends in the basin it starts in, in many cheap steps.

    Attributes
    ----------
    rule : of the steps: ``"barzilai_borwein"``, or ``"constant"``, the safe one
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    Local: a start that turns once around with the cycle stays with it.

    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> from certpgo import RotationProblem, get_solver
    >>> instance, around = winding_cycle(9, 0.3, 1)
    >>> problem = RotationProblem(instance.graph)
    >>> solution = get_solver("riemannian_gradient")().solve(problem, initial=around)
    >>> solution.cost > 2.0 * problem.cost(instance.truth)
    True
    """

    rule: Rule = "barzilai_borwein"
    tolerance: float = 1e-9
    max_iterations: int = 20_000

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule not in ("barzilai_borwein", "constant"):
            raise SpecError.unknown("rule", self.rule, ("barzilai_borwein", "constant"))

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The stationary point that descent from ``initial`` reaches."""
        watch = Stopwatch()
        graph = problem.graph
        with watch.phase("start"):
            start = initial or compose(graph, spanning_tree(graph, root="center"))
            problem.check(start)
            state = _Descent(problem, problem.settled(start))
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        step, moved = SAFE, 0.0
        average, weight = state.first.cost, 1.0
        while progress.advance(state.first.cost, state.first.stationarity, moved):
            with watch.phase("descent"):
                found = _descended(state, step, average)
            if found is None:
                progress.status = Status.STALLED
                break
            following, taken = found
            step = self._next_step(state, following, taken)
            moved = taken * math.sqrt(state.slope)
            state = following
            older = MEMORY * weight
            weight = older + 1.0
            average = (older * average + state.first.cost) / weight
        estimate = Estimate(state.point.rotations, state.point.translations)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=progress.status,
            iterations=progress.steps,
            seconds=watch.seconds,
            trace=tuple(progress.trace),
        )

    def _next_step(self, before: _Descent, after: _Descent, taken: float) -> float:
        """The first trial after a step of length ``taken``."""
        if self.rule == "constant":
            return SAFE
        # The change of the gradient along the step, in body frames, which turn with the step.
        s = -taken * before.direction
        y = after.gradient - before.gradient
        along = float((s * y).sum())
        if along <= 0.0:
            return min(4.0 * taken, LONGEST)
        length = float((before.curvature * s * s).sum()) / along
        return min(max(length, SHORTEST), LONGEST)


class _Descent:
    """A point, and the direction of steepest descent in the metric of the nodes' curvatures."""

    def __init__(self, problem: Problem, point: Estimate) -> None:
        self.problem, self.point = problem, point
        self.first: FirstOrder = problem.first_order(point)
        self.curvature: FloatArray = 2.0 * problem.curvature[:, None]
        self.gradient: FloatArray = self.first.tangent[:, -so.tangent_dim(problem.d) :]
        self.direction: FloatArray = self.gradient / self.curvature
        self.slope = float((self.gradient * self.direction).sum())

    def moved(self, step: float) -> _Descent:
        """Turned against the gradient, translations settled anew."""
        turned = self.point.rotations @ so.exp(-step * self.direction)
        following = Estimate.trusted(turned, self.point.translations)
        return _Descent(self.problem, self.problem.settled(following))

    @property
    def rounding(self) -> float:
        """What F cannot tell here: residuals are known to rounding of their terms."""
        size = math.sqrt(self.first.cost * self.problem.scale)
        return 16.0 * float(np.finfo(float).eps) * size


def _descended(state: _Descent, step: float, average: float) -> tuple[_Descent, float] | None:
    """The next point and the step that led there; None where no step improves."""
    while step >= SHORTEST:
        following = state.moved(step)
        asked = average - SUFFICIENT * 2.0 * step * state.slope
        if following.first.cost <= asked + state.rounding:
            return following, step
        step *= SHORTER
    return None


SOLVER = RiemannianGradient
