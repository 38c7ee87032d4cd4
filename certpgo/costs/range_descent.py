"""Descent on graphs with measured distances, at any rank, and the way out of saddles."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from certpgo.costs.ranges import RangeProblem
from certpgo.costs.signed import SignedProblem
from certpgo.errors import NumericalError
from certpgo.graph.lift import Lift, Point, lifted, translations_of
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, divided, pinned
from certpgo.linalg.eigen import krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.optimize.low_rank import lowest_of_halvings, orthonormal
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.newton import ROUNDING
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Status

#: Least and largest damping, relative to the diagonal; the least also fixes the gauge.
LEAST, LARGEST = 1e-9, 1e9
#: Damping after a rejected step.
FIRST = 1e-4
#: Actual over predicted decrease from which a step is accepted, and the damping reduced.
ACCEPTED, GOOD = 1e-3, 0.5
#: Relative decrease of a step below which the exact Hessian is tried.
SLOW = 0.3
#: Shifts that make a scaled certificate matrix definite.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(20))
#: Relative accuracy of escape directions, and how many more than the gauge's are computed.
ACCURACY, MORE = 1e-3, 2
#: Negative eigenvalues above minus this, of a matrix of unit diagonal, may be rounding.
RESOLUTION = 1e-13


class _Step(NamedTuple):
    """The last step's actual over predicted decrease, and whether it was accepted."""

    gain: float | None
    accepted: bool


_FIRST, _REJECTED = _Step(0.0, True), _Step(None, False)


class _State:
    """A point with its gradient and matrices."""

    def __init__(self, problem: RangeProblem, point: Lift) -> None:
        self.problem, self.point = problem, point
        self.cost = problem.cost(point)
        G, d = problem.gradient(point), problem.d
        self.multipliers = problem.whole.constrained(G[:, :, -d:], point.rotations)
        self.basis = problem.whole.tangent_basis(point.rotations)
        turn = np.einsum("nqrd,nrd->nq", self.basis, G[:, :, -d:])
        self.layout = problem.layout(point.rank)
        self.gradient = self.layout.pack(np.concatenate([G[:, :, 0], turn], axis=1))

    def matrix(self, *, exact: bool) -> CSC:
        """The Hessian of f/2, or its Gauss-Newton approximation."""
        lam = self.multipliers if exact else None
        return self.problem.hessian(self.point, self.basis, lam)

    def moved(self, x: FloatArray) -> Lift:
        """The point after a step."""
        step, r = self.layout.unpack(x), self.point.rank
        V = np.einsum("nq,nqrd->nrd", step[:, r:], self.basis)
        t = translations_of(self.point) + step[:, :r]
        return Lift(orthonormal(self.point.rotations + V), t)


