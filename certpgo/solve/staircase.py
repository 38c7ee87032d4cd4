"""The search for an estimate and its bound: initialize, descend, climb, round, weaken the bound.

The Riemannian staircase (Boumal 2015; Rosen et al., SE-Sync, IJRR 2019) from rank d: if the
certificate matrix of a local minimum has a negative eigenvalue, low-rank optimization escapes along
its eigenvector at the next rank, and the result is rounded and polished.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.wording import early
from certpgo.errors import InputError
from certpgo.graph.priors import mirrored_by
from certpgo.graph.relaxed_point import Lift, Point
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import Problem
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.curvature import negative_curvature, resolution
from certpgo.optimize.initialization import Start, start_of
from certpgo.optimize.randomized_rounding import roundings
from certpgo.optimize.solution import Level, Status
from certpgo.solve import bounding
from certpgo.solve.outliers import agrees, disagreement
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Report, Search
from certpgo.solve.settings import OUTLIERS_PATIENCE, SolveSettings


class Staircase(Search):
    """The search under F: points of the relaxation are local minima of rising rank.

    Parameters
    ----------
    highest : the largest rank; by default that of the settings

    Raises
    ------
    InputError
        That is below d.
    """

    posed: Problem
    problem: Problem

    def __init__(
        self, posed: Problem, normalized: NormalizedProblem[Any], settings: SolveSettings
    ) -> None:
        super().__init__(posed, normalized, settings)
        self.settings = _as_close_as(normalized, settings)
        d, limit = self.problem.d, settings.max_rank
        self.highest = d + posed.most_ranks if limit is None else limit
        if self.highest < d:
            raise InputError(f"the maximal rank must be at least {d}, not {self.highest}")
        self.impatient = math.inf
        self.exhausted: Point | None = None  # point without a better bound
        self.floor = -math.inf  # the relaxation's minimum up to rounding, once it is reached

    def own_starts(self) -> Iterable[Callable[[], Start]]:
        """A computed initialization."""
        return [self.own_start]

    def own_start(self) -> Start:
        """The initialization that suits the problem."""
        with self.watch.phase("start"):
            return start_of(self.problem)

    def look_for_outliers(self, report: Report | None) -> None:
        """Look for measurements that disagree with the rest, and report them."""
        if report is None:
            return
        refit = not self.is_done
        with self.watch.phase("residuals"):
            found = disagreement(
                self.posed,
                self.best.estimate,
                refit=refit,
                monitor=lambda _: self.stop.stop_requested,
            )
        if found is None:
            return
        report(found)
        self.disagreement = found
        if found.spreads_over(self.problem.graph):
            self.hurry()

    def hurry(self) -> None:
        """Climb for a short time only after a first bound, unless a time limit was set."""
        if self.settings.time_limit is None:
            self.patience = min(self.patience, OUTLIERS_PATIENCE)
            self.lose_patience()

    def lose_patience(self) -> None:
        """Set when to stop climbing, if there is a useful bound."""
        if self.basin.value > 0.0:
            self.impatient = min(self.impatient, time.monotonic() + self.patience)

    def relaxation(self) -> Iterator[Lift]:
        """Escape to higher ranks until the gap is closed or the relaxation is solved."""
        self.point: Point = self.best.estimate
        while not self.ends():
            eigenvalue, direction = self.way_down(self.point)
            rank = self.levels[-1].rank + 1
            self.ended_early = self.is_impatient
            if eigenvalue is None or rank > self.highest or self.ended_early:
                return
            before = self.normalized.eased.cost(self.point)
            self.point = lift = self.escape(self.point, rank, direction)
            lower = self.levels[-1].cost
            negligible = self.settings.negligible * self.normalized.tolerance(lower)
            if before - lower <= negligible and not self.is_done:
                self.floor = lower  # the eigenvalue was rounding
                return
            yield lift
            if self.best.cost < (1.0 - self.settings.same_cost) * lower:
                self.point = self.best.estimate  # no gain at the higher rank yet
            elif not self.is_certified:
                self.improve_bound(self.point)

    def finish(self) -> None:
        """Descents from random roundings; then a weaker bound, if there is no other."""
        self.round(self.point)
        self.settle_for_less(self.point)

    def way_down(self, point: Point) -> tuple[float | None, FloatArray]:
        """A negative eigenvalue of the certificate matrix with its vector; None at the minimum.

        At the minimum, records the relaxation's lowest cost. Otherwise computes a first bound if
        the eigenvalue predicts a useful one and the climb may take long.
        """
        with self.watch.phase("escape"):
            eigenvalue, direction = negative_curvature(self.normalized.eased, point)
        level = self.levels[-1]
        # No point of the relaxation is lower by more than this.
        fall = -eigenvalue * direction.size
        negligible = self.settings.negligible * self.normalized.tolerance(self.best.cost)
        if -eigenvalue <= resolution(self.normalized.eased) or fall <= negligible:
            self.floor = self.normalized.eased.cost(point)
            return None, direction
        self.levels[-1] = replace(level, eigenvalue=self.normalized.unit * eigenvalue)
        if level.rank > self.problem.d and level.cost - fall > self.basin.value:
            self.improve_bound(point, tight=False)
        return eigenvalue, direction

    def escape(self, point: Point, rank: int, direction: FloatArray) -> Lift:
        """Low-rank optimization from a saddle point."""
        residual = math.sqrt(self.cost / self.problem.scale)
        inner = self.settings.newton
        found = low_rank.descend(
            self.normalized.eased,
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
        # Looser relaxations have points of higher rank and need more rounds.
        more = self.levels[-1].rank - self.problem.d
        n = self.problem.n
        few, nodes, rounds = self.settings.few, self.settings.round_nodes, self.settings.rounds
        failures, limit = 0, max(1, min(more**2, n // few, max(2, nodes // n), rounds))
        if self.has_reached_the_floor or self.ends():
            return
        rng = np.random.default_rng(0)
        while failures < limit and not (self.has_reached_the_floor or self.ends()):
            before = self.best
            with self.watch.phase("round"):
                starts = roundings(self.problem, point, before.estimate, rng)
            self.improve_hopefully(starts)
            failures = failures + 1 if self.best is before else 0

    def improve_bound(self, point: Point, *, tight: bool = True) -> None:
        """Compute the bound of a point and keep it if it is better."""
        if self.stop.should_stop():
            return
        with self.watch.phase("certify"):
            bound = bounding.bound_near(self.normalized, point, self.cost, sharp=False, tight=tight)
        if not tight or (bound is not None and self.is_of_all(bound, point)):
            self.exhausted = point
        if bound is None:
            return
        self.counts["factorizations"] += bound.factorizations
        self.counts["nonzeros"] = max(self.counts["nonzeros"], bound.nonzeros)
        self.keep_bound(bound)
        self.lose_patience()

    def is_of_all(self, bound: DualBound, point: Point) -> bool:
        """Whether a tight bound leaves out no part of the graph, as one by parts may."""
        cost = self.normalized.eased.cost(point)
        return cost - bound.value <= self.normalized.tolerance(cost) or not self.normalized.parts

    def settle_for_less(self, point: Point) -> None:
        """Bounds weakened by a negative eigenvalue, if there is no other."""
        for candidate in (point, self.best.estimate):
            if not self.is_certified and candidate is not self.exhausted:
                self.improve_bound(candidate, tight=False)
            if self.basin.value > 0.0:
                break

    @property
    def has_reached_the_floor(self) -> bool:
        """Whether no point of the relaxation is lower than the best estimate, beyond rounding."""
        return self.best.cost - self.floor <= self.normalized.tolerance(self.best.cost)

    @property
    def is_done(self) -> bool:
        """Whether the gap is closed or a stop was requested."""
        return self.is_certified or self.stop.stop_requested

    @property
    def is_impatient(self) -> bool:
        """Whether the time for climbing is over."""
        return time.monotonic() > self.impatient

    @property
    def status(self) -> Status:
        """How the search ended."""
        limit = Status.TIME_LIMIT if self.ended_early else None
        return self.stop.ended_by or limit or self.best.status

    def result(self, certificate: Certificate) -> CertifiedSolution:
        """The result; outliers of a first descent to a local minimum may be none."""
        if self.disagreement is not None and agrees(self.posed, self.best.estimate):
            self.disagreement = None
        return super().result(certificate)

    @property
    def is_tight(self) -> bool:
        """Whether only rounding keeps the gap open."""
        return self.is_certified or self.has_reached_the_floor

    @property
    def ending(self) -> str:
        """Where the search ended, and how to continue it if its own limit ended it."""
        where = f"; the staircase ended at rank {self.levels[-1].rank}"
        return f"{where}, {early(self.patience)}" if self.ended_early else where

    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps the gap open after the search."""
        if certificate.verdict not in (Verdict.BOUNDED, Verdict.UNDECIDED):
            return certificate.obstacle
        rank, stopped, graph = self.levels[-1].rank, self.stop.cut, self.problem.graph
        patience = self.patience if self.ended_early else None
        about = Obstacle(certificate.limited_by, True, rank, stopped, patience)
        if certificate.verdict is Verdict.BOUNDED and graph.has_positions:
            about = replace(about, mirrored=mirrored_by(graph))
        if self.has_reached_the_floor and stopped is None:
            return replace(about, kind=LimitedBy.ROUNDING, mirrored=None)
        if about.mirrored is not None:
            return replace(about, kind=LimitedBy.LOOSE)
        if stopped is not None:
            return replace(about, kind=LimitedBy.STOPPED)
        return replace(about, kind=LimitedBy.STOPPED if self.ended_early else LimitedBy.LOOSE)


def _as_close_as(normalized: NormalizedProblem[Any], settings: SolveSettings) -> SolveSettings:
    """Settings whose descents end as close to the minimum as the certificate can tell."""
    if normalized.tier is Tier.PROOF:
        return replace(settings, newton=replace(settings.newton, enough=0.0))
    if normalized.problem.has_positions:
        return settings
    return _of_rotations(settings)


@lru_cache
def _of_rotations(settings: SolveSettings) -> SolveSettings:
    # A certificate of rotations alone compensates nothing but their rounding.
    newton = settings.newton
    return replace(settings, newton=replace(newton, enough=0.1 * newton.enough))
