"""Damped Newton's method on SE(d)^n or SO(d)^n, with the exact sparse Hessian.

Local: it finds the stationary point near where it starts. Its factorization says that the point is
a local minimum, never that it is the global one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.estimate import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.cg import conjugate_gradients
from certpgo.linalg.factor import Factor
from certpgo.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.problem import PoseProblem, Problem
from certpgo.solution import Solution, Status

#: Damping, in units of the metric: after an indefinite Hessian, after a step that did not improve,
#: and the ends of the range.
FIRST_DAMPING, SECOND_DAMPING = 1e-3, 1e-6
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-9, 1e9
#: Conjugate gradients on an old factor: relative residuals asked for, and products allowed.
LOOSEST, TIGHTEST = 1e-2, 1e-8
MAX_PRODUCTS = 20
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
    state = _State(initial, problem.cost(initial), problem.stationarity(initial))
    status = Status.ITERATION_LIMIT
    trace: list[Iteration] = []
    watch = watch or Stopwatch()
    for number in range(max_iterations + 1):
        here = Iteration(number, state.cost, state.stationarity, state.step_norm, watch.total)
        trace.append(here)
        if monitor(here):
            status = Status.INTERRUPTED
            break
        if state.stationarity <= tolerance:
            status = Status.CONVERGED
            break
        if number == max_iterations:
            break
        with watch.phase("newton"):
            following = _advance(problem, state)
        if following is None:
            status = Status.STALLED
            break
        state = following
    return Solution(
        estimate=state.point,
        cost=state.cost,
        status=status,
        iterations=trace[-1].number,
        seconds=watch.seconds,
        trace=tuple(trace),
    )


@dataclass(frozen=True, eq=False)
class _State:
    """A point on the way, with what the next step can use."""

    point: Estimate
    cost: float
    stationarity: float
    step_norm: float = 0.0
    damping: float = 0.0
    factor: Factor | None = None  # of a Hessian passed on the way


@dataclass(frozen=True, eq=False)
class _Model:
    """The quadratic model F(point) + 2 g x + x H x, and the metric that damps its steps."""

    g: FloatArray
    H: CSC
    metric: FloatArray


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A step (N,) with the decrease of F that the model predicts, and how it was found."""

    step: FloatArray
    predicted: float
    damping: float
    factor: Factor


def _advance(problem: Problem, state: _State) -> _State | None:
    """The next point; None when no step improves on this one."""
    model = _model(problem, state.point)
    for proposal in _proposals(problem, model, state):
        if not np.isfinite(proposal.step).all():
            continue
        candidate = _retract(problem, state.point, proposal.step)
        cost = problem.cost(candidate)
        norm = float(np.linalg.norm(proposal.step))
        if proposal.predicted <= ROUNDING * state.cost:
            # F can no longer tell; the gradient still can.
            stationarity = problem.stationarity(candidate)
            if stationarity >= state.stationarity or cost > (1.0 + 2.0 * ROUNDING) * state.cost:
                return None
            return _State(candidate, cost, stationarity, norm, 0.0, proposal.factor)
        gain = (state.cost - cost) / proposal.predicted
        if gain > 1e-3:
            damping = proposal.damping / 10.0 if gain > 0.75 else proposal.damping
            damping = damping if damping >= SMALLEST_DAMPING else 0.0
            stationarity = problem.stationarity(candidate)
            return _State(candidate, cost, stationarity, norm, damping, proposal.factor)
    return None


def _model(problem: Problem, point: Estimate) -> _Model:
    diagonal, upper = problem.hessian(point, problem.multipliers(point))
    metric = _metric(problem)
    diagonal[0] += np.diag(metric[0])  # the gauge: any definite block at one pose pins it
    H = problem.pattern.assemble(diagonal, upper)
    return _Model(problem.tangent_gradient(point).ravel(), H, metric.ravel())


def _proposals(problem: Problem, model: _Model, state: _State) -> Iterator[_Proposal]:
    """Newton steps: by an old factor if it still serves, else by new ones, damped more and more."""
    g, H = model.g, model.H
    if state.factor is not None and state.damping == 0.0:
        tol = min(LOOSEST, max(TIGHTEST, state.stationarity))
        solved = conjugate_gradients(
            H, -g, state.factor.solve, tol=tol, max_iterations=MAX_PRODUCTS
        )
        if solved is not None:
            step, residual = solved
            yield _Proposal(step, float(step @ (residual - g)), 0.0, state.factor)
    symbolic, damping = problem.symbolic(H), state.damping
    while damping <= LARGEST_DAMPING:
        damped = damping * model.metric
        factor = symbolic.factor(add_to_diagonal(H, damped))
        if factor is not None:
            step = -factor.solve(g)
            yield _Proposal(step, float(step @ (damped * step - g)), damping, factor)
        damping = max(10.0 * damping, FIRST_DAMPING if factor is None else SECOND_DAMPING)


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
    step = step.reshape(problem.n, -1)
    if point.translations is None or not isinstance(problem, PoseProblem):
        return Estimate(point.rotations @ so.exp(step))
    turned = point.rotations @ so.exp(step[:, d:])
    return Estimate(turned, point.translations + step[:, :d])
