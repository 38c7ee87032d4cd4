"""The search in the cost of another program, over surrogates.

From the chordal optimum, descend on the cost f. Where the surrogate at the end does not certify it,
the Riemannian staircase minimises the surrogate's relaxation: its bound is one on f, and its
rounded minimizer begins another descent, since a surrogate is below f everywhere and equal to it at
the current point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from certpgo.certify.case import Basin
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound
from certpgo.certify.own_cost import RANKS, OwnCostCase, is_provable
from certpgo.costs.problem import InformationProblem
from certpgo.graph import Estimate
from certpgo.graph.lift import Lift, rounded
from certpgo.graph.wording import counted
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.progress import Stop
from certpgo.optimize.solution import Level, Solution, Status
from certpgo.solvers.certified.disagreement import Disagreement
from certpgo.solvers.certified.pipeline import GIVEN, STOPPED, CertifiedSolution, search_and_certify
from certpgo.solvers.certified.settings import SolveSettings

#: Surrogates after which the search does not begin again.
SURROGATES = 10


def search_own_cost(
    problem: InformationProblem,
    settings: SolveSettings,
    initial: Estimate | None,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None = None,
) -> CertifiedSolution:
    """The best estimate under the problem's cost, with its certificate.

    Measurements that disagree with the rest are looked for in the chordal search.
    """
    tier = settings.tier or Tier.STANDARD
    case = OwnCostCase.of(problem, tier, settings.rtol, settings.atol, monitor)
    stop = case.stop
    with stop.within(settings.time_limit):
        # Cheaper bounds suffice to guide the search.
        steering = replace(case, tier=Tier.STANDARD) if case.tier is Tier.PROOF else case
        chordal = None
        if initial is None:
            first = settings if steering is case else replace(settings, tier=None)
            if settings.time_limit is not None:  # the rest is for the cost itself
                first = replace(first, time_limit=0.5 * settings.time_limit)
            chordal = search_and_certify(problem.chordal, first, None, monitor, on_disagreement)
            initial = chordal.estimate
            _follow(stop, chordal)
        ranks = RANKS if settings.max_rank is None else max(settings.max_rank - problem.d, 0)
        search = _Search(replace(steering, ranks=min(ranks, RANKS)), settings, initial)
        search.go_on()
        certificate = _certificate(search, None if settings.tier is None else case.tier)
        ended = stop.ended_by or search.status
    if stop.cut is not None and certificate.verdict is Verdict.UNDECIDED:
        certificate = replace(certificate, reason=STOPPED)
    name = GIVEN
    if chordal is not None:
        certified = chordal.verdict is Verdict.CERTIFIED
        name = f"the {'optimum' if certified else 'best estimate found'} under the chordal cost"
    surrogates = counted(search.surrogates, "surrogate{s}")
    minimised = f"; {surrogates} minimised" if search.surrogates else ""
    solution = Solution(
        estimate=search.best.point,
        cost=problem.cost(search.best.point),
        status=ended,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=certificate.lower_bound,
        seconds=stop.watch.seconds,
        trace=tuple(stop.trace),
        note=f"initialized by {name}{minimised}",
    )
    level = Level(problem.d, solution.cost, ended)
    disagreement = None if chordal is None else chordal.disagreement
    return CertifiedSolution(
        solution, certificate, name, (level,), settings, problem, disagreement, chordal
    )


def _certificate(search: _Search, tier: Tier | None) -> Certificate:
    """The certificate at a tier; by default the proof tier's if only rounding is in the way."""
    best = search.best
    support = None if best.bound is None else best.bound.support
    certificate = search.case.certificate(best.point, best)
    # A bound from a point of higher rank says that the relaxation is loose.
    tight = support is not None and not isinstance(support.point, Lift)
    rounding = tight and search.case.may_close(certificate)
    escalates = (
        rounding and is_provable(search.case.problem) and tier is None and not search.stop.cuts()
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

    def __init__(self, case: OwnCostCase, settings: SolveSettings, start: Estimate) -> None:
        self.case, self.settings, self.stop = case, settings, case.stop
        self.surrogates = 0
        self.best, self.status = self.basin(start)

    def go_on(self) -> None:
        """Climb on surrogates, and begin again where that leads to a lower cost."""
        while not self.ends():
            start, tried = self.best, 0
            for found in self.case.reached(start.point, start.cost):
                self.keep(found.bound)
                if isinstance(found.point, Lift) and not self.ends():
                    tried = found.number + 1
                    self.improve(rounded(found.point))
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
            self.best = replace(self.best, bound=bound)

    def improve(self, start: Estimate) -> None:
        """Descend, and keep the end if its cost is lower."""
        bound = self.best.bound
        found, status = self.basin(start)
        if found.cost < (1.0 - self.settings.same_cost) * self.best.cost:
            self.best, self.status = found, status
            self.keep(bound)

    def basin(self, start: Estimate) -> tuple[Basin, Status]:
        """The end of descent on the cost, with its bound."""
        found = self.case.descent(start)
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
