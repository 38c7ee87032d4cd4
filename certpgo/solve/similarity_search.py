"""The search over similarities: start, descend, bound; climb where that is not tight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.certify.certificate import Certificate, Verdict
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, Point, main_subspace, translations_of
from certpgo.linalg import rotations as so
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.similarity_starts import starts
from certpgo.optimize.solution import Level, Solution
from certpgo.optimize.staircase import climb
from certpgo.solve import bounding
from certpgo.solve.relaxation import SOLVED
from certpgo.solve.search_loop import Report, Search
from certpgo.solve.settings import SolveSettings


class SimilaritySearch(Search):
    """The search over similarities."""

    posed: SimilarityProblem
    problem: SimilarityProblem
    of_edges_alone = False

    def __init__(
        self, posed: SimilarityProblem, normalized: NormalizedProblem[Any], settings: SolveSettings
    ) -> None:
        super().__init__(posed, normalized, settings)
        self.highest = settings.max_rank or self.problem.d + posed.most_ranks
        self.at_minimum = False

    def begin(self, initial: Start | None, report: Report | None) -> None:
        """The first descent, and others until one is certified."""
        if initial is not None:
            self.start = self.origin = initial.name
            self.keep(self.descend(initial.estimate))
            if not self.settings.try_own_start:
                return
        for start in starts(self.problem):
            if initial is not None and self.ends():
                return
            found = self.descend(start.estimate)
            if self.bound is None and math.isinf(self.cost):
                self.start = self.origin = start.name
                self.keep(found)
            elif self.improve(found):
                self.start = start.name
                self.origin = f"{start.name}, which led to a lower cost than {self.origin}"
            if self.ends():
                return

    def relaxation(self) -> Iterator[Lift]:
        """Escape to higher ranks until the gap is closed or the relaxation is solved."""
        if self.ends():
            return
        for end in climb(self.problem, self.best.estimate, self.highest, self.stop):
            self.levels.append(Level(end.point.rank, end.cost, end.status))
            yield end.point
            if self.ends():
                return
            self.improve_bound(end.point)
            if self.is_certified or self.basin.value >= (1.0 - SOLVED) * end.cost:
                return
        self.at_minimum = True

    def roundings(self, point: Lift) -> Iterable[Estimate]:
        """The projections to the main subspace, of either handedness."""
        basis = main_subspace(point.subset(self.problem.poses))
        for hand in (1.0, -1.0):
            B = basis * np.r_[hand, np.ones(point.d - 1)]
            blocks = B.T @ point.rotations
            Q = so.project(blocks)
            scales = np.linalg.norm(point.rotations, axis=(1, 2)) / np.sqrt(point.d)
            scales = np.where(self.problem.graph.free, scales, 1.0)
            yield self.problem.with_optimal_translations(
                Estimate(Q, translations_of(point) @ B, scales=scales)
            )

    def descend(self, start: Estimate, *, monitor: Monitor | None = None) -> Solution:
        """Levenberg and Marquardt's method."""
        return descend(self.problem, start, monitor=monitor or self.stop, watch=self.watch)

    def given(self, initial: Start) -> Start:
        """An initial estimate with its best translations."""
        return replace(initial, estimate=self.problem.settled(initial.estimate))

    def improve_bound(self, point: Point) -> None:
        """Compute the bound of a point and keep it if it is better."""
        if self.stop.should_stop():
            return
        with self.watch.phase("certify"), suppress(NumericalError, np.linalg.LinAlgError):
            bound = bounding.bound_near(self.normalized, point, self.cost, sharp=False)
            if bound is not None:
                self.counts["factorizations"] += bound.factorizations
            self.keep_bound(bound)

    @property
    def is_tight(self) -> bool:
        """Whether only rounding keeps the gap open."""
        return self.at_minimum and self.levels[-1].rank == self.problem.d

    @property
    def ending(self) -> str:
        """Where the search ended."""
        return f"; the staircase ended at rank {self.levels[-1].rank}"

    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps the gap open after the search."""
        if certificate.verdict not in (Verdict.BOUNDED, Verdict.UNDECIDED):
            return certificate.obstacle
        stopped, rank = self.stop.cut, self.levels[-1].rank
        kind = LimitedBy.ROUNDING if self.is_tight else LimitedBy.LOOSE
        return Obstacle(LimitedBy.STOPPED if stopped else kind, True, rank, stopped)
