"""The certified search for graphs with measured distances: climb, bound, round, descend."""

from __future__ import annotations

from dataclasses import replace

from certpgo.certify import Tier
from certpgo.certify.ranged import RangedCase, Search
from certpgo.costs.ranges import RangeProblem
from certpgo.graph import Estimate
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Solution
from certpgo.solvers.certified.pipeline import CertifiedSolution
from certpgo.solvers.certified.settings import SolveSettings

#: Where the search began, for reports.
ORIGIN = "a random point of higher rank"


def search_ranges(
    problem: RangeProblem, settings: SolveSettings, initial: Estimate | None, monitor: Monitor
) -> CertifiedSolution:
    """The best estimate found, with what is proven about it.

    Raises
    ------
    InputError
        An initial estimate of another graph, tolerances out of range, or the proof tier.
    NumericalError
        No descent succeeded.
    """
    if initial is not None:
        problem.check(initial)
    tier = settings.tier or Tier.STANDARD
    case = RangedCase.of(problem, tier, settings.rtol, settings.atol, monitor)
    stop = case.stop
    with stop.within(settings.time_limit):
        search = Search(case, settings.max_rank)
        search.run(initial)
    found = search.basin
    certificate = search.explained(case.certificate(found.point, found))
    solution = Solution(
        estimate=found.point,
        cost=problem.cost(found.point),
        status=stop.ended_by or search.status,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=certificate.lower_bound,
        seconds=stop.watch.seconds,
        trace=tuple(stop.trace),
        note=f"initialized by {ORIGIN}; the relaxation ended at rank {search.rank}",
    )
    levels = tuple(replace(level, cost=case.unit * level.cost) for level in search.levels)
    return CertifiedSolution(solution, certificate, ORIGIN, levels, settings, problem)
