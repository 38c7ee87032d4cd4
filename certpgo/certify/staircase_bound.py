"""Points of higher rank, for bounds where the multipliers of an estimate do not suffice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from certpgo.certify.curvature import negative_curvature, resolution
from certpgo.errors import NumericalError
from certpgo.graph.relaxed_point import Point
from certpgo.objective.problem import Problem
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.solution import Status

#: Stationarity, radians, and steps of a descent at one rank.
TOLERANCE, STEPS = 1e-8, 100


def climb(
    problem: Problem, start: Point, highest: int, monitor: Monitor = silent
) -> Iterator[Point]:
    """Lower and lower points of the relaxation: the Riemannian staircase (Boumal 2015).

    Parameters
    ----------
    start : stationary if its rank is d
    highest : the largest rank

    Yields
    ------
    The end of descent at each rank, beginning with that of the start, until there is no negative
    curvature or the monitor stops.
    """
    point, direction, rank = start, None, start.rotations.shape[1]
    with suppress(NumericalError, np.linalg.LinAlgError):
        while True:
            if rank > problem.d:
                found = low_rank.descend(
                    problem,
                    point,
                    rank,
                    direction=direction,
                    tolerance=TOLERANCE,
                    max_iterations=STEPS,
                    monitor=monitor,
                )
                point = found.point
                if found.status is Status.INTERRUPTED:
                    break
            yield point
            rank += 1
            if rank > highest:
                break
            eigenvalue, direction = negative_curvature(problem, point)
            if -eigenvalue <= resolution(problem):
                break
