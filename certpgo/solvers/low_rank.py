"""Low-rank optimization: a Riemannian trust region on St(r, d)^n, translations eliminated."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from certpgo import spectral
from certpgo.errors import SpecError
from certpgo.estimate import Estimate
from certpgo.lift import Lift, Point, lifted, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.cg import End, conjugate_gradients
from certpgo.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.problem import Problem
from certpgo.reduced import Reduced
from certpgo.solution import Solution, Status
from certpgo.solvers._iterative import Iterative

#: Trust region, in radians at a typical node: the first radius and the largest.
FIRST_RADIUS, LARGEST_RADIUS = 1.0, 10.0
#: A step is taken when it gains this part of what the model predicts; the region shrinks below the
#: second and grows above the third.
ACCEPTED, POOR, GOOD = 0.01, 0.25, 0.75
#: Conjugate gradients: the gradient is reduced by this factor, or by its own size.
LOOSEST = 0.1
MAX_PRODUCTS = 500
#: A predicted decrease below this many units of rounding of F cannot be seen in F.
ROUNDING = 16 * np.finfo(float).eps
#: Halvings of a step along a given direction.
MAX_HALVINGS = 40


@dataclass(frozen=True, eq=False)
class Descent:
    """Where low-rank optimization ended."""

    point: Lift
    cost: float
    status: Status
    trace: tuple[Iteration, ...]
    counts: dict[str, int]


def descend(
    problem: Problem,
    initial: Point,
    rank: int,
    *,
    direction: FloatArray | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 500,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
    reduced: Reduced | None = None,
) -> Descent:
    """Minimise F over St(rank, d)^n from ``initial``, by truncated Newton steps.

    Absil, Baker, Gallivan (2007); Rosen et al. (SE-Sync, IJRR 2019), section 4.2, whose
    preconditioner is used: a factor of M, shifted.

    Parameters
    ----------
    initial : a point of at most that rank
    direction : (n, d) rows by which the blocks leave along a new dimension first, such as an
        eigenvector of the certificate matrix with a negative eigenvalue: at a stationary point of
        lower rank there is no other way down
    tolerance : stationarity (radians) at which to stop
    watch : stopwatch that has already timed what led to ``initial``
    reduced : the factor of Q, if it is at hand
    """
    watch = watch or Stopwatch()
    counts: Counter[str] = Counter()
    trace: list[Iteration] = []
    status = Status.ITERATION_LIMIT
    with watch.phase("low rank"):
        Q = reduced or Reduced(problem)
        start = problem.settled(lifted(initial, rank))
        if direction is not None:
            start = leave(problem, start, direction)
        here = _Tangent(problem, Q, start)
        typical = math.sqrt(float(problem.rotation.node_weights.sum()))
    radius, step_norm = FIRST_RADIUS * typical, 0.0
    for number in range(max_iterations + 1):
        trace.append(Iteration(number, here.cost, here.stationarity, step_norm, watch.total))
        if monitor(trace[-1]):
            status = Status.INTERRUPTED
            break
        if here.stationarity <= tolerance:
            status = Status.CONVERGED
            break
        if number == max_iterations:
            break
        with watch.phase("low rank"):
            solved = conjugate_gradients(
                here.hessian,
                -here.gradient.ravel(),
                here.precondition,
                tol=min(LOOSEST, here.stationarity),
                max_iterations=MAX_PRODUCTS,
                radius=radius,
            )
            counts["products"] += solved.products
            predicted = float(solved.x @ (solved.residual - here.gradient.ravel()))
            there = _Tangent(problem, Q, here.retract(solved.x))
        if predicted <= ROUNDING * here.cost:
            # F can no longer tell; the gradient still can.
            if there.stationarity >= here.stationarity:
                status = Status.STALLED
                break
            gain = 1.0
        else:
            gain = (here.cost - there.cost) / predicted
        at_boundary = solved.end in (End.BOUNDARY, End.NEGATIVE_CURVATURE)
        if gain < POOR:
            radius *= 0.25
        elif gain > GOOD and at_boundary:
            radius = min(2.0 * radius, LARGEST_RADIUS * typical)
        if gain > ACCEPTED:
            here, step_norm = there, float(np.linalg.norm(solved.x))
        elif radius < 1e-12 * typical:
            status = Status.STALLED
            break
    return Descent(here.point, here.cost, status, tuple(trace), dict(counts))


class _Tangent:
    """A point with what a step from it needs: gradient, Hessian, preconditioner, retraction."""

    def __init__(self, problem: Problem, Q: Reduced, point: Lift) -> None:
        self._problem, self._Q = problem, Q
        self.point = point
        self.cost = problem.cost(point)
        Y = point.rotations
        G = problem.gradient(point)[:, :, -problem.d :]
        self._multipliers = _symmetric(np.swapaxes(Y, 1, 2) @ G)
        self.gradient = self._projected(G)
        norms = np.linalg.norm(self.gradient.reshape(problem.n, -1), axis=1)
        self.stationarity = float((norms / problem.curvature).max())

    def hessian(self, x: FloatArray) -> FloatArray:
        """The Riemannian Hessian of F/2: V -> proj(Q V - V Lam)."""
        V = x.reshape(self.gradient.shape)
        QV = _blocks(self._Q @ _columns(V), V.shape) - self._Q.shift * V
        return self._projected(QV - V @ self._multipliers).ravel()

    def precondition(self, x: FloatArray) -> FloatArray:
        """V -> proj((Q + shift I)^-1 V)."""
        V = x.reshape(self.gradient.shape)
        return self._projected(_blocks(self._Q.solve(_columns(V)), V.shape)).ravel()

    def retract(self, x: FloatArray) -> Lift:
        """The nearest point of the manifold, translations settled."""
        V = x.reshape(self.gradient.shape)
        return _moved(self._problem, self.point, V)

    def _projected(self, Z: FloatArray) -> FloatArray:
        Y = self.point.rotations
        return np.asarray(Z - Y @ _symmetric(np.swapaxes(Y, 1, 2) @ Z))


def leave(problem: Problem, point: Lift, direction: FloatArray) -> Lift:
    """The point moved along its last, empty dimension as far as F decreases.

    Parameters
    ----------
    direction : (n, d) rows v_i; block i moves from [Y_i; 0] towards [Y_i; v_i], which is tangent
    """
    V = np.zeros_like(point.rotations)
    V[:, -1, :] = direction / np.linalg.norm(direction, axis=1).max()
    best, cost = point, problem.cost(point)
    step = 1.0
    for _ in range(MAX_HALVINGS):
        candidate = _moved(problem, point, step * V)
        lower = problem.cost(candidate)
        if lower < cost:
            best, cost = candidate, lower
        elif best is not point:
            break
        step *= 0.5
    return best


def _moved(problem: Problem, point: Lift, V: FloatArray) -> Lift:
    return problem.settled(Lift(_orthonormal(point.rotations + V), point.translations))


def _orthonormal(Z: FloatArray) -> FloatArray:
    """Polar factors of blocks (n, r, d)."""
    values, vectors = np.linalg.eigh(np.swapaxes(Z, 1, 2) @ Z)
    root = (vectors / np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(Z @ root)


def _symmetric(A: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (A + np.swapaxes(A, 1, 2)))


def _columns(V: FloatArray) -> FloatArray:
    """Blocks (n, r, d) as the matrix V^T (dn, r)."""
    return np.swapaxes(V, 1, 2).reshape(-1, V.shape[1])


def _blocks(X: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    n, r, d = shape
    return np.swapaxes(X.reshape(n, d, r), 1, 2)


@dataclass(frozen=True)
class LowRank(Iterative):
    """Burer and Monteiro's method for the semidefinite relaxation, rounded to an estimate.

    Attributes
    ----------
    rank : r >= d; by default d + 1
    seed : start at a random point instead of the eigenvectors
    tolerance : stop when no node's gradient over its weight is larger, radians
    max_iterations : stop anyway
    """

    tolerance: float = 1e-10
    max_iterations: int = 500
    rank: int | None = None
    seed: int | None = None

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The estimate nearest to the point reached, with the best translations for it.

        Raises
        ------
        SpecError
            The rank is below the dimension of space.
        """
        rank = problem.d + 1 if self.rank is None else self.rank
        if rank < problem.d:
            raise SpecError(f"the rank must be at least {problem.d} here, not {rank}")
        watch = Stopwatch()
        with watch.phase("start"):
            start = initial or self._start(problem, rank)
        found = descend(
            problem,
            start,
            rank,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
            monitor=monitor,
            watch=watch,
        )
        with watch.phase("round"):
            estimate = problem.complete(rounded(found.point).rotations)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=found.status,
            iterations=found.trace[-1].number,
            seconds=watch.seconds,
            trace=found.trace,
            counts=found.counts,
            note=f"rank {rank}, F {found.cost:.10g} before rounding",
        )

    def _start(self, problem: Problem, rank: int) -> Point:
        if self.seed is None:
            return spectral.spectral_start(problem)
        rng = np.random.default_rng(self.seed)
        Y = _orthonormal(rng.standard_normal((problem.n, rank, problem.d)))
        return Lift(Y, np.zeros((problem.n, rank)))


SOLVER = LowRank
