"""Newton's method on SE(d)^n or SO(d)^n, with exact sparse Hessians and translations eliminated.

Three things make it converge in a handful of steps from far away. After every step the
translations are solved for again (variable projection), so that turning a long stretch of poses
as one body costs nothing, as linear moves of its translations would. Where the exact curvature is
negative, Gauss and Newton's takes its place, which never is, for as long as such steps pay. And a
factorization serves as preconditioner of the steps after it while few products suffice.

Local: it finds the stationary point near where it starts. Its factorization says that the point is
a local minimum, never that it is the global one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.cg import End, conjugate_gradients
from certpgo.linalg.factor import Factor
from certpgo.objective.base import FirstOrder
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

#: After a Gauss-Newton step that lowered F by less than this part, the exact Hessian is tried.
PAYING = 0.5
#: So it is where a node's own step would be smaller than this angle.
NEAR = 1e-3
#: Gauss-Newton steps stand in for an indefinite Hessian while the last one lowered F by this part.
SLOW = 1e-3
#: Damping, in units of the metric: after an indefinite Hessian, after a step that did not improve,
#: and the ends of the range.
FIRST_DAMPING, SECOND_DAMPING = 1e-3, 1e-6
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-9, 1e9
#: Conjugate gradients on an old factor: relative residuals asked for, and products that cost less
#: than a new factor.
LOOSEST, TIGHTEST = 0.1, 1e-6
MAX_PRODUCTS = 8
#: Nodes from which a new factor costs more than twice as many, so that any old one is tried first.
LARGE = 20_000
#: A predicted decrease below this many units of rounding of F cannot be seen in F.
ROUNDING = 16 * np.finfo(float).eps


def newton(
    problem: Problem,
    initial: Estimate,
    *,
    tolerance: float = 1e-12,
    max_iterations: int = 100,
    near: bool = False,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` to a stationary point.

    Parameters
    ----------
    tolerance : stationarity (radians, see `FirstOrder`) at which to stop
    near : the start is in a basin's core, so that the exact Hessian is tried at once
    watch : stopwatch that has already timed what led to ``initial``
    """
    problem.check(initial)
    watch = watch or Stopwatch()
    work = _Work(_metric(problem))
    state = _State(initial, problem.first_order(initial), exact=near)
    progress = Progress(monitor, tolerance, max_iterations, watch)
    while not progress.ends(state.cost, state.stationarity, state.step_norm):
        with watch.phase("newton"):
            following = _advance(problem, state, work)
        if following is None:
            progress.status = Status.STALLED
            break
        state = following
    return Solution(
        estimate=Estimate(state.point.rotations, state.point.translations),
        cost=state.cost,
        status=progress.status,
        iterations=progress.steps,
        seconds=watch.seconds,
        trace=tuple(progress.trace),
        counts=dict(work.counts),
    )


def forcing_term(progress: float) -> float:
    """The relative residual to ask of a step after one that took the part ``progress`` off F.

    F falls by the square of the distance, which Newton's steps square.
    """
    return min(LOOSEST, max(TIGHTEST, math.sqrt(max(progress, 0.0))))


@dataclass(frozen=True, eq=False)
class _State:
    """A point on the way, with what the next step can use."""

    point: Estimate
    first: FirstOrder
    step_norm: float = 0.0
    exact: bool = False  # whether the last step was Newton's, not Gauss and Newton's
    progress: float = np.inf  # the part of F that it took off
    damping: float = 0.0

    @property
    def cost(self) -> float:
        return self.first.cost

    @property
    def stationarity(self) -> float:
        return self.first.stationarity


@dataclass
class _Work:
    """What outlives a step: the last factor, how well it still serves, and what was done."""

    metric: FloatArray  # (n, b) diagonal in which damping is measured
    factor: Factor | None = None
    pace: float = np.inf  # nats a product by which conjugate gradients last fell with the factor
    counts: Counter[str] = field(default_factory=Counter)


