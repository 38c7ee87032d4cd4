"""Points of higher rank, for bounds where the multipliers of an estimate do not suffice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from certpgo.certify.curvature import negative_curvature
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.lift import Lift, Point
from certpgo.objective.problem import Problem
from certpgo.optimize import low_rank

#: Stationarity, radians, and steps of a descent at one rank.
TOLERANCE, STEPS = 1e-8, 100


def climb(problem: Problem, start: Estimate, highest: int) -> Iterator[Lift]:
    """Lower and lower points of the relaxation: the Riemannian staircase (Boumal 2015).

    Parameters
    ----------
    start : a stationary point of the problem's cost
    highest : the largest rank

    Yields
    ------
    The end of descent at each rank from d + 1, until there is no negative curvature.
    """
    point: Point = start
    with suppress(NumericalError, np.linalg.LinAlgError):
        for rank in range(problem.d + 1, highest + 1):
            eigenvalue, direction = negative_curvature(problem, point)
            if eigenvalue >= 0.0:
                break
            point = low_rank.descend(
                problem,
                point,
                rank,
                direction=direction,
                tolerance=TOLERANCE,
                max_iterations=STEPS,
            ).point
            yield point
