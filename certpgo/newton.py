"""Damped Newton's method on SE(d)^n or SO(d)^n, with the exact sparse Hessian.

Local: it finds the stationary point near where it starts. Its factorization says that the point is
a local minimum, never that it is the global one.
"""

from __future__ import annotations

import numpy as np

from certpgo.estimate import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.factor import Factor
from certpgo.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.problem import PoseProblem, Problem
from certpgo.solution import Solution, Status

#: Damping, relative to the Hessian's diagonal, at the first sign of trouble.
FIRST_DAMPING = 1e-3
SMALLEST_DAMPING = 1e-9
LARGEST_DAMPING = 1e9
#: A predicted decrease below this many units of rounding of F cannot be seen in F.
ROUNDING = 16 * np.finfo(float).eps


def newton(
    problem: Problem,
    initial: Estimate,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 100,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` to a stationary point.

    Levenberg-Marquardt damping of the Hessian that `operators.pose_hessian` builds; undamped, and
    hence quadratically convergent, near a nondegenerate minimum.

    Parameters
    ----------
    tolerance : stationarity (radians, see `PoseProblem.stationarity`) at which to stop
    watch : stopwatch that has already timed what led to ``initial``
    """
    problem.check(initial)
    point, damping = initial, 0.0
    cost, stationarity = problem.cost(point), problem.stationarity(point)
    step_norm, status = 0.0, Status.ITERATION_LIMIT
    trace: list[Iteration] = []
    watch = watch or Stopwatch()
    for number in range(max_iterations + 1):
        trace.append(Iteration(number, cost, stationarity, step_norm, watch.total))
        if monitor(trace[-1]):
            status = Status.INTERRUPTED
            break
        if stationarity <= tolerance:
            status = Status.CONVERGED
            break
        if number == max_iterations:
            break
        with watch.phase("newton"):
            trial = _step(problem, point, cost, stationarity, damping)
        if trial is None:
            status = Status.STALLED
            break
        point, cost, stationarity, step_norm, damping = trial
    return Solution(
        estimate=point,
        cost=cost,
        status=status,
        iterations=trace[-1].number,
        seconds=watch.seconds,
        trace=tuple(trace),
    )


_Trial = tuple[Estimate, float, float, float, float]


def _step(
    problem: Problem, point: Estimate, cost: float, stationarity: float, damping: float
) -> _Trial | None:
    """The next point with its cost, stationarity, step norm and damping; None at the bottom."""
    g = problem.tangent_gradient(point)
    diagonal, upper = problem.hessian(point, problem.multipliers(point))
    metric = _metric(problem)
    diagonal[0] += np.diag(metric[0])  # the gauge: any definite block at one pose pins it
    H = problem.pattern.assemble(diagonal, upper)
    symbolic = problem.symbolic(H)
    while damping <= LARGEST_DAMPING:
        A = H if damping == 0.0 else add_to_diagonal(H, damping * metric.ravel())
        factor = symbolic.factor(A)
        if factor is not None:
            step, predicted = _newton_step(factor, g, damping * metric)
            candidate = _retract(problem, point, step)
            new_cost = problem.cost(candidate)
            if predicted <= ROUNDING * cost:
                # F can no longer tell; the gradient still can.
                new = problem.stationarity(candidate)
                if new >= stationarity or new_cost > cost + 2 * ROUNDING * cost:
                    return None
                return candidate, new_cost, new, float(np.linalg.norm(step)), 0.0
            gain = (cost - new_cost) / predicted
            if gain > 1e-3:
                relaxed = damping / 10.0 if gain > 0.75 else damping
                if relaxed < SMALLEST_DAMPING:
                    relaxed = 0.0
                norm = float(np.linalg.norm(step))
                return candidate, new_cost, problem.stationarity(candidate), norm, relaxed
        damping = max(10.0 * damping, FIRST_DAMPING if factor is None else SMALLEST_DAMPING * 1e3)
    return None


def _newton_step(factor: Factor, g: FloatArray, damping: FloatArray) -> tuple[FloatArray, float]:
    """The step (n, b) and the decrease of F that its quadratic model predicts."""
    step = -factor.solve(g.ravel()).reshape(g.shape)
    return step, float(-np.sum(g * step) + np.sum(damping * step * step))


def _metric(problem: Problem) -> FloatArray:
    """(n, b) positive diagonal that measures steps: F's own curvature without its coupling."""
    p = so.tangent_dim(problem.d)
    turn = np.repeat(2.0 * problem.rotation.node_weights[:, None], p, axis=1)
    if not isinstance(problem, PoseProblem):
        return turn
    spread = problem.lever_weights[:, None]
    move = np.repeat(problem.translation_weights[:, None], problem.d, axis=1)
    return np.concatenate([move, turn + spread], axis=1)


def _retract(problem: Problem, point: Estimate, step: FloatArray) -> Estimate:
    """The point moved by body-frame turns and world-frame translations."""
    d = problem.d
    if point.translations is None or not isinstance(problem, PoseProblem):
        return Estimate(point.rotations @ so.exp(step))
    turned = point.rotations @ so.exp(step[:, d:])
    return Estimate(turned, point.translations + step[:, :d])
