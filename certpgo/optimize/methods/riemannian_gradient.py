"""Gradient descent on the rotation group, with a step rule that converges.

Tron and Vidal (CDC 2009; Moreira 2020, eq. 2.9): R_k <- R_k exp(-step grad_k), grad_k in so(d) the
gradient with respect to the rotation of node k. Their constant step must be guessed; here gradients
are divided by each node's curvature, so that one constant is safe for every graph, but slow. By
default step lengths are those of Barzilai and Borwein, shortened until F decreases sufficiently
(Armijo) relative to an average of previous costs (Zhang and Hager 2004): F may increase at times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.edge_sums import FirstOrder
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

Rule = Literal["barzilai_borwein", "constant"]

#: Sufficient decrease of F, relative to its linear prediction, and factor that shortens a step.
SUFFICIENT, SHORTER = 1e-4, 0.5
#: Weight of the previous costs in the average that a step must improve.
MEMORY = 0.85
#: Step lengths in units of a node's curvature. No curvature exceeds 2 such units, as an edge's
#: residual moves at most as much as both ends together: half a unit always decreases F.
SAFE, SHORTEST, LONGEST = 0.5, 1e-10, 1e6


@dataclass(frozen=True)
class RiemannianGradient(Iterative):
    """Riemannian gradient descent from a spanning tree, with optimal translations.

    Local, in many cheap steps.

    Attributes
    ----------
    rule : of the step length: ``"barzilai_borwein"``, or ``"constant"`` and safe
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    Local: an initial estimate that winds around the cycle once still does at the end.

    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> from certpgo import Quadratic, get_solver
    >>> instance, around = winding_cycle(9, 0.3, 1)
    >>> problem = Quadratic(instance.graph)
    >>> solution = get_solver("riemannian_gradient")().solve(problem, initial=around)
    >>> solution.cost > 2.0 * problem.cost(instance.truth)
    True
    """

    rule: Rule = "barzilai_borwein"
    tolerance: float = 1e-9
    max_iterations: int = 20_000

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The stationary point that descent from ``initial`` reaches."""
        watch = Stopwatch()
        with watch.phase("start"):
            start = initial or tree_initialization(problem.graph)
            problem.check(start)
            state = _Descent(problem, problem.with_optimal_translations(start))
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        step, moved = SAFE, 0.0
        average, weight = state.first.cost, 1.0
        while progress.advance(state.first.cost, state.first.stationarity, moved):
            with watch.phase("descent"):
                found = _line_search(state, step, average)
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
        return progress.solution(estimate, problem.cost(estimate))

    def _next_step(self, before: _Descent, after: _Descent, taken: float) -> float:
        """The first trial after a step of length ``taken``."""
        if self.rule == "constant":
            return SAFE
        # The change of the gradient along the step, in body frames.
        s = -taken * before.direction
        y = after.gradient - before.gradient
        along = float((s * y).sum())
        if along <= 0.0:
            return min(4.0 * taken, LONGEST)
        length = float((before.curvature * s * s).sum()) / along
        return min(max(length, SHORTEST), LONGEST)


class _Descent:
    """A point, and its steepest descent direction in the metric of the nodes' curvatures."""

    def __init__(self, problem: Quadratic, point: Estimate) -> None:
        self.problem, self.point = problem, point
        self.first: FirstOrder = problem.first_order(point)
        weight = np.where(problem.curvature > 0.0, problem.curvature, 1.0)  # 0 of points
        self.curvature: FloatArray = 2.0 * weight[:, None]
        self.gradient: FloatArray = self.first.tangent[:, -so.tangent_dim(problem.d) :]
        self.direction: FloatArray = self.gradient / self.curvature
        self.slope = float((self.gradient * self.direction).sum())

    def moved(self, step: float) -> _Descent:
        """The point after a step of that length, with optimal translations."""
        turned = so.turned(self.point.rotations, -step * self.direction)
        following = Estimate.trusted(turned, self.point.translations)
        return _Descent(self.problem, self.problem.with_optimal_translations(following))

    @property
    def rounding(self) -> float:
        """The uncertainty of F due to rounding of the residuals' terms."""
        size = math.sqrt(self.first.cost * self.problem.scale)
        return 16.0 * float(np.finfo(float).eps) * size


def _line_search(state: _Descent, step: float, average: float) -> tuple[_Descent, float] | None:
    """The next point and its step length; None if no step improves."""
    while step >= SHORTEST:
        following = state.moved(step)
        allowed = average - SUFFICIENT * 2.0 * step * state.slope
        if following.first.cost <= allowed + state.rounding:
            return following, step
        step *= SHORTER
    return None


SOLVER = RiemannianGradient
