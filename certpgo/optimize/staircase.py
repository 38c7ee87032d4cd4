"""The Riemannian staircase: lower and lower points of a relaxation, of rising rank.

Boumal (2015); Rosen et al. (SE-Sync, IJRR 2019). If the certificate matrix of a stationary point
has a negative eigenvalue, its vector is a way down in new dimensions, where descent begins again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, NamedTuple, cast

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.relaxed_point import Lift, Point, lifted, translations_of
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, divided, pinned
from certpgo.linalg.eigen import krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.objective.lifting import REAL
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.curvature import negative_curvature, resolution
from certpgo.optimize.descent_loop import minimise
from certpgo.optimize.levenberg_marquardt import DampedSteps
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.progress import Progress, Stop
from certpgo.optimize.solution import Level, Status

#: Stationarity, radians, and steps of a descent at one rank.
CLOSE = {"tolerance": 1e-8, "max_iterations": 100}
#: Shifts that make a scaled certificate matrix definite.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(20))
STOPPED = "stopped before a way down was found"
#: Relative accuracy of escape directions, and how many more than the gauge's are computed.
ACCURACY, MORE = 1e-3, 2
#: Negative eigenvalues above minus this, of a matrix of unit diagonal, may be rounding.
RESOLUTION = 1e-13

#: Problems that points of any rank have a cost of.
Climbing = Quadratic | LiftedDistances


@dataclass(frozen=True, eq=False)
class Stair:
    """The end of descent at one rank.

    Attributes
    ----------
    point : stationary, if it converged
    cost : the cost there
    status : how the descent ended
    counts : of its work, where rows rise
    """

    point: Lift
    cost: float
    status: Status
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def level(self) -> Level:
        """The rank, with what was reached there."""
        return Level(self.point.rank, self.cost, self.status)


class WayDown(NamedTuple):
    """Where descent at a higher rank begins.

    Attributes
    ----------
    eigenvalue : the smallest one of the certificate matrix
    point : of that rank or a lower one
    rank : the higher rank
    direction : (n, d) of the first step, see `low_rank_descent.leave`; None if that was made
    """

    eigenvalue: float
    point: Point
    rank: int
    direction: FloatArray | None = None


def climb(
    problem: Climbing,
    start: Point,
    highest: int,
    stop: Stop,
    monitor: Monitor | None = None,
    *,
    accuracy: Callable[[], Mapping[str, Any]] = lambda: CLOSE,
    goes_on: Callable[[Point, float], bool] | None = None,
    next_point: Callable[[Stair], Point] = attrgetter("point"),
) -> Iterator[Stair]:
    """The ends of descents at rising ranks, until there is no way down or a stop is requested.

    Parameters
    ----------
    start : stationary if its rank is d; above, the first descent begins there
    highest : the largest rank
    monitor : of the descents, where it is not ``stop``
    accuracy : of a descent; is called before each. Where rows rise, it may have all parameters
        of `certpgo.optimize.low_rank_descent.descend`, else the tolerance and steps
    goes_on : is called with a point and the smallest eigenvalue of the certificate matrix there,
        before a descent from it; by default, that follows if the eigenvalue is negative beyond
        rounding
    next_point : where the next descent begins, by default at the end of the last one

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop before a way down was found.
    """
    monitor = monitor or stop
    noise = resolution(cast("Quadratic", problem)) if _rows_rise(problem) else RESOLUTION
    goes_on = goes_on or (lambda _, eigenvalue: eigenvalue < -noise)
    point, rank = start, start.rotations.shape[1]
    if rank > problem.d:
        given = WayDown(-math.inf, Lift(start.rotations, start.translations), rank)
        yield (end := _minimised(problem, given, stop, monitor, accuracy))
        point = next_point(end)
    while not stop.should_stop():
        with stop.watch.phase("escape"):
            way = way_down(problem, point, rank, stop.should_stop)
        if way is None or not goes_on(point, way.eigenvalue) or way.rank > highest:
            return
        yield (end := _minimised(problem, way, stop, monitor, accuracy))
        point, rank = next_point(end), way.rank


def _rows_rise(problem: Climbing) -> bool:
    """Whether ranks rise by one row of each block, with the best translations."""
    return problem.eliminates and cast("Quadratic", problem).lifting is REAL


def way_down(
    problem: Quadratic | LiftedDistances,
    point: Point,
    rank: int,
    should_stop: Callable[[], bool] = lambda: False,
) -> WayDown | None:
    """The way from a point to above a rank, along the smallest eigenvalue; or None.

    Parameters
    ----------
    should_stop : is called before each factorization and each solve, unless rows rise

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop.
    """
    if not _rows_rise(problem):
        return _lower(problem, point, should_stop)
    eigenvalue, direction = negative_curvature(cast("Quadratic", problem), point)
    return WayDown(eigenvalue, point, rank + 1, direction)


def _minimised(
    problem: Quadratic | LiftedDistances,
    way: WayDown,
    stop: Stop,
    monitor: Monitor,
    accuracy: Callable[[], Mapping[str, Any]],
) -> Stair:
    """The end of descent along a way."""
    if _rows_rise(problem):
        found = low_rank.descend(
            cast("Quadratic", problem),
            way.point,
            way.rank,
            direction=way.direction,
            monitor=monitor,
            watch=stop.watch,
            **accuracy(),
        )
        return Stair(found.point, found.cost, found.status, found.counts)
    progress = Progress(monitor, watch=stop.watch, **accuracy())
    here = problem.linearized(way.point)
    end = minimise(here, DampedSteps(here), progress)
    return Stair(end.point, end.cost, stop.request or progress.status)


def _lower(problem: Climbing, point: Point, should_stop: Callable[[], bool]) -> WayDown | None:
    """A lower point of the next rank, where more than a row rises; None without one.

    Along an eigenvector of a negative eigenvalue of the certificate matrix of the problem that
    touches the cost there, whose curvature in a new dimension is that of the cost.
    """
    blocks = problem.blocks(point)
    here = Lift(blocks.rotations, blocks.translations)
    below, _ = next(problem.tangents(here))
    S = below.certificate_matrix(problem.multipliers(here))
    layout = below.pattern.layout_of(S)
    moved = int(layout.sizes.max()) - problem.d
    S = pinned(S, layout.first_row(problem.root) + np.arange(moved))
    root = np.sqrt(np.maximum(np.abs(problem.matrix.diagonal()), np.finfo(float).tiny))
    A = divided(S, root)
    # The motions of the whole have eigenvalue zero, and must not hide the one that is looked for.
    value, v = smallest_eigenpair(below, A, here.rank + MORE, should_stop)
    if value > -RESOLUTION:
        return None
    rows = layout.unpack(v / root)
    rows[problem.root, :moved] = 0.0
    rising = below.lifting.rising(rows, problem.d)
    lower = _leave(problem, below, here, rising)
    return None if lower is None else WayDown(value, lower, lower.rank)


def smallest_eigenpair(
    below: Quadratic, A: CSC, pairs: int, should_stop: Callable[[], bool]
) -> tuple[float, FloatArray]:
    """The smallest eigenvalue, of as many that are computed together, and its vector."""
    for shift in SHIFTS:
        if should_stop():
            raise NumericalError(STOPPED)
        shifted = add_to_diagonal(A, shift)
        factor = below.symbolic(shifted).factor(shifted)
        if factor is None:
            continue

        def solve(B: FloatArray, factor: Factor = factor) -> FloatArray:
            if should_stop():
                raise NumericalError(STOPPED)
            return factor.solve(B)

        start = np.random.default_rng(0).standard_normal((A.shape[0], pairs))
        found = krylov_schur(shifted, solve, pairs, shift=shift, tol=ACCURACY, start=start)
        return float(found.values[0]), found.vectors[:, 0]
    raise NumericalError("the certificate matrix could not be factorized, even when shifted")


def _leave(problem: Climbing, below: Quadratic, here: Lift, rising: Lift) -> Lift | None:
    """The point moved into new dimensions as far as its cost decreases; None if it does not."""
    start = lifted(here, here.rank + rising.rank)
    V, w = np.zeros_like(start.rotations), np.zeros_like(translations_of(start))
    V[:, -rising.rank :], w[:, -rising.rank :] = rising.rotations, translations_of(rising)
    scales = below.sizes_of(here.rotations)
    size = float((np.linalg.norm(V, axis=(1, 2)) / scales).max())
    reach = float(np.linalg.norm(translations_of(start), axis=1).max())
    step = min(1.0 / max(size, 1e-300), reach / max(float(np.abs(w).max()), 1e-300))

    def moved(step: float) -> Lift:
        frames = (start.rotations + step * V) / scales[:, None, None]
        blocks = scales[:, None, None] * below.kinds.apply("nearest", frames)
        return Lift(blocks, translations_of(start) + step * w)

    return low_rank.lowest_of_halvings(problem.cost, moved, step, problem.cost(start))
