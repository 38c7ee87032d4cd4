"""Bounds and certificates for graphs with measured distances."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from certpgo.certify.bounds import Bounds
from certpgo.certify.certificate import Certificate, Verdict
from certpgo.certify.chordal_case import Case
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.surrogate_bound import bound_below
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.relaxed_point import Lift, Point, lifted, main_subspace, translations_of
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.objective.families.distances import FAINT, SHORTEST
from certpgo.objective.range_problem import RangeProblem
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.range_saddles import descents
from certpgo.optimize.solution import Level, Solution, Status

#: Relative gap between a point of the relaxation and its bound below which it is solved.
SOLVED = 1e-6
#: Projections of the relaxation's point from which descents to estimates begin.
PROJECTIONS = 12
#: By which a start leaves the space of d dimensions, over the median distance.
OUT = 0.3
#: Steps of a descent to an estimate.
STEPS = 250
#: What is added to the weights of tangents until there is a bound.
FAINTER = (0.0, FAINT)
#: Share of the remaining time for the climb; the rest is for descents from its end.
CLIMB_SHARE = 0.7
#: Ranks above d that the relaxation is climbed to.
RANKS = 7


def _lever(graph: PoseGraph) -> float:
    """The largest coordinate that is measured, or 1 without any."""
    return float(np.abs(graph.translations).max()) or 1.0


def range_bound(problem: RangeProblem, point: Point, cost: float) -> DualBound | None:
    """A lower bound on f* from a stationary point of the relaxation, of any rank.

    By the pose graph of tangents there, see `certpgo.objective.range_problem`; None if it is not
    above zero. Where their weights leave positions free, as of points that the minimum has on a
    line, faint ones are added.

    Parameters
    ----------
    cost : f of the best estimate; it decides how sharp is sharp enough
    """
    for more in FAINTER:
        below, constant = problem.surrogate(point, more)
        enough = problem.cost(point) - constant - 1e-7 * cost
        found = bound_below(below, constant, point, enough=enough, floor=-constant)
        if found is not None:
            return found if found.value > 0.0 else None
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

    def descent(self, start: Estimate, monitor: Monitor | None = None) -> Solution:
        """Local descent on the cost from an estimate."""
        monitor, watch = monitor or self.stop, self.stop.watch
        return descend(self.problem, start, max_iterations=STEPS, monitor=monitor, watch=watch)

    def bound(self, point: Point, cost: float, **_: bool) -> DualBound | None:
        """The bound by the tangents at a point; see `range_bound`."""
        return range_bound(self.problem, point, cost)

    @cached_property
    def relaxation(self) -> Relaxed:
        """The relaxation, climbed to its minimum once."""
        relaxed = Relaxed(self)
        for _ in relaxed.bounds():
            pass
        return relaxed

    @cached_property
    def near_relaxation(self) -> LocalMinimum | None:
        """The best estimate near the relaxation's minimum, with its bound."""
        with self.stop.for_at_most(CLIMB_SHARE * self.stop.remaining):
            relaxed = self.relaxation
        best: LocalMinimum | None = None
        for start in relaxed.projections():
            if best is not None and (self.stop.should_stop() or self.is_closed(best)):
                break
            with self.stop.watch.phase("round"), suppress(NumericalError, np.linalg.LinAlgError):
                found = self.descent(start)
                cost = self.cost_upper(found.estimate)
                if best is None or cost < best.cost:
                    settled = found.status is Status.CONVERGED
                    best = LocalMinimum(found.estimate, cost, settled, relaxed.bound)
        return best

    def elsewhere(self) -> LocalMinimum | None:
        """The best estimate near the relaxation's minimum, with its bound; None without one."""
        with suppress(NumericalError):
            return self.near_relaxation
        return None

    def certificate(
        self,
        estimate: Estimate,
        own: LocalMinimum,
        other: LocalMinimum | None = None,
        bounds: Bounds | None = None,
    ) -> Certificate:
        """The certificate of an estimate; with what the relaxation is worth."""
        found = super().certificate(estimate, own, other, bounds)
        if other is not None:
            found = replace(found, obstacle=self.relaxation.obstacle(found))
        if self.stop.cut is not None:  # another estimate may have the time for it
            for name in ("relaxation", "near_relaxation"):
                self.__dict__.pop(name, None)
        return found


class Relaxed:
    """The relaxation, climbed from rank d + 1 to its minimum.

    Parameters
    ----------
    highest : the largest rank
    """

    def __init__(self, case: RangedCase, highest: int | None = None) -> None:
        self.problem, self.stop = case.problem, case.stop
        lowest = self.problem.d + self.problem.whole.dimensions
        self.highest = max(highest or self.problem.d + RANKS, lowest)
        self.rng = np.random.default_rng(0)
        self.point = self.start()
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.solved = False

    def start(self) -> Lift:
        """Rotations along a tree, and random positions in new dimensions too."""
        problem, rng = self.problem, self.rng
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

    def bounds(self) -> Iterator[DualBound | None]:
        """Climb to the minimum, or to what is found before a limit; the bound at each rank."""
        climb = descents(self.problem, self.point, self.highest, self.stop)
        with suppress(NumericalError, np.linalg.LinAlgError):
            for end, status in climb:
                self.point = end.point
                self.levels.append(Level(self.rank, end.cost, status))
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
            for B in self.problem.whole.frames(basis):
                yield Estimate(so.project(B.T @ point.rotations), translations_of(point) @ B)
            basis = np.linalg.qr(self.rng.standard_normal((point.rank, point.d)))[0]

    @property
    def rank(self) -> int:
        """Of the last point."""
        return self.point.rank

    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps a gap open: what the relaxation is worth, or that it was not solved."""
        if certificate.verdict is not Verdict.BOUNDED or certificate.basin_is_global:
            return certificate.obstacle
        cut = self.stop.cut
        kind = LimitedBy.LOOSE if self.solved or cut is None else LimitedBy.STOPPED
        return Obstacle(kind, self.solved, self.rank, cut, of_distances=True)
