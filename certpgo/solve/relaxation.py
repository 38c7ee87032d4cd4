"""The relaxation of measured distances, and estimates near its minimum.

It is seldom tight: descents begin above rank d, where they hardly get stuck, and end at its
minimum. The projections of that are where descents to estimates begin.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from certpgo.certify.bound import bound_by
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import Climbed, LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Graph
from certpgo.graph.relaxed_point import Lift, Point, lifted, main_subspace, translations_of
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.objective.families.distances import SHORTEST
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.objective.objective import Surrogate
from certpgo.objective.sum import Sum
from certpgo.optimize.descent import descend
from certpgo.optimize.progress import Stop
from certpgo.optimize.solution import Level, Status
from certpgo.optimize.staircase import climb

#: Stationarity, radians, and steps of a descent at one rank: bounds of distances need all digits.
ACCURACY = {"tolerance": 1e-11, "max_iterations": 400}
#: Relative gap between a point of the relaxation and its bound below which it is solved.
SOLVED = 1e-6
#: Projections of the relaxation's point from which descents to estimates begin.
PROJECTIONS = 12
#: By which a start leaves the space of d dimensions, over the median distance.
OUT = 0.3
#: Share of the remaining time for the climb; the rest is for descents from its end.
CLIMB_SHARE = 0.7
#: Share of the cost by which a bound may miss the cost of a point, to be sharp.
SHARP = 1e-7


def _lever(graph: Graph) -> float:
    """The largest coordinate that is measured, or 1 without any."""
    return float(np.abs(graph.translations).max()) or 1.0


def range_bound(problem: LiftedDistances, point: Point, cost: float) -> DualBound | None:
    """A lower bound on f* from a stationary point of the relaxation; None if not above zero.

    Parameters
    ----------
    point : of any rank
    cost : f of the best estimate; it decides how sharp is sharp enough
    """
    enough = problem.cost(point) - SHARP * cost
    found = bound_by(Surrogate(problem), point, enough=enough)
    return found if found is not None and found.value > 0.0 else None


class Relaxed:
    """The relaxation, climbed from rank d + 1 to its minimum.

    Parameters
    ----------
    highest : the largest rank
    """

    def __init__(self, problem: LiftedDistances, stop: Stop, highest: int) -> None:
        self.problem, self.stop = problem, stop
        self.highest = max(highest, problem.d + problem.whole.lifting.dimensions)
        self.rng = np.random.default_rng(0)
        self.point = self.start()
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.solved = False

    def start(self) -> Lift:
        """Rotations along a tree, and random positions in new dimensions too."""
        problem, rng = self.problem, self.rng
        tree = tree_initialization(problem.graph.rotations_alone)
        distances = problem.ranges.distances
        # Those of nodes that coincide say nothing of the extent.
        apart = distances[distances > SHORTEST * distances.max()]
        length = float(np.median(apart)) if len(apart) else _lever(problem.measured)
        t = length * rng.standard_normal((problem.n, problem.d))
        new = problem.whole.lifting.dimensions
        point = lifted(Estimate(tree.rotations, t), problem.d + new)
        out = OUT * length * rng.standard_normal((problem.n, new))
        return Lift(point.rotations, np.concatenate([t, out], axis=1))

    def bounds(self) -> Iterator[DualBound | None]:
        """Climb to the minimum, or to what is found in its share of the time; each rank's bound."""
        limited = self.stop.for_at_most(CLIMB_SHARE * self.stop.remaining)
        with limited, suppress(NumericalError, np.linalg.LinAlgError):
            climbed = partial(climb, self.problem, self.point, self.highest, self.stop)
            for end in climbed(accuracy=lambda: ACCURACY):
                self.point = end.point
                self.levels.append(end.level)
                if self.stop.should_stop():
                    break
                with self.stop.watch.phase("certify"):
                    bound = range_bound(self.problem, self.point, end.cost)
                if bound is not None and (self.bound is None or bound.value > self.bound.value):
                    self.bound = bound
                yield bound
                self.solved = bound is not None and bound.value >= (1.0 - SOLVED) * end.cost
                if self.solved:
                    break

    def projections(self) -> Iterator[Estimate]:
        """Estimates near the last point: in its main subspace, then in random ones."""
        point = self.point
        basis = main_subspace(point.subset(self.problem.poses))
        for _ in range(PROJECTIONS):
            for B in self.problem.whole.lifting.frames(basis):
                with self.stop.watch.phase("round"):
                    R = so.project(B.T @ point.rotations)
                yield Estimate(R, translations_of(point) @ B)
            basis = np.linalg.qr(self.rng.standard_normal((point.rank, point.d)))[0]

    @property
    def rank(self) -> int:
        """Of the last point."""
        return self.point.rank

    @property
    def reached(self) -> Climbed:
        """How far it was minimised."""
        return Climbed(self.solved, self.rank)


def near_relaxation(normalized: NormalizedProblem[Sum]) -> LocalMinimum | None:
    """The best estimate near the relaxation's minimum, with its bound; None without one."""
    stop, form = normalized.stop, normalized.eased.lifted_form
    if form is None:
        return None
    relaxed = Relaxed(form, stop, form.d + normalized.problem.most_ranks)
    for _ in relaxed.bounds():
        pass
    best: LocalMinimum | None = None
    for start in relaxed.projections():
        if best is not None and (stop.should_stop() or normalized.is_closed(best)):
            break
        with stop.watch.phase("round"), suppress(NumericalError, np.linalg.LinAlgError):
            found = descend(normalized.problem, start, monitor=stop, watch=stop.watch)
            cost = normalized.cost_upper(found.estimate)
            if best is None or cost < best.cost:
                settled = found.status is Status.CONVERGED
                best = LocalMinimum(found.estimate, cost, settled, relaxed.bound)
    return None if best is None else replace(best, climbed=relaxed.reached)
