"""The search in the cost of another program, over surrogates.

From the chordal optimum, descend on the cost f. Where the surrogate at the end does not certify it,
the Riemannian staircase minimises the surrogate's relaxation: its bound is one on f, and its
rounded minimizer begins another descent, since a surrogate is below f everywhere and equal to it at
the current point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.verdict import loses_to_rounding
from certpgo.certify.wording import early
from certpgo.errors import GraphError
from certpgo.graph import Estimate
from certpgo.graph.phrases import counted
from certpgo.graph.priors import mirrored_by
from certpgo.graph.relaxed_point import Lift
from certpgo.graph.trees import tree_initialization
from certpgo.optimize import similarity_starts
from certpgo.optimize.initialization import Start
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.solve import bounding
from certpgo.solve.outliers import ignore
from certpgo.solve.range_search import RangeSearch
from certpgo.solve.search_loop import Search, normalized_for
from certpgo.solve.settings import OUTLIERS_PATIENCE, SolveSettings
from certpgo.solve.staircase import Staircase

#: Verdicts whose gap something keeps open.
UNPROVEN = (Verdict.BOUNDED, Verdict.UNDECIDED)
#: Surrogates after which the search does not begin again.
SURROGATES = 10


class SurrogateSearch(Search):
    """The search under another program's cost: points of its surrogates' relaxations.

    Measurements that disagree with the rest are those that do under the cost; they are looked for
    after the first descent. Where the chordal search before it finds many, it is short.
    """

    sharp = True

    def __init__(
        self,
        posed: Any,
        normalized: NormalizedProblem[Any],
        settings: SolveSettings,
    ) -> None:
        super().__init__(posed, normalized, settings)
        asked, most = settings.max_rank, posed.most_ranks
        ranks = most if asked is None else min(max(asked - posed.d, 0), most)
        self.normalized = replace(self.normalized, ranks=ranks)
        self.hurried, self.surrogates = False, 0
        self.of_edges_alone = not (posed.measured.blocks or posed.takes_scales)

    def starts(self, initial: Start | None) -> Iterator[Callable[[], Start]]:
        """Where descents begin; the search under F is left out where an estimate is given."""
        if initial is not None and not self.problem.takes_scales:
            yield lambda: self.given(initial)
        else:
            yield from super().starts(initial)

    def own_starts(self) -> Iterable[Callable[[], Start]]:
        """The best estimate under F; over similarities those of `certpgo.optimize`."""
        if self.problem.takes_scales:
            return similarity_starts.starts(self.problem)
        return [self.chordal_start]

    def chordal_start(self) -> Start:
        """The best estimate under F, found in half of the time; else along a tree."""
        try:
            limit, problem = self.settings.time_limit, self.posed.isotropic
        except GraphError:  # what F has no terms for joins some nodes
            return Start(tree_initialization(self.posed.graph), "a tree of measurements")
        tier = None if self.tier is Tier.PROOF else self.tier
        half = replace(
            self.settings,
            tier=tier,
            patience=0.5 * self.settings.patience,
            time_limit=None if limit is None else 0.5 * limit,
        )
        normalized = normalized_for(problem, half, self.stop.monitor)
        kind: type[Search] = RangeSearch if problem.is_lifted else Staircase
        self.chordal = found = kind(problem, normalized, half).solved(None, None, ignore)
        for phase, seconds in found.solution.seconds.items():
            self.watch.seconds[phase] = self.watch.seconds.get(phase, 0.0) + seconds
        self.stop.interrupted |= found.solution.status is Status.INTERRUPTED
        if found.disagreement is not None and found.disagreement.spreads_over(found.graph):
            self.hurry()
        best = "optimum" if found.verdict is Verdict.CERTIFIED else "best estimate found"
        return Start(found.estimate, f"the {best} under the chordal cost")

    def hurry(self) -> None:
        """Search for a short time only after a first bound, unless a time limit was set."""
        if self.settings.time_limit is None:
            self.hurried = True
            self.patience = min(self.patience, OUTLIERS_PATIENCE)

    def lose_patience(self) -> None:
        """Set when to stop, if there is a useful bound."""
        if self.basin.value > 0.0:
            self.stop.hurry(self.patience)

    def relaxation(self) -> Iterator[Lift]:
        """Minimise surrogates, and begin again where that leads to a lower cost."""
        while not self.ends() and self.surrogates < SURROGATES:
            before, tried = self.best, 0
            for found in bounding.reached(self.normalized, before.estimate, self.cost):
                self.keep_bound(found.bound)
                if found.stair is not None and not self.ends():
                    tried = found.number + 1
                    self.levels.append(found.stair.level)
                    yield found.stair.point
                if self.best is not before or self.ends():
                    break
            self.surrogates += tried
            if self.best is before:
                return

    def roundings(self, point: Lift) -> Iterable[Estimate]:
        """Estimates near a point; with many outliers a bound comes first: descents are long."""
        hopeless = self.hurried and self.basin.value <= 0.0
        return () if hopeless else super().roundings(point)

    def finish(self) -> None:
        """A bound by a lower cost, if there is no other."""
        if self.basin.value <= 0.0 and not self.ends():
            self.keep_bound(bounding.lowered_bound(self.normalized, self.best.estimate))
        self.ended_early = self.patience < math.inf and self.stop.cut is Status.TIME_LIMIT
        if not self.problem.takes_scales:  # of one surrogate after another
            self.levels = [Level(self.problem.d, self.best.cost, self.status)]

    def keep(self, best: Solution) -> None:
        """Make a solution the best so far, and compute its bound."""
        self.best, self.cost = best, self.normalized.cost_upper(best.estimate)
        self.improve_bound(best.estimate)

    def keep_bound(self, bound: DualBound | None) -> None:
        """Keep a bound if it is the best so far; the first useful one begins the end."""
        had_none = self.basin.value <= 0.0
        super().keep_bound(bound)
        if had_none:
            self.lose_patience()

    @property
    def basin(self) -> LocalMinimum:
        """The best estimate so far with its bound."""
        settled = self.best.status is Status.CONVERGED
        return LocalMinimum(self.best.estimate, self.cost, settled, self.bound, descended=False)

    @property
    def is_tight(self) -> bool:
        """Whether only rounding keeps the gap open."""
        return loses_to_rounding(self.normalized, self.bound, self.cost)

    @property
    def ending(self) -> str:
        """Where the search ended, and how to continue it if its own limit ended it."""
        surrogates = counted(self.surrogates, "surrogate{s}")
        minimised = f"; {surrogates} minimised" if self.surrogates else ""
        if self.problem.takes_scales:
            minimised = f"; the staircase ended at rank {self.levels[-1].rank}"
        return minimised + (f"; ended {early(self.patience)}" if self.ended_early else "")

    def obstacle(self, certificate: Certificate) -> Obstacle:
        """What keeps the gap open after the search."""
        stopped, found = self.stop.cut, certificate.obstacle
        if stopped is not None and certificate.verdict is Verdict.UNDECIDED:
            return Obstacle(LimitedBy.STOPPED, True, self.problem.d, stopped)
        if self.problem.takes_scales and certificate.verdict in UNPROVEN:
            return replace(found, searched=True, rank=self.levels[-1].rank)
        loose = found.kind is LimitedBy.LOOSE
        if stopped is None and loose and certificate.verdict is Verdict.BOUNDED:
            return replace(found, mirrored=mirrored_by(self.posed.measured))
        return found
