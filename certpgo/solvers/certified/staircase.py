"""The search for an estimate and its bound: initialize, descend, climb, round, weaken the bound.

The Riemannian staircase (Boumal 2015; Rosen et al., SE-Sync, IJRR 2019) from rank d: if the
certificate matrix of a local minimum has a negative eigenvalue, low-rank optimization escapes along
its eigenvector at the next rank, and the result is rounded and polished.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from certpgo.certify import DualBound, cost_upper
from certpgo.certify.case import Basin, Case
from certpgo.certify.curvature import negative_curvature, resolution
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.lift import Lift, Point, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.optimize import low_rank
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.newton import newton
from certpgo.optimize.progress import Hopeful
from certpgo.optimize.roundings import roundings
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.optimize.starts import Start, start_of
from certpgo.solvers.certified.settings import OUTLIERS_PATIENCE, SolveSettings


class Staircase:
    """The search: the best estimate and bound so far, and how they were found.

    The constructor runs the first descent at rank d and computes its bound: from the initial
    estimate and, if that is not certified, from a computed initialization.

    Parameters
    ----------
    case : the normalized problem, its tolerances and the monitor of all phases
    initial : initial estimate; None computes one
    """

    def __init__(self, case: Case, settings: SolveSettings, initial: Start | None) -> None:
        self.case, self.problem, self.settings = case, case.problem, settings
        self.stop, self.watch = case.stop, case.stop.watch
        self.patience = settings.patience if settings.time_limit is None else math.inf
        self.impatient = math.inf
        self.counts: Counter[str] = Counter()
        self.bound: DualBound | None = None
        self.exhausted: Point | None = None  # point without a better bound
        self.floor = -math.inf  # the relaxation's minimum up to rounding, once it is reached
        self.ended_early = False
        start = self.own_start() if initial is None else self.given(initial)
        self.start = self.origin = start.name
        self.best = self.descend(start.estimate, near=start.near)
        self.cost = cost_upper(self.problem, self.best.estimate)
        self.improve_bound(self.best.estimate)
        if initial is not None and settings.try_own_start:
            self.start_again(initial.name)
        self.levels = [Level(self.problem.d, self.best.cost, self.best.status)]

    def start_again(self, initial: str) -> None:
        """Descend from a computed initialization; keep the better result."""
        # The weight of a bridge may raise the tolerance above a possible improvement.
        if self.case.is_sharp(self.basin) or self.stop.cuts():
            return
        with suppress(NumericalError, np.linalg.LinAlgError):
            own = self.own_start()
            if self.improve(self.descend(own.estimate, near=own.near)):
                self.start = own.name
                self.origin = f"{own.name}, which led to a lower cost than {initial}"

    def try_stored(self, start: Start | None) -> None:
        """Descend from another estimate; keep the end if it is better."""
        if start is None or self.ends():
            return
        with suppress(NumericalError, np.linalg.LinAlgError):
            before = self.best
            self.improve_from([self.given(start).estimate])
            if self.best is not before:
                self.start = start.name
                self.origin = f"{start.name}, which led to a lower cost than {self.origin}"
                self.levels = [Level(self.problem.d, self.best.cost, self.best.status)]

    def hurry(self) -> None:
        """Climb for a short time only after a first bound, unless a time limit was set."""
        if self.settings.time_limit is None:
            self.patience = min(self.patience, OUTLIERS_PATIENCE)
            self.lose_patience()

    def lose_patience(self) -> None:
        """Set when to stop climbing, if there is a useful bound."""
        if self.basin.value > 0.0:
            self.impatient = min(self.impatient, time.monotonic() + self.patience)

    def given(self, initial: Start) -> Start:
        """An initial estimate with its best translations."""
        with self.watch.phase("start"):
            return replace(initial, estimate=self.problem.complete(initial.estimate.rotations))

    def own_start(self) -> Start:
        """A computed initialization."""
        with self.watch.phase("start"):
            return start_of(self.problem)

    def go_on(self, highest: int) -> None:
        """Continue if the first descent is not certified."""
        point = self.climb(highest)
        self.round(point)
        self.settle_for_less(point)

    def climb(self, highest: int) -> Point:
        """Escape to higher ranks until the gap is closed or the relaxation is solved.

        Returns the last point of the relaxation.
        """
        point: Point = self.best.estimate
        # After an error, the search continues with what was found before.
        with suppress(NumericalError, np.linalg.LinAlgError):
            while not self.ends():
                eigenvalue, direction = self.way_down(point)
                rank = self.levels[-1].rank + 1
                self.ended_early = self.is_impatient
                if eigenvalue is None or rank > highest or self.ended_early:
                    break
                before = self.problem.cost(point)
                point = self.escape(point, rank, direction)
                lower = self.levels[-1].cost
                if (
                    before - lower <= self.settings.negligible * self.case.tolerance(lower)
                    and not self.is_done
                ):
                    self.floor = lower  # the eigenvalue was rounding
                    break
                poses = point.subset(self.problem.poses)
                nearest = self.problem.complete(rounded(poses).rotations)
                self.improve(self.descend(nearest))
                if self.best.cost < (1.0 - self.settings.same_cost) * lower:
                    point = self.best.estimate  # no gain at the higher rank yet
                elif not self.is_certified:
                    self.improve_bound(point)
        return point

    def way_down(self, point: Point) -> tuple[float | None, FloatArray]:
        """A negative eigenvalue of the certificate matrix with its vector; None at the minimum.

        At the minimum, records the relaxation's lowest cost. Otherwise computes a first bound if
        the eigenvalue predicts a useful one and the climb may take long.
        """
        with self.watch.phase("escape"):
            eigenvalue, direction = negative_curvature(self.problem, point)
        level = self.levels[-1]
        # No point of the relaxation is lower by more than this.
        fall = -eigenvalue * direction.size
        negligible = self.settings.negligible * self.case.tolerance(self.best.cost)
        if -eigenvalue <= resolution(self.problem) or fall <= negligible:
            self.floor = self.problem.cost(point)
            return None, direction
        self.levels[-1] = replace(level, eigenvalue=self.case.unit * eigenvalue)
        if level.rank > self.problem.d and level.cost - fall > self.basin.value:
            self.improve_bound(point, tight=False)
        return eigenvalue, direction

    def escape(self, point: Point, rank: int, direction: FloatArray) -> Lift:
        """Low-rank optimization from a saddle point."""
        residual = math.sqrt(self.cost / self.problem.scale)
        inner = self.settings.newton
        found = low_rank.descend(
            self.problem,
            point,
            rank,
            direction=direction,
            tolerance=max(self.settings.lifted_tolerance * residual, inner.tolerance),
            max_iterations=self.settings.rank_steps,
            loosest=inner.loosest,
            tightest=inner.tightest,
            monitor=lambda step: self.stop(step) or self.is_impatient,
            watch=self.watch,
        )
        self.counts.update(found.counts)
        status = found.status
        if status is Status.INTERRUPTED:
            status = self.stop.ended_by or Status.TIME_LIMIT
        self.levels.append(Level(rank, found.cost, status))
        return found.point

    def round(self, point: Point) -> None:
        """Descents from random roundings and perturbations of the best, while they improve it."""
        rng = np.random.default_rng(0)
        # Looser relaxations have points of higher rank and need more rounds.
        more = self.levels[-1].rank - self.problem.d
        n = self.problem.n
        few, nodes, rounds = self.settings.few, self.settings.round_nodes, self.settings.rounds
        failures, limit = 0, max(1, min(more**2, n // few, max(2, nodes // n), rounds))
        while failures < limit and not (self.has_reached_the_floor or self.ends()):
            before = self.best
            with self.watch.phase("round"):
                starts = roundings(self.problem, point, before.estimate, rng)
            self.improve_from(starts)
            failures = failures + 1 if self.best is before else 0

    def improve_from(self, starts: Iterable[Estimate]) -> None:
        """Descents from several initial estimates; unpromising ones are stopped early."""
        for start in starts:
            if self.ends():
                break
            self.improve(
                self.descend(start, monitor=Hopeful(self.stop, self.best.cost, self.settings.hope))
            )

    def descend(
        self, start: Estimate, *, near: bool = False, monitor: Monitor | None = None
    ) -> Solution:
        """Newton's method at rank d."""
        found = newton(
            self.problem,
            start,
            self.settings.newton,
            near=near,
            monitor=monitor or self.stop,
            watch=self.watch,
        )
        self.counts.update(found.counts)
        return found

    def improve(self, found: Solution) -> bool:
        """Keep a solution if it is better than the best so far; returns whether it is."""
        better = found.cost < (1.0 - self.settings.same_cost) * self.best.cost
        if better:
            self.take(found)
        return better

    def take(self, best: Solution) -> None:
        """Make a solution the best so far, and compute its bound if needed."""
        self.best, self.cost = best, cost_upper(self.problem, best.estimate)
        if self.bound is None or not self.is_certified:
            self.improve_bound(best.estimate)

    def improve_bound(self, point: Point, *, tight: bool = True) -> None:
        """Compute the bound of a point and keep it if it is better."""
        if self.stop.cuts():
            return
        with self.watch.phase("certify"):
            bound = self.case.bound(point, self.cost, sharp=False, tight=tight)
        if not tight or (bound is not None and self.is_of_all(bound, point)):
            self.exhausted = point
        if bound is None:
            return
        self.counts["factorizations"] += bound.factorizations
        self.counts["nonzeros"] = max(self.counts["nonzeros"], bound.nonzeros)
        if self.bound is None or bound.value > self.bound.value:
            self.bound = bound
        self.lose_patience()

    def is_of_all(self, bound: DualBound, point: Point) -> bool:
        """Whether a tight bound leaves out no part of the graph, as one by parts may."""
        cost = self.problem.cost(point)
        return not self.case.parts or cost - bound.value <= self.case.tolerance(cost)

    def settle_for_less(self, point: Point) -> None:
        """Bounds weakened by a negative eigenvalue, if there is no other."""
        for candidate in (point, self.best.estimate):
            if not self.is_certified and candidate is not self.exhausted:
                self.improve_bound(candidate, tight=False)
            if self.basin.value > 0.0:
                break

    def ends(self) -> bool:
        """Whether the gap is closed, or a stop leaves the rest of the search out."""
        return self.is_certified or self.stop.cuts()

    @property
    def status(self) -> Status:
        """How the search ended."""
        limit = Status.TIME_LIMIT if self.ended_early else None
        return self.stop.ended_by or limit or self.best.status

    @property
    def has_reached_the_floor(self) -> bool:
        """Whether no point of the relaxation is lower than the best estimate, beyond rounding."""
        return self.best.cost - self.floor <= self.case.tolerance(self.best.cost)

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        return self.cost - self.basin.value <= self.case.tolerance(self.cost)

    @property
    def is_done(self) -> bool:
        """Whether the gap is closed or a stop was requested."""
        return self.is_certified or self.stop.asked

    @property
    def is_impatient(self) -> bool:
        """Whether the time for climbing is over."""
        return time.monotonic() > self.impatient

    @property
    def basin(self) -> Basin:
        """The best estimate so far with its bound."""
        return Basin(self.best.estimate, self.cost, True, self.bound)
