"""Pose graphs below a cost."""

from __future__ import annotations

import math
from dataclasses import dataclass

from certpgo.graph.relaxed_point import Point
from certpgo.objective.minorants import Minorants
from certpgo.objective.problem import PoseProblem
from certpgo.objective.range_problem import RangeProblem


@dataclass(frozen=True, eq=False)
class Surrogate:
    """A pose graph whose cost plus a constant is nowhere above a problem's cost.

    Attributes
    ----------
    problem : the pose graph's
    constant : rounded down
    minorants : those of all measurements, of which some may not exist
    """

    problem: PoseProblem | RangeProblem
    constant: float
    minorants: Minorants

    def at(self, point: Point, more: float = 0.0) -> tuple[PoseProblem, float]:
        """The pose graph alone, with distances replaced by tangents at a point, and its constant.

        Parameters
        ----------
        more : as of `RangeProblem.surrogate`
        """
        if not isinstance(self.problem, RangeProblem):
            return self.problem, self.constant
        below, constant = self.problem.surrogate(point, more)
        return below, math.nextafter(constant + self.constant, -math.inf)
