"""Bounds and certificates for graphs with measured distances."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.case import Basin, Case
from certpgo.certify.certificate import Certificate, Verdict
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.costs.range_descent import descend, escape
from certpgo.costs.ranges import FAINT, SHORTEST, RangeProblem
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.lift import Lift, Point, lifted, main_subspace, translations_of
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import so
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.optimize.starts import Start

#: Relative gap between a point of the relaxation and its bound below which it is solved.
SOLVED = 1e-6
#: Projections of the relaxation's point from which descents to estimates begin.
PROJECTIONS = 12
#: By which a start leaves the space of d dimensions, over the median distance.
OUT = 0.3
#: Steps of a descent to an estimate.
STEPS = 250
#: Shares of the remaining time for descents from given estimates, and then for the climb; the rest
#: is for descents from its end.
GIVEN_SHARE, CLIMB_SHARE = 0.3, 0.7
#: Relative difference below which costs count as equal.
SAME_COST = 1e-9
#: Where the search begins of itself, for reports.
ORIGIN = "a random point of higher rank"
#: Ranks above d that the relaxation is climbed to.
RANKS = 7


def _lever(graph: PoseGraph) -> float:
    """The largest coordinate that is measured, or 1 without any."""
    return float(np.abs(graph.translations).max()) or 1.0


def range_bound(problem: RangeProblem, point: Point, cost: float) -> DualBound | None:
    """A lower bound on f* from a stationary point of the relaxation, of any rank.

    By the pose graph of tangents there, see `certpgo.costs.ranges`; None if it is not above zero.
    Where their weights leave positions free, as of points that the minimum has on a line, faint
    ones are added.

    Parameters
    ----------
    cost : f of the best estimate; it decides how sharp is sharp enough
    """
    for more in (0.0, FAINT):
        below, constant = problem.surrogate(point, more)
        enough = problem.cost(point) - constant - 1e-7 * cost
        found = dual_bound(below, point, enough=enough, floor=-constant)
        if found is not None:
            value = math.nextafter(found.value + constant, -math.inf)
            return replace(found, value=value) if value > 0.0 else None
    return None


@dataclass(frozen=True)
class RangedCase(Case):
    """A `Case` with measured distances, whose bound comes from the minimum of the relaxation.

    The relaxation is seldom tight: descents begin above rank d, where they hardly get stuck, and
    end at its minimum. The projections of that are where descents to estimates begin.
    """

    problem: RangeProblem  # type: ignore[assignment]

    def completed(self, estimate: Estimate) -> Estimate:
        """The estimate itself: its best translations come by descent."""
        return estimate

    def descent(self, start: Point, monitor: Monitor | None = None) -> Solution:
        """Local descent on the cost, at rank d."""
        monitor = monitor or self.stop
        point, status = descend(
            self.problem, start, max_iterations=STEPS, monitor=monitor, watch=self.stop.watch
        )
        estimate = Estimate(point.rotations, point.translations)
        return Solution(estimate, self.problem.cost(estimate), status, 0)

    def bound(self, point: Point, cost: float, **_: bool) -> DualBound | None:
        """The bound by the tangents at a point; see `range_bound`."""
        return range_bound(self.problem, point, cost)

    @cached_property
    def search(self) -> Search:
        """The search of the relaxation and of estimates near its minimum, done once."""
        found = Search(self)
        found.run()
        return found

    def elsewhere(self) -> Basin | None:
        """The best estimate of the search, with the bound of the relaxation; None without one."""
        with suppress(NumericalError):
            return self.search.basin
        return None

    def certificate(
        self,
        estimate: Estimate,
        own: Basin,
        other: Basin | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate; with what the relaxation is worth."""
        found = super().certificate(estimate, own, other, bounds)
        if other is not None:
            found = self.search.explained(found)
        if self.stop.cut is not None:
            self.__dict__.pop("search", None)  # another estimate may have the time for it
        return found


