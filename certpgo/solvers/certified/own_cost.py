"""The search in the cost of another program, over surrogates.

From the chordal optimum, descend on the cost f. Where the surrogate at the end does not certify it,
the Riemannian staircase minimises the surrogate's relaxation: its bound is one on f, and its
rounded minimizer begins another descent, since a surrogate is below f everywhere and equal to it at
the current point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from certpgo.certify.case import Basin
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.own_cost import RANKS, OwnCostCase
from certpgo.certify.wording import early
from certpgo.costs.descent import descend
from certpgo.costs.problem import InformationProblem
from certpgo.errors import NumericalError
from certpgo.graph.lift import Lift, rounded
from certpgo.graph.priors import mirrored_by
from certpgo.graph.wording import counted
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.progress import Hopeful, Stop
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.optimize.starts import Start
from certpgo.solvers.certified.disagreement import Disagreement
from certpgo.solvers.certified.pipeline import CertifiedSolution, search_and_certify
from certpgo.solvers.certified.settings import OUTLIERS_PATIENCE, SolveSettings

#: Surrogates after which the search does not begin again.
SURROGATES = 10


def search_own_cost(
    problem: InformationProblem,
    settings: SolveSettings,
    initial: Start | None,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None = None,
    stored: Start | None = None,
) -> CertifiedSolution:
    """The best estimate under the problem's cost, with its certificate.

    Measurements that disagree with the rest are looked for in the chordal search.

    Parameters
    ----------
    stored : another start, which is tried if the first descent is not certified
    """
    tier = settings.tier or Tier.STANDARD
    case = OwnCostCase.of(problem, tier, settings.rtol, settings.atol, monitor)
    stop = case.stop
    with stop.within(settings.time_limit):
        # Cheaper bounds suffice to guide the search.
        steering = replace(case, tier=Tier.STANDARD) if case.tier is Tier.PROOF else case
        chordal, start, hurried = None, initial, False
        if start is None:
            first = settings if steering is case else replace(settings, tier=None)
            chordal = _chordal(problem, first, monitor, on_disagreement)
            start = Start(chordal.estimate, _name(chordal))
            _follow(stop, chordal)
            found = chordal.disagreement
            hurried = found is not None and found.is_widespread(chordal.graph)
        ranks = RANKS if settings.max_rank is None else max(settings.max_rank - problem.d, 0)
        steering = replace(steering, ranks=min(ranks, RANKS))
        search = _Search(steering, settings, start, hurried=hurried)
        with stop.for_at_most():
            search.go_on(stored)
        certificate = _certificate(search, None if settings.tier is None else case.tier)
        ended = stop.ended_by or search.status
    if stop.cut is not None and certificate.verdict is Verdict.UNDECIDED:
        obstacle = Obstacle(LimitedBy.STOPPED, True, problem.d, stop.cut)
        certificate = replace(certificate, obstacle=obstacle)
    elif stop.cut is None and certificate.verdict is Verdict.BOUNDED:
        mirrored = mirrored_by(problem.graph.isotropic)
        certificate = replace(
            certificate, obstacle=replace(certificate.obstacle, mirrored=mirrored)
        )
    surrogates = counted(search.surrogates, "surrogate{s}")
    minimised = f"; {surrogates} minimised" if search.surrogates else ""
    limit = f"; ended {early(search.patience)}" if search.ended_early else ""
    solution = Solution(
        estimate=search.best.point,
        cost=problem.cost(search.best.point),
        status=ended,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=certificate.lower_bound,
        seconds=stop.watch.seconds,
        trace=tuple(stop.trace),
        note=f"initialized by {search.origin}{minimised}{limit}",
    )
    level = Level(problem.d, solution.cost, ended)
    disagreement = None if chordal is None else chordal.disagreement
    return CertifiedSolution(
        solution, certificate, search.start, (level,), settings, problem, disagreement, chordal
    )


def _chordal(
    problem: InformationProblem,
    settings: SolveSettings,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None,
) -> CertifiedSolution:
    """The search under the chordal cost, in half of the time: the rest is for the cost itself."""
    limit = settings.time_limit
    half = replace(
        settings,
        patience=0.5 * settings.patience,
        time_limit=None if limit is None else 0.5 * limit,
    )
    return search_and_certify(problem.chordal, half, None, monitor, on_disagreement)


def _name(chordal: CertifiedSolution) -> str:
    certified = chordal.verdict is Verdict.CERTIFIED
    return f"the {'optimum' if certified else 'best estimate found'} under the chordal cost"


def _certificate(search: _Search, tier: Tier | None) -> Certificate:
    """The certificate at a tier; by default the proof tier's if only rounding is in the way."""
    best = search.best
    support = None if best.bound is None else best.bound.support
    certificate = search.case.certificate(best.point, best)
    # A bound from a point of higher rank says that the relaxation is loose.
    tight = support is not None and not isinstance(support.point, Lift)
    rounding = tight and search.case.may_close(certificate)
    escalates = (
        rounding and not search.case.problem.unprovable and tier is None and not search.stop.cuts()
    )
    if not (tier is Tier.PROOF or escalates):
        return certificate
    with search.stop.watch.phase("prove"):
        case = replace(search.case, tier=Tier.PROOF)
        # A search stopped before the requested proof must not return a weaker tier instead.
        bound = None if search.stop.cuts() or best.bound is None else case.reproven(best.bound)
        proven = case.certificate(best.point, replace(best, bound=bound))
    better = proven.lower_bound > certificate.lower_bound
    return proven if tier is Tier.PROOF or better else certificate


