"""The Riemannian staircase: lower and lower points of a relaxation, of rising rank.

Boumal (2015); Rosen et al. (SE-Sync, IJRR 2019). If the certificate matrix of a stationary point
has a negative eigenvalue, its vector is a way down in new dimensions, where descent begins again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.relaxed_point import Lift, Point, lifted, translations_of
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, divided, pinned
from certpgo.linalg.eigen import krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.curvature import negative_curvature, resolution
from certpgo.optimize.descent_loop import minimise
from certpgo.optimize.levenberg_marquardt import DampedSteps
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.progress import Progress, Stop
from certpgo.optimize.solution import Level, Status

#: Stationarity, radians, and steps of a descent at one rank, where translations are eliminated.
TOLERANCE, STEPS = 1e-8, 100
#: The same of Levenberg and Marquardt's method: bounds of such costs need all digits.
STATIONARY, MOST = 1e-11, 400
#: Shifts that make a scaled certificate matrix definite.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(20))
STOPPED = "stopped before a way down was found"
#: Relative accuracy of escape directions, and how many more than the gauge's are computed.
ACCURACY, MORE = 1e-3, 2
#: Negative eigenvalues above minus this, of a matrix of unit diagonal, may be rounding.
RESOLUTION = 1e-13

#: Problems whose translations move with their rotations.
Climbing = SimilarityProblem | LiftedDistances


@dataclass(frozen=True, eq=False)
class Stair:
    """The end of descent at one rank.

    Attributes
    ----------
    point : stationary, if it converged
    cost : the cost there
    status : how the descent ended
    """

    point: Lift
    cost: float
    status: Status

    @property
    def level(self) -> Level:
        """The rank, with what was reached there."""
        return Level(self.point.rank, self.cost, self.status)


def climb(
    problem: Problem | LiftedDistances,
    start: Point,
    highest: int,
    stop: Stop,
    monitor: Monitor | None = None,
) -> Iterator[Stair]:
    """The ends of descents at rising ranks, until there is no way down or a stop is requested.

    Parameters
    ----------
    start : stationary if its rank is d; above, the first descent begins there
    highest : the largest rank
    monitor : of the descents, where it is not ``stop``

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop before a way down was found.
    """
    following: Lift | None
    if start.rotations.shape[1] > problem.d:
        following = Lift(start.rotations, start.translations)
    else:
        following = way_down(problem, start, stop)
    while following is not None and following.rank <= highest:
        end = _minimised(problem, following, stop, monitor or stop)
        yield end
        if end.status is Status.INTERRUPTED:
            return
        following = way_down(problem, end.point, stop)


def way_down(problem: Problem | LiftedDistances, point: Point, stop: Stop) -> Lift | None:
    """A lower point of the next rank; None where the certificate matrix has no way down.

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop.
    """
    with stop.watch.phase("escape"):
        if not problem.eliminates:
            return escape(cast("Climbing", problem), point, stop.should_stop)
        form = cast("Problem", problem)
        eigenvalue, direction = negative_curvature(form, point)
        if -eigenvalue <= resolution(form):
            return None
        above = lifted(point, point.rotations.shape[1] + 1)
        return low_rank.leave(form, form.with_optimal_translations(above), direction)


def _minimised(
    problem: Problem | LiftedDistances, start: Lift, stop: Stop, monitor: Monitor
) -> Stair:
    """The end of descent at the rank of a point."""
    if problem.eliminates:
        found = low_rank.descend(
            cast("Problem", problem),
            start,
            start.rank,
            tolerance=TOLERANCE,
            max_iterations=STEPS,
            monitor=monitor,
            watch=stop.watch,
        )
        return Stair(found.point, found.cost, found.status)
    progress = Progress(monitor, STATIONARY, MOST, stop.watch)
    here = cast("Climbing", problem).linearized(start)
    end = minimise(here, DampedSteps(here), progress)
    return Stair(end.point, end.cost, stop.request or progress.status)


def escape(
    problem: Climbing,
    point: Point,
    asked: Callable[[], bool] = lambda: False,
) -> Lift | None:
    """A lower point of the next rank, where translations are not eliminated; None without one.

    Along an eigenvector of a negative eigenvalue of the certificate matrix of the problem that
    touches the cost there, whose curvature in a new dimension is that of the cost.

    Parameters
    ----------
    asked : whether to stop; called before each factorization and each solve
    """
    here = problem.blocks(point)
    below, _ = next(problem.tangents(here))
    S = below.certificate_matrix(problem.multipliers(here))
    layout = below.pattern.layout_of(S)
    moved = int(layout.sizes.max()) - problem.d
    S = pinned(S, layout.first_row(problem.root) + np.arange(moved))
    root = np.sqrt(np.maximum(problem.row_weights, np.finfo(float).tiny))
    A = divided(S, root)
    # The motions of the whole have eigenvalue zero, and must not hide the one that is looked for.
    value, v = smallest_eigenpair(below, A, here.rank + MORE, asked)
    if value > -RESOLUTION:
        return None
    rows = layout.unpack(v / root)
    rows[problem.root, :moved] = 0.0
    return _leave(problem, here, below.rising(rows))


def smallest_eigenpair(
    below: PoseProblem, A: CSC, pairs: int, asked: Callable[[], bool]
) -> tuple[float, FloatArray]:
    """The smallest eigenvalue, of as many that are computed together, and its vector."""
    for shift in SHIFTS:
        if asked():
            raise NumericalError(STOPPED)
        shifted = add_to_diagonal(A, shift)
        factor = below.symbolic(shifted).factor(shifted)
        if factor is None:
            continue

        def solve(B: FloatArray, factor: Factor = factor) -> FloatArray:
            if asked():
                raise NumericalError(STOPPED)
            return factor.solve(B)

        start = np.random.default_rng(0).standard_normal((A.shape[0], pairs))
        found = krylov_schur(shifted, solve, pairs, shift=shift, tol=ACCURACY, start=start)
        return float(found.values[0]), found.vectors[:, 0]
    raise NumericalError("the certificate matrix could not be factorized, even when shifted")


def _leave(problem: Climbing, here: Lift, rising: Lift) -> Lift | None:
    """The point moved into new dimensions as far as its cost decreases; None if it does not."""
    start = lifted(here, here.rank + rising.rank)
    V, w = np.zeros_like(start.rotations), np.zeros_like(translations_of(start))
    V[:, -rising.rank :], w[:, -rising.rank :] = rising.rotations, translations_of(rising)
    size = float((np.linalg.norm(V, axis=(1, 2)) / problem.sizes_of(here.rotations)).max())
    reach = float(np.linalg.norm(translations_of(start), axis=1).max())
    step = min(1.0 / max(size, 1e-300), reach / max(float(np.abs(w).max()), 1e-300))

    def moved(step: float) -> Lift:
        blocks = problem.retracted(start.rotations + step * V, here.rotations)
        return Lift(blocks, translations_of(start) + step * w)

    return low_rank.lowest_of_halvings(problem.cost, moved, step, problem.cost(start))
