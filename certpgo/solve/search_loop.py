"""The search for an estimate and its bound, in any cost: descend, relax, round, descend again."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from certpgo.certify.certificate import Tier
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import Climbed, LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, Stopwatch
from certpgo.optimize.progress import EarlyStopping
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.solve import bounding
from certpgo.solve.outliers import Disagreement, disagreement, ignore
from certpgo.solve.plan import Plan
from certpgo.solve.settings import OUTLIERS_PATIENCE, SolveSettings

#: What outliers are reported to.
Report = Callable[[Disagreement], object]


class Search:
    """The best estimate and bound so far, and how they were found.

    Parameters
    ----------
    plan : what is particular to the cost
    original : the problem in the units of the graph
    normalized : the problem in units of one, its tolerances and the monitor of all phases

    Raises
    ------
    InputError
        The highest rank of the settings is below d.
    """

    best: Solution
    start: str
    origin: str
    #: The last point of the relaxation.
    point: Point

    def __init__(
        self,
        plan: Plan,
        original: Certifiable,
        normalized: NormalizedProblem[Any],
        settings: SolveSettings,
    ) -> None:
        d, highest = original.d, settings.max_rank
        self.highest = d + original.most_ranks if highest is None else highest
        if self.highest < d:
            raise InputError(f"the maximal rank must be at least {d}, not {self.highest}")
        # Cheaper bounds than those of the proof tier suffice to guide the search.
        tier = Tier.STANDARD if normalized.tier is Tier.PROOF else normalized.tier
        self.normalized = replace(normalized, tier=tier, ranks=self.highest - d)
        self.tier = None if settings.tier is None else normalized.tier
        self.plan, self.original, self.settings = plan, original, settings
        self.problem: Any = normalized.problem
        self.newton = _as_close_as(normalized, settings.newton)
        self.stop = normalized.stop
        limited = plan.limits is not None and settings.time_limit is None
        self.patience = settings.patience if limited else math.inf
        self.climb_deadline = math.inf  # of `time.monotonic`
        self.ended_early = self.limited_by_outliers = False
        self.counts: Counter[str] = Counter()
        self.cost = math.inf
        self._fit: tuple[Solution, bool] | None = None  # the best, and whether it fits
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.floor = -math.inf  # the relaxation's minimum up to rounding, once it is reached
        self.exhausted: Point | None = None  # point without a better bound
        self.climbed = Climbed(False, d)  # how far the relaxation of distances was minimised
        self.surrogates = 0
        self.disagreement: Disagreement | None = None
        self.looked = True  # whether that is known, or for the answer to find

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

        Raises
        ------
        InputError
            A start of another graph.
        """
        if initial is None and self.plan.begins_at_file:
            initial, stored = stored, None
        for start in (initial, stored):
            if start is not None:
                self.original.check(start.estimate)
        self.begin(initial)
        self.try_stored(stored)
        if self.plan.outliers == "first":
            self.look_for_outliers(report)
        self.levels = [Level(self.problem.d, self.best.cost, self.best.status)]
        self.point = self.best.estimate
        # After an error, the search continues with what was found before.
        with suppress(NumericalError, np.linalg.LinAlgError):
            for estimates in self.plan.roundings(self):
                self.descend_from(estimates)
        self.plan.finish(self)
        if self.plan.outliers == "last" and not self.stop.stop_requested:
            self.look_for_outliers(report)

    def begin(self, initial: Start | None) -> None:
        """The first descent with its bound, and others while a better point is possible.

        Raises
        ------
        NumericalError
            No start could be computed, or no descent from one.
        """
        descends = initial is not None or self.plan.descends_from_own_start
        failed = NumericalError("there is no initialization")
        for start in self.starts(initial):
            begun = math.isfinite(self.cost)
            # The weight of a bridge may raise the tolerance above a possible improvement.
            if begun and (self.normalized.is_sharp(self.minimum) or self.stop.should_stop()):
                return
            try:
                here = start()
                found = self.first_descent(here) if descends else self.as_is(here)
                if begun:
                    self.note_if(self.improve(found), here)
                else:
                    self.start = self.origin = here.name
                    self.keep(found)
            except (NumericalError, np.linalg.LinAlgError) as error:
                failed = NumericalError(str(error))
        if not math.isfinite(self.cost):
            raise failed

    def starts(self, initial: Start | None) -> Iterator[Callable[[], Start]]:
        """Where descents begin: what is given, then what is computed."""
        if initial is not None:
            yield partial(self.given, initial)
        if initial is None or (self.plan.tries_own_start and self.settings.try_own_start):
            yield from (partial(start, self) for start in self.plan.starts)

    def given(self, initial: Start) -> Start:
        """An initial estimate with its best translations."""
        with self.watch.phase("start"):
            return replace(initial, estimate=self.problem.settled(initial.estimate))

    def first_descent(self, start: Start) -> Solution:
        """The descent from a start, in its share of the time."""
        with self.share_for_given():
            return self.descend(start.estimate, near=start.near)

    def as_is(self, start: Start) -> Solution:
        """A start without descent."""
        cost = self.problem.cost(start.estimate)
        return Solution(start.estimate, cost, Status.ITERATION_LIMIT)

    def try_stored(self, start: Start | None) -> None:
        """Descend from another estimate, as long as that may lead to a lower cost."""
        if start is None or self.ends():
            return
        with self.share_for_given(), suppress(NumericalError, np.linalg.LinAlgError):
            self.note_if(self.improve_from([self.given(start).estimate]), start)

    def note_if(self, improved: bool, start: Start) -> None:
        """Note whether descent from another start led to the best estimate."""
        if improved:
            self.start = start.name
            self.origin = f"{start.name}, which led to a lower cost than {self.origin}"

    def share_for_given(self) -> AbstractContextManager[None]:
        """The time for descents from given estimates."""
        share, stop = self.plan.given_share, self.stop
        return nullcontext() if share is None else stop.for_at_most(share * stop.remaining)

    def descend_from(self, estimates: Iterable[Estimate]) -> None:
        """Descend from estimates near a point; from the first one even if a stop is due."""
        for start in estimates:
            with suppress(NumericalError, np.linalg.LinAlgError):
                self.improve(self.descend(start))
            if self.ends():
                break

    def look_for_outliers(self, report: Report | None) -> None:
        """Look for measurements that disagree with the rest, and report them.

        Where nobody listens and the gap is closed, the answer does so when it is asked.
        """
        self.looked = not (report is ignore and self.is_certified)
        if report is None or not self.looked:
            return
        with self.watch.phase("residuals"):
            self.disagreement = disagreement(
                self.original,
                self.best.estimate,
                refit=not (self.is_certified or self.stop.stop_requested),
                monitor=lambda _: self.stop.stop_requested,
            )
        if self.disagreement is None:
            return
        report(self.disagreement)
        if self.plan.limited_by_outliers:
            self.heed_outliers(self.disagreement)

    def heed_outliers(self, found: Disagreement) -> None:
        """Limit the time after a first bound if there are many, unless a time limit was set."""
        if self.settings.time_limit is None and found.spreads_over(self.original.chordal.graph):
            self.limited_by_outliers = True
            self.patience = min(self.patience, OUTLIERS_PATIENCE)
            self.limit_time()

    def limit_time(self) -> None:
        """Set when to stop, if there is a useful bound."""
        if not self.lower_bound > 0.0:
            return
        if self.plan.limits == "climb":
            self.climb_deadline = min(self.climb_deadline, time.monotonic() + self.patience)
        elif self.plan.limits == "search":
            self.stop.limit_time(self.patience)

    def descend(
        self, start: Estimate, *, near: bool = False, monitor: Monitor | None = None
    ) -> Solution:
        """Local descent on the cost."""
        monitor = monitor or self.stop
        found = descend(
            self.problem, start, self.newton, near=near, monitor=monitor, watch=self.watch
        )
        self.counts.update(found.counts)
        return found

    def improve_from(self, starts: Iterable[Estimate]) -> bool:
        """Descents from several estimates; those that would end above the best are given up."""
        before = self.best
        for start in starts:
            if self.ends():
                break
            monitor = EarlyStopping(self.stop, self.best.cost, self.settings.hope)
            self.improve(self.descend(start, monitor=monitor))
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
        if self.plan.bounds_estimates and (self.bound is None or not self.is_certified):
            self.improve_bound(best.estimate)

    def improve_bound(self, point: Point, *, tight: bool = True) -> None:
        """Compute the bound of a point and keep it if it is better."""
        if self.stop.should_stop():
            return
        sharp = self.plan.sharp
        with self.watch.phase("certify"), suppress(NumericalError, np.linalg.LinAlgError):
            bound = bounding.bound_near(
                self.normalized, point, self.cost, sharp=sharp, tight=tight and not sharp
            )
            if bound is not None:
                self.counts["factorizations"] += bound.factorizations
            if self.plan.climbs_cost:
                if bound is not None:
                    self.counts["nonzeros"] = max(self.counts["nonzeros"], bound.nonzeros)
                if not tight or (bound is not None and self.is_of_all(bound, point)):
                    self.exhausted = point
            self.keep_bound(bound)

    def is_of_all(self, bound: DualBound, point: Point) -> bool:
        """Whether a tight bound leaves out no part of the graph, as one by parts may."""
        cost = self.normalized.eased.cost(point)
        return cost - bound.value <= self.normalized.tolerance(cost) or not self.normalized.parts

    def keep_bound(self, bound: DualBound | None) -> None:
        """Keep a bound if it is the best so far; the first useful one begins the end."""
        if bound is not None and (self.bound is None or bound.value > self.bound.value):
            self.bound = bound
        self.limit_time()

    def ends(self) -> bool:
        """Whether the gap is closed, or a stop leaves the rest of the search out."""
        return self.is_certified or self.stop.should_stop()

    @property
    def watch(self) -> Stopwatch:
        """The stopwatch of all phases, which begins anew with the search."""
        return self.stop.watch

    @property
    def lower_bound(self) -> float:
        """The best lower bound so far, which is never negative."""
        return max(self.bound.value, 0.0) if self.bound else 0.0

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        closed = self.cost - self.lower_bound <= self.normalized.tolerance(self.cost)
        return closed or self._fits(self.best)

    def _fits(self, best: Solution) -> bool:
        """Whether the best estimate meets all measurements."""
        if self._fit is None or self._fit[0] is not best:
            self._fit = best, self.normalized.fits(best.estimate)
        return self._fit[1]

    @property
    def minimum(self) -> LocalMinimum:
        """The best estimate so far with its bound."""
        settled, descended = self.best.status in self.plan.settled, self.plan.descended
        return LocalMinimum(self.best.estimate, self.cost, settled, self.bound, descended)

    @property
    def has_reached_the_floor(self) -> bool:
        """Whether no point of the relaxation is lower than the best estimate, beyond rounding."""
        return self.best.cost - self.floor <= self.normalized.tolerance(self.best.cost)

    @property
    def status(self) -> Status:
        """How the search ended."""
        limit = Status.TIME_LIMIT if self.ended_early else None
        return self.stop.ended_by or limit or self.best.status


def _as_close_as(normalized: NormalizedProblem[Any], newton: NewtonSettings) -> NewtonSettings:
    """Settings of descents that end as close to the minimum as the certificate can tell."""
    if normalized.tier is Tier.PROOF:
        return replace(newton, enough=0.0)
    return newton if normalized.problem.measured.has_positions else _of_rotations(newton)


@lru_cache
def _of_rotations(newton: NewtonSettings) -> NewtonSettings:
    # A certificate of rotations alone compensates nothing but their rounding.
    return replace(newton, enough=0.1 * newton.enough)