def _follow(stop: Stop, found: CertifiedSolution) -> None:
    """Add the seconds of a search within this one, and stop if it was interrupted."""
    for phase, seconds in found.solution.seconds.items():
        stop.watch.seconds[phase] = stop.watch.seconds.get(phase, 0.0) + seconds
    stop.interrupted = stop.interrupted or found.solution.status is Status.INTERRUPTED


class _Search:
    """The best estimate and bound so far."""

    def __init__(
        self, case: OwnCostCase, settings: SolveSettings, start: Start, *, hurried: bool
    ) -> None:
        self.case, self.settings, self.stop = case, settings, case.stop
        self.hurried = hurried and settings.time_limit is None
        self.patience = settings.patience if settings.time_limit is None else math.inf
        if self.hurried:
            self.patience = min(self.patience, OUTLIERS_PATIENCE)
        self.surrogates, self.ended_early = 0, False
        self.start = self.origin = start.name
        self.best, self.status = self.basin(self.case.descent(start.estimate))

    def go_on(self, stored: Start | None) -> None:
        """Climb on surrogates, and begin again where that leads to a lower cost.

        Also descend from another start, before that.
        """
        if self.best.value > 0.0:
            self.stop.hurry(self.patience)
        if stored is not None and not self.ends():
            self.try_stored(stored)
        self.climb()
        self.ended_early = self.patience < math.inf and self.stop.cut is Status.TIME_LIMIT

    def climb(self) -> None:
        """Minimise surrogates, as `go_on` says."""
        while not self.ends():
            start, tried = self.best, 0
            for found in self.case.reached(start.point, start.cost):
                self.keep(found.bound)
                # With many outliers a bound comes first: descents are long, and worth little.
                wanted = not self.hurried or self.best.value > 0.0
                if isinstance(found.point, Lift) and not self.ends():
                    tried = found.number + 1
                    if wanted:
                        self.improve(self.case.descent(rounded(found.point)))
                if self.best.cost < start.cost or self.ends():
                    break
            self.surrogates += tried
            if self.best.cost == start.cost or self.surrogates >= SURROGATES:
                break
        if self.best.value <= 0.0 and not self.ends():
            self.keep(self.case.lowered_bound(self.best.point))

    def keep(self, bound: DualBound | None) -> None:
        """Keep a bound if it is the best so far."""
        if bound is not None and bound.value > self.best.value:
            if self.best.value <= 0.0:
                self.stop.hurry(self.patience)
            self.best = replace(self.best, bound=bound)

    def try_stored(self, start: Start) -> None:
        """Descend from another estimate as long as that may lead to a lower cost."""
        hopeful = Hopeful(self.stop, self.best.cost, self.settings.hope)

        problem, watch = self.case.problem, self.stop.watch
        with suppress(NumericalError, np.linalg.LinAlgError):
            if self.improve(descend(problem, start.estimate, monitor=hopeful, watch=watch)):
                self.start = start.name
                self.origin = f"{start.name}, which led to a lower cost than {self.origin}"

    def improve(self, found: Solution) -> bool:
        """Keep the end of a descent if its cost is lower; returns whether it is."""
        cost = self.case.cost_upper(found.estimate)
        better = cost < (1.0 - self.settings.same_cost) * self.best.cost
        if better:
            bound = self.best.bound
            self.best, self.status = self.basin(found)
            self.keep(bound)
        return better

    def basin(self, found: Solution) -> tuple[Basin, Status]:
        """The end of a descent on the cost, with its bound."""
        with self.stop.watch.phase("certify"):
            basin = self.case.basin(found.estimate, False)
        return replace(basin, settled=found.status is Status.CONVERGED), found.status

    def ends(self) -> bool:
        """Whether the gap is closed, or a stop leaves the rest of the search out."""
        return self.is_certified or self.stop.cuts()

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        return self.best.cost - self.best.value <= self.case.tolerance(self.best.cost)