class Search:
    """The best estimate and bound so far.

    Parameters
    ----------
    highest : rank up to which the relaxation is climbed
    """

    def __init__(self, case: RangedCase, highest: int | None = None) -> None:
        self.case, self.problem, self.stop = case, case.problem, case.stop
        lowest = self.problem.d + self.problem.whole.dimensions
        self.highest = max(highest or self.problem.d + RANKS, lowest)
        self.best: Estimate | None = None
        self.cost, self.status, self.origin = math.inf, Status.ITERATION_LIMIT, ORIGIN
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.solved = False

    def run(self, starts: Iterable[Start] = ()) -> None:
        """Descend from given estimates, climb to the relaxation's minimum, then round.

        Each phase leaves time for the next ones.
        """
        rng = np.random.default_rng(0)
        with self.stop.for_at_most(GIVEN_SHARE * self.stop.remaining):
            for start in starts:
                self.try_from(start.estimate, start.name)
        with self.stop.for_at_most(CLIMB_SHARE * self.stop.remaining):
            point = self.climb(self.start(rng))
        for projected in self.projections(point, rng):
            if self.best is not None and (self.stop.cuts() or self.is_certified):
                break
            self.try_from(projected)

    def start(self, rng: np.random.Generator) -> Lift:
        """Rotations along a tree, and random positions in new dimensions too."""
        problem = self.problem
        tree = tree_initialization(problem.graph.rotation)
        distances = problem.ranges.distances
        # Those of nodes that coincide say nothing of the extent.
        apart = distances[distances > SHORTEST * distances.max()]
        length = float(np.median(apart)) if len(apart) else _lever(problem.measured)
        t = length * rng.standard_normal((problem.n, problem.d))
        new = problem.whole.dimensions
        point = lifted(Estimate(tree.rotations, t), problem.d + new)
        out = OUT * length * rng.standard_normal((problem.n, new))
        return Lift(point.rotations, np.concatenate([t, out], axis=1))

    def climb(self, point: Lift) -> Lift:
        """The minimum of the relaxation, or what was found before a limit, and its bound."""
        following: Lift | None = point
        with suppress(NumericalError, np.linalg.LinAlgError):
            while following is not None and following.rank <= self.highest:
                with self.stop.watch.phase("descend"):
                    point, status = descend(self.problem, following, monitor=self.stop)
                cost = self.problem.cost(point)
                self.levels.append(Level(point.rank, cost, self.stop.request or status))
                if self.stop.cuts():
                    break
                with self.stop.watch.phase("certify"):
                    bound = range_bound(self.problem, point, cost)
                if bound is not None and (self.bound is None or bound.value > self.bound.value):
                    self.bound = bound
                self.solved = bound is not None and bound.value >= (1.0 - SOLVED) * cost
                if self.solved:
                    break
                with self.stop.watch.phase("escape"):
                    following = escape(self.problem, point, self.stop.cuts)
        return point

    def projections(self, point: Lift, rng: np.random.Generator) -> Iterator[Lift]:
        """Points of rank d: in the main subspace, then in random ones."""
        basis = main_subspace(point.subset(self.problem.poses))
        for _ in range(PROJECTIONS):
            for B in self.problem.whole.frames(basis):
                rotations = so.project(B.T @ point.rotations)
                yield Lift(rotations, translations_of(point) @ B)
            basis = np.linalg.qr(rng.standard_normal((point.rank, point.d)))[0]

    def try_from(self, start: Point, origin: str = ORIGIN) -> None:
        """Descend, and keep the end if it is the best."""
        with self.stop.watch.phase("round"), suppress(NumericalError, np.linalg.LinAlgError):
            found = self.case.descent(start)
            cost = self.case.cost_upper(found.estimate)
            if self.best is None or cost < (1.0 - SAME_COST) * self.cost:
                self.best, self.cost = found.estimate, cost
                self.status, self.origin = found.status, origin

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        value = self.bound.value if self.bound is not None else 0.0
        return self.cost - value <= self.case.tolerance(self.cost)

    @property
    def rank(self) -> int:
        """Of the last point of the relaxation."""
        return self.levels[-1].rank if self.levels else self.problem.d

    @property
    def basin(self) -> Basin:
        """The best estimate, with the bound.

        Raises
        ------
        NumericalError
            There is none.
        """
        if self.best is None:
            raise NumericalError("no descent from the relaxation's point succeeded")
        return Basin(self.best, self.cost, self.status is Status.CONVERGED, self.bound)

    def explained(self, certificate: Certificate) -> Certificate:
        """The certificate, with what the relaxation is worth."""
        if certificate.verdict is not Verdict.BOUNDED or certificate.basin_is_global:
            return certificate
        kind = (
            LimitedBy.STOPPED if self.stop.cut is not None and not self.solved else LimitedBy.LOOSE
        )
        stopped = None if self.solved else self.stop.cut
        obstacle = Obstacle(kind, self.solved, self.rank, stopped, of_distances=True)
        return replace(certificate, obstacle=obstacle)
