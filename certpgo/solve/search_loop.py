"""The search for an estimate and its bound, in any cost: descend, relax, round, descend again."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import numpy as np

from certpgo.certify.certificate import Certificate, Tier
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import Obstacle
from certpgo.certify.verdict import verdict
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, Point
from certpgo.graph.trees import with_leaves_placed
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, Stopwatch
from certpgo.optimize.progress import Hopeful
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.solve import bounding
from certpgo.solve.outliers import Disagreement, disagreement
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings

#: What outliers are reported to.
Report = Callable[[Disagreement], object]


class Search(ABC):
    """The best estimate and bound so far, and how they were found.

    Costs differ in how a search begins, in the points of their relaxation and in how these are
    rounded: a subclass each.

    Parameters
    ----------
    posed : the problem in the units of the graph
    normalized : the problem in units of one, its tolerances and the monitor of all phases
    """

    problem: Any
    best: Solution
    start: str
    origin: str
    #: Whether all terms of the cost are of edges between nodes of one scale.
    of_edges_alone: bool = True
    #: Whether bounds of estimates are sharpened beyond what suffices.
    sharp: bool = False

    def __init__(
        self, posed: Certifiable, normalized: NormalizedProblem[Any], settings: SolveSettings
    ) -> None:
        # Cheaper bounds than those of the proof tier suffice to guide the search.
        proof = normalized.tier is Tier.PROOF
        self.normalized = replace(normalized, tier=Tier.STANDARD) if proof else normalized
        self.tier = None if settings.tier is None else normalized.tier
        self.asked = settings
        self.posed, self.problem, self.settings = posed, normalized.problem, settings
        self.stop = normalized.stop
        self.patience = settings.patience if settings.time_limit is None else math.inf
        self.counts: Counter[str] = Counter()
        self.cost = math.inf
        self._fit: tuple[Solution, bool] | None = None  # the best, and whether it fits
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.ended_early = False
        self.disagreement: Disagreement | None = None
        self.chordal: CertifiedSolution | None = None

    def solved(
        self, initial: Start | None, stored: Start | None, report: Report | None
    ) -> CertifiedSolution:
        """The best estimate found, with its certificate; see `run`."""
        for start in (initial, stored):
            if start is not None:
                self.posed.check(start.estimate)
        with self.stop.within(self.settings.time_limit):
            with self.stop.for_at_most():
                self.run(initial, stored, report)
            if self.of_edges_alone and (self.stop.ended_by is not None or self.holds):
                self.place_leaves()
            return self.result(self.certificate())

    def run(
        self,
        initial: Start | None = None,
        stored: Start | None = None,
        report: Report | None = None,
    ) -> None:
        """Search until the gap is closed, the relaxation is exhausted, or a stop is requested.

        Parameters
        ----------
        initial : where the search begins; by default it finds a start of its own
        stored : another start, which is tried if the first descent is not certified
        report : is called with measurements that disagree with the rest
        """
        self.begin(initial)
        self.try_stored(stored)
        self.look_for_outliers(report)
        self.levels = [Level(self.problem.d, self.best.cost, self.best.status)]
        # After an error, the search continues with what was found before.
        with suppress(NumericalError, np.linalg.LinAlgError):
            for point in self.relaxation():
                self.descend_near(point)
        self.finish()

    def begin(self, initial: Start | None) -> None:
        """The first descent with its bound, and others while a better point is possible.

        Raises
        ------
        NumericalError
            No start could be computed, or no descent from one.
        """
        starts, failed = list(self.starts(initial)), NumericalError("there is no initialization")
        for start in starts:
            begun = math.isfinite(self.cost)
            # The weight of a bridge may raise the tolerance above a possible improvement.
            if begun and (self.normalized.is_sharp(self.basin) or self.stop.should_stop()):
                return
            try:
                here = start()
                self.begin_from(here, self.descend(here.estimate, near=here.near))
            except (NumericalError, np.linalg.LinAlgError) as error:
                failed = NumericalError(str(error))
        if not math.isfinite(self.cost):
            raise failed

    def begin_from(self, start: Start, found: Solution) -> None:
        """Keep the end of a descent, if it is the first or a better one."""
        if not math.isfinite(self.cost):
            self.start = self.origin = start.name
            self.keep(found)
        elif self.improve(found):
            self.start = start.name
            self.origin = f"{start.name}, which led to a lower cost than {self.origin}"

    def starts(self, initial: Start | None) -> Iterator[Callable[[], Start]]:
        """Where descents begin: what is given, then what is computed."""
        if initial is not None:
            yield lambda: self.given(initial)
        if initial is None or self.settings.try_own_start:
            yield from self.own_starts()

    @abstractmethod
    def own_starts(self) -> Iterable[Callable[[], Start]]:
        """Computed initializations."""

    @abstractmethod
    def relaxation(self) -> Iterator[Lift]:
        """Lower and lower points of the relaxation; the best of their bounds is kept."""

    def descend_near(self, point: Lift) -> None:
        """Descend from the roundings of a point; from the first one even if a stop is due."""
        for start in self.roundings(point):
            with suppress(NumericalError, np.linalg.LinAlgError):
                self.improve(self.descend(start))
            if self.ends():
                break

    def roundings(self, point: Lift) -> Iterable[Estimate]:
        """Estimates near a point of the relaxation, from which descents begin."""
        return cast("Iterable[Estimate]", self.problem.nearest_estimates(point))

    def look_for_outliers(self, report: Report | None) -> None:
        """Look for measurements that disagree with the rest, and report them."""
        if report is None or self.problem.takes_scales:
            return
        with self.watch.phase("residuals"):
            self.disagreement = disagreement(
                self.posed,
                self.best.estimate,
                refit=not self.is_certified,
                monitor=lambda _: self.stop.stop_requested,
            )
        if self.disagreement is not None:
            report(self.disagreement)

    @property
    def holds(self) -> bool:
        """Whether some edges may be constraints, which whole descents meet but to rounding."""
        graph = self.posed.chordal.graph
        return graph.assumed is not None or not graph.has_positions

    def place_leaves(self) -> None:
        """Put nodes of single measurements, as held ones are, where these have them."""
        estimate = with_leaves_placed(self.posed.chordal.graph, self.best.estimate)
        if estimate is self.best.estimate:
            return
        self.best = replace(self.best, estimate=estimate, cost=self.problem.cost(estimate))
        self.cost = self.normalized.cost_upper(estimate)

    def finish(self) -> None:
        """What is left to try at the end."""
        return

    def descend(
        self, start: Estimate, *, near: bool = False, monitor: Monitor | None = None
    ) -> Solution:
        """Local descent on the cost."""
        found = descend(
            self.problem,
            start,
            self.settings.newton,
            near=near,
            monitor=monitor or self.stop,
            watch=self.watch,
        )
        self.counts.update(found.counts)
        return found

    def given(self, initial: Start) -> Start:
        """An initial estimate with its best translations."""
        with self.watch.phase("start"):
            return replace(initial, estimate=self.problem.settled(initial.estimate))

    def try_stored(self, start: Start | None) -> None:
        """Descend from another estimate, as long as that may lead to a lower cost."""
        if start is None or self.ends():
            return
        with suppress(NumericalError, np.linalg.LinAlgError):
            if self.improve_hopefully([self.given(start).estimate]):
                self.start = start.name
                self.origin = f"{start.name}, which led to a lower cost than {self.origin}"

    def improve_hopefully(self, starts: Iterable[Estimate]) -> bool:
        """Descents from several estimates; those that would end above the best are given up."""
        before = self.best
        for start in starts:
            if self.ends():
                break
            hopeful = Hopeful(self.stop, self.best.cost, self.settings.hope)
            self.improve(self.descend(start, monitor=hopeful))
        return self.best is not before

    def improve(self, found: Solution) -> bool:
        """Keep a solution if it is better than the best so far; returns whether it is."""
        better = found.cost < (1.0 - self.settings.same_cost) * self.best.cost
        if better:
            self.keep(found)
        return better

    def keep(self, best: Solution) -> None:
        """Make a solution the best so far, and compute its bound if the gap is open."""
        self.best, self.cost = best, self.normalized.cost_upper(best.estimate)
        if self.bound is None or not self.is_certified:
            self.improve_bound(best.estimate)

    def improve_bound(self, point: Point) -> None:
        """Compute the bound of a point and keep it if it is better."""
        if self.stop.should_stop():
            return
        with self.watch.phase("certify"), suppress(NumericalError, np.linalg.LinAlgError):
            bound = bounding.bound_near(self.normalized, point, self.cost, sharp=self.sharp)
            if bound is not None:
                self.counts["factorizations"] += bound.factorizations
            self.keep_bound(bound)

    def keep_bound(self, bound: DualBound | None) -> None:
        """Keep a bound if it is the best so far."""
        if bound is not None and (self.bound is None or bound.value > self.bound.value):
            self.bound = bound

    def ends(self) -> bool:
        """Whether the gap is closed, or a stop leaves the rest of the search out."""
        return self.is_certified or self.stop.should_stop()

    @property
    def watch(self) -> Stopwatch:
        """The stopwatch of all phases, which begins anew with the search."""
        return self.stop.watch

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        closed = self.cost - self.basin.value <= self.normalized.tolerance(self.cost)
        return closed or self._fits(self.best)

    def _fits(self, best: Solution) -> bool:
        """Whether the best estimate meets all measurements."""
        if self._fit is None or self._fit[0] is not best:
            self._fit = best, self.normalized.fits(best.estimate)
        return self._fit[1]

    @property
    def basin(self) -> LocalMinimum:
        """The best estimate so far with its bound."""
        ended = self.best.status in (Status.CONVERGED, Status.STALLED)
        return LocalMinimum(self.best.estimate, self.cost, ended, self.bound)

    @property
    def status(self) -> Status:
        """How the search ended."""
        return self.stop.ended_by or self.best.status

    @property
    def is_tight(self) -> bool:
        """Whether only rounding keeps the gap open."""
        return False

    @property
    @abstractmethod
    def ending(self) -> str:
        """Where the search ended: the end of a sentence."""

    @abstractmethod
    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps the gap open after the search."""

    def certificate(self) -> Certificate:
        """At the tier asked for; by default the proof tier if only rounding is in the way."""
        tier = self.tier
        certificate = verdict(self.normalized, self.best.estimate, self.basin)
        escalates = tier is None and self._may_be_proven(certificate)
        if not (tier is Tier.PROOF or escalates):
            return certificate
        with self.watch.phase("prove"):
            exact, basin = replace(self.normalized, tier=Tier.PROOF), self.basin
            basin = replace(basin, cost=exact.cost_upper(basin.point))
            # A search stopped before the requested proof must not return a weaker tier instead.
            bound = None if self.stop.should_stop() else bounding.proven(exact, basin)
            proven = verdict(exact, basin.point, replace(basin, bound=bound))
        better = proven.lower_bound > certificate.lower_bound
        return proven if tier is Tier.PROOF or better else certificate

    def _may_be_proven(self, certificate: Certificate) -> bool:
        rounding = self.is_tight and certificate.is_near
        return rounding and not self.problem.unprovable and not self.stop.should_stop()

    def result(self, certificate: Certificate) -> CertifiedSolution:
        """The result, in the units of the graph."""
        stop, estimate = self.stop, self.best.estimate
        certificate = replace(certificate, obstacle=self.obstacle(certificate))
        solution = Solution(
            estimate=estimate,
            cost=self.posed.cost(estimate),
            status=self.status,
            iterations=max(len(stop.trace) - 1, 0),
            lower_bound=certificate.lower_bound,
            seconds=self.watch.seconds,
            trace=tuple(stop.trace),
            counts=dict(self.counts),
            note=f"initialized by {self.origin}{self.ending}",
        )
        return CertifiedSolution(
            solution,
            certificate,
            self.start,
            tuple(replace(level, cost=self.normalized.unit * level.cost) for level in self.levels),
            self.asked,
            self.posed,
            self.disagreement,
            self.chordal,
        )


def normalized_for(
    problem: Certifiable, settings: SolveSettings, monitor: Monitor
) -> NormalizedProblem[Any]:
    """The normalized problem with the tier and tolerances of a search."""
    tier = settings.tier or Tier.STANDARD
    return NormalizedProblem.of(problem, tier, settings.rtol, settings.atol, monitor)