class _Model:
    """The quadratic model F(point) + 2 g x + x H x."""

    def __init__(self, problem: Problem, state: _State, metric: FloatArray) -> None:
        self._problem, self._state, self._metric = problem, state, metric
        self.g = state.first.tangent.ravel()

    @cached_property
    def hessian(self) -> CSC:
        """The exact Riemannian Hessian of F/2."""
        return self._matrix(self._state.first.multipliers)

    @cached_property
    def gauss_newton(self) -> CSC:
        """The same without the curvature of the residuals: definite but for the gauge."""
        return self._matrix(np.zeros_like(self._state.first.multipliers))

    def _matrix(self, multipliers: FloatArray) -> CSC:
        diagonal, upper = self._problem.hessian(self._state.point, multipliers)
        diagonal[0] += np.diag(self._metric[0])  # the gauge: any definite block at one pose pins it
        return self._problem.pattern.assemble(diagonal, upper)


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A step (N,) with the decrease of F that the model predicts, and how it was found."""

    step: FloatArray
    predicted: float
    exact: bool
    damping: float


def _advance(problem: Problem, state: _State, work: _Work) -> _State | None:
    """The next point; None when no step improves on this one."""
    for proposal in _proposals(problem, state, work):
        if not np.isfinite(proposal.step).all():
            continue
        candidate = _retract(problem, state.point, proposal.step)
        first = problem.first_order(candidate)
        cost = first.cost
        gain = (state.cost - cost) / proposal.predicted if proposal.predicted > 0.0 else 0.0
        # Below rounding F can no longer tell; the gradient still can.
        invisible = proposal.predicted <= ROUNDING * state.cost
        if not invisible and not gain > 1e-3:
            continue
        damping = proposal.damping / 10.0 if gain > 0.75 else proposal.damping
        following = _State(
            candidate,
            first,
            step_norm=float(np.linalg.norm(proposal.step)),
            exact=proposal.exact,
            progress=(state.cost - cost) / state.cost if state.cost > 0.0 else 0.0,
            damping=damping if damping >= SMALLEST_DAMPING and not invisible else 0.0,
        )
        risen = cost > (1.0 + 2.0 * ROUNDING) * state.cost
        if invisible and (risen or following.stationarity >= state.stationarity):
            return None
        return following
    return None


def _proposals(problem: Problem, state: _State, work: _Work) -> Iterator[_Proposal]:
    """Steps: by an old factor if it still serves, else by new ones, damped more and more."""
    model = _Model(problem, state, work.metric)
    g, metric = model.g, work.metric.ravel()
    exact = state.exact or state.progress < PAYING or state.stationarity < NEAR
    tol = forcing_term(state.progress)
    expected = -math.log(tol) / work.pace
    large = problem.n >= LARGE
    most = 2 * MAX_PRODUCTS if large else MAX_PRODUCTS
    settled = (state.exact or large) and state.damping == 0.0
    if work.factor is not None and settled and expected <= most:
        H = model.hessian if exact else model.gauss_newton
        solved = conjugate_gradients(
            H.__matmul__, -g, work.factor.solve, tol=tol, max_iterations=most
        )
        work.counts["products"] += solved.products
        if solved.end is End.CONVERGED:
            predicted = float(solved.x @ (solved.residual - g))
            work.pace = -math.log(tol) / solved.products
            yield _Proposal(solved.x, predicted, exact, 0.0)
        elif solved.end is End.NEGATIVE_CURVATURE:
            exact = exact and state.progress < SLOW
    damping = state.damping
    while damping <= LARGEST_DAMPING:
        H = model.hessian if exact else model.gauss_newton
        damped = damping * metric
        work.factor, work.pace = None, np.inf  # its memory serves the next
        work.factor = factor = problem.symbolic(H).factor(
            add_to_diagonal(H, damped) if damping > 0.0 else H
        )
        work.counts["factorizations"] += 1
        if factor is not None:
            step = -factor.solve(g)
            yield _Proposal(step, float(step @ (damped * step - g)), exact, damping)
        elif exact and state.progress >= SLOW:
            exact = False
            continue
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
    """The point moved by body-frame turns, and its translations settled anew."""
    turns = step.reshape(problem.n, -1)[:, -so.tangent_dim(problem.d) :]
    turned = point.rotations @ so.exp(turns)
    if point.translations is None or not isinstance(problem, PoseProblem):
        return Estimate.trusted(turned)
    moves = step.reshape(problem.n, -1)[:, : problem.d]
    return problem.settled(Estimate.trusted(turned, point.translations + moves))
