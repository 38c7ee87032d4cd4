"""The search for graphs with measured distances: climb, bound, round, descend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, cast

from certpgo.certify.certificate import Certificate
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import Obstacle
from certpgo.certify.verdict import of_relaxation
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, Point
from certpgo.graph.trees import tree_initialization
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Solution, Status
from certpgo.solve.relaxation import CLIMB_SHARE, Relaxed
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Report, Search
from certpgo.solve.settings import SolveSettings

#: Share of the remaining time for descents from a given estimate.
GIVEN_SHARE = 0.3
#: Where the search begins of itself, for reports.
ORIGIN = "a random point of higher rank"


class RangeSearch(Search):
    """The search with distances: descents begin near the minimum of a relaxation seldom tight."""

    posed: InformationProblem
    problem: InformationProblem
    of_edges_alone = False

    def __init__(
        self, posed: InformationProblem, normalized: NormalizedProblem[Any], settings: SolveSettings
    ) -> None:
        super().__init__(posed, normalized, settings)
        form = cast("LiftedDistances", self.normalized.eased.lifted_form)
        self.relaxed = Relaxed(form, self.stop, settings.max_rank)
        self.report: Report | None = None

    def solved(
        self, initial: Start | None, stored: Start | None, report: Report | None
    ) -> CertifiedSolution:
        """The best estimate found, with its certificate; a file's values begin it, too."""
        if initial is None:
            initial, stored = stored, None
        return super().solved(initial, stored, report)

    def begin(self, initial: Start | None) -> None:
        """Descend from a given estimate; without one, any point is a first answer."""
        if initial is None:
            whole = self.relaxed.problem.whole
            along = whole.complete(tree_initialization(whole.graph.rotations_alone).rotations)
            cost, status = self.problem.cost(along), Status.ITERATION_LIMIT
            self.start = self.origin = ORIGIN
            self.keep(Solution(along, cost, status))
            return
        self.start = self.origin = initial.name
        with self.stop.for_at_most(GIVEN_SHARE * self.stop.remaining):
            self.keep(self.descend(initial.estimate))

    def try_stored(self, start: Start | None) -> None:
        """Descend from another estimate, in its share of the time."""
        with self.stop.for_at_most(GIVEN_SHARE * self.stop.remaining):
            super().try_stored(start)

    def relaxation(self) -> Iterator[Lift]:
        """The minimum of the relaxation."""
        with self.stop.for_at_most(CLIMB_SHARE * self.stop.remaining):
            for bound in self.relaxed.bounds():
                self.keep_bound(bound)
        before, self.levels = self.best, self.relaxed.levels
        if not self.is_certified:
            yield self.relaxed.point
        if self.best is not before:
            self.start = self.origin = ORIGIN

    def look_for_outliers(self, report: Report | None) -> None:
        """Not before the end: the first answer says nothing of measurements."""
        self.report = report

    def finish(self) -> None:
        """A bound without stiff measurements; then look for some that disagree, and report them."""
        if not self.ends():
            super().improve_bound(self.best.estimate)
        if not self.stop.stop_requested:
            super().look_for_outliers(self.report)

    def roundings(self, point: Lift) -> Iterator[Estimate]:
        """Its projections to d dimensions."""
        return self.relaxed.projections()

    def own_starts(self) -> Iterable[Callable[[], Start]]:
        """None: the relaxation is climbed first, from a random point."""
        return ()

    def descend(
        self, start: Estimate, *, near: bool = False, monitor: Monitor | None = None
    ) -> Solution:
        """Local descent, as of any cost."""
        with self.watch.phase("round"):
            return super().descend(start, near=near, monitor=monitor)

    def improve_bound(self, point: Point) -> None:
        """Nothing: estimates have no bounds of their own worth their time."""

    @property
    def ending(self) -> str:
        """Where the search ended."""
        return f"; the relaxation ended at rank {self.relaxed.rank}"

    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps the gap open after the search."""
        return of_relaxation(certificate, self.relaxed.reached, self.stop.cut)