def descend(
    problem: RangeProblem,
    initial: Point,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 400,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> tuple[Lift, Status]:
    """The end of Levenberg and Marquardt's method at the rank of ``initial``, and how it ended.

    The Gauss-Newton matrix far away, the exact Hessian near the end.

    Parameters
    ----------
    tolerance : of the step that would follow, relative to the cost, at which to stop
    max_iterations : accepted and rejected steps after which to stop
    """
    state = _State(problem, lifted(initial, initial.rotations.shape[1]))
    progress = Progress(monitor, tolerance, max_iterations, watch or Stopwatch())
    damping, exact, remaining, last = LEAST, False, math.inf, _FIRST
    while progress.advance(state.cost, remaining, 0.0, gain=last.gain, accepted=last.accepted):
        if damping > LARGEST:
            progress.status = Status.STALLED
            break
        factor = _factor(problem, state, exact, damping)
        if factor is None:
            damping, exact, last = damping if exact else 10.0 * damping, False, _REJECTED
            continue
        x = -factor.solve(state.gradient)
        predicted = float(-state.gradient @ x)
        candidate = _State(problem, state.moved(x))
        if predicted <= ROUNDING * state.cost:
            best = candidate if candidate.cost <= state.cost else state
            return best.point, Status.CONVERGED
        gain = (state.cost - candidate.cost) / predicted
        if not gain > ACCEPTED:
            damping, last = max(10.0 * damping, FIRST), _REJECTED
            continue
        remaining, last = math.sqrt(predicted / state.cost), _Step(gain, True)
        exact = exact or state.cost - candidate.cost < SLOW * state.cost
        damping = max(LEAST, damping / 10.0 if gain > GOOD else damping)
        state = candidate
    return state.point, progress.status


def _factor(problem: RangeProblem, state: _State, exact: bool, damping: float) -> Factor | None:
    H = state.matrix(exact=exact)
    size = state.layout.unpack(np.abs(H.diagonal()))
    # Of positions and of turns by themselves, as their ratio depends on the unit of length.
    r = state.point.rank
    largest = np.repeat([size[:, :r].max(), size[:, r:].max()], [r, size.shape[1] - r])
    # Each position's mean: entries of single coordinates depend on how the world is turned.
    size[:, :r] = size[:, :r].mean(axis=1, keepdims=True)
    least = state.layout.pack(np.maximum(size, 1e-12 * largest))
    A = add_to_diagonal(H, damping * least)
    return problem.symbolic(A).factor(A)


def escape(
    problem: RangeProblem, point: Point, asked: Callable[[], bool] = lambda: False
) -> Lift | None:
    """A lower point of the next rank; None where the certificate matrix has no way down.

    Along an eigenvector of a negative eigenvalue of the pose graph's certificate matrix there (see
    `RangeProblem.surrogate`), whose curvature in a new dimension is that of f.

    Parameters
    ----------
    asked : whether to stop; called before each factorization and each solve

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop.
    """
    below, _ = problem.surrogate(point)
    G = problem.gradient(point)[:, :, -problem.d :]
    S = below.certificate_matrix(below.constrained(G, point.rotations))
    layout = below.pattern.layout_of(S)
    moved = int(layout.sizes.max()) - problem.d
    S = pinned(S, layout.first_row(0) + np.arange(moved))
    weights = problem.whole.matrix.diagonal()
    root = np.sqrt(np.maximum(weights, np.finfo(float).tiny))
    A = divided(S, root)
    # The motions of the whole have eigenvalue zero, and must not hide the one that is looked for.
    value, v = _smallest(below, A, point.rotations.shape[1] + MORE, asked)
    if value > -RESOLUTION:
        return None
    direction = layout.unpack(v / root)
    direction[0, :moved] = 0.0
    return _leave(problem, point, below.rising(direction))


def _smallest(
    below: SignedProblem, A: CSC, pairs: int, asked: Callable[[], bool]
) -> tuple[float, FloatArray]:
    """The smallest eigenvalue, of as many that are computed together, and its vector."""
    for shift in SHIFTS:
        _refuse_to_go_on(asked)
        shifted = add_to_diagonal(A, shift)
        factor = below.symbolic(shifted).factor(shifted)
        if factor is None:
            continue

        def solve(B: FloatArray, factor: Factor = factor) -> FloatArray:
            _refuse_to_go_on(asked)
            return factor.solve(B)

        start = np.random.default_rng(0).standard_normal((A.shape[0], pairs))
        found = krylov_schur(shifted, solve, pairs, shift=shift, tol=ACCURACY, start=start)
        return float(found.values[0]), found.vectors[:, 0]
    raise NumericalError("the certificate matrix could not be factorized, even when shifted")


def _refuse_to_go_on(asked: Callable[[], bool]) -> None:
    if asked():
        raise NumericalError("stopped before a way down was found")


def _leave(problem: RangeProblem, point: Point, rising: Lift) -> Lift | None:
    """The point moved into new dimensions as far as f decreases; None if it does not."""
    start = lifted(point, point.rotations.shape[1] + rising.rank)
    V, w = np.zeros_like(start.rotations), np.zeros_like(translations_of(start))
    V[:, -rising.rank :], w[:, -rising.rank :] = rising.rotations, translations_of(rising)
    size = float(np.linalg.norm(V, axis=(1, 2)).max())
    reach = float(np.linalg.norm(translations_of(start), axis=1).max())
    step = min(1.0 / max(size, 1e-300), reach / max(float(np.abs(w).max()), 1e-300))

    def moved(step: float) -> Lift:
        return Lift(orthonormal(start.rotations + step * V), translations_of(start) + step * w)

    return lowest_of_halvings(problem.cost, moved, step, problem.cost(start))
