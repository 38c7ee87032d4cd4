"""The certified search for graphs with measured distances: climb, bound, round, descend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from certpgo.certify import Tier
from certpgo.certify.ranged import RangedCase, Search
from certpgo.costs.ranges import RangeProblem
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Solution
from certpgo.optimize.starts import Start
from certpgo.solvers.certified.pipeline import CertifiedSolution
from certpgo.solvers.certified.settings import SolveSettings


def search_ranges(
    problem: RangeProblem, settings: SolveSettings, starts: Sequence[Start], monitor: Monitor
) -> CertifiedSolution:
    """The best estimate found, with what is proven about it.

    Parameters
    ----------
    starts : estimates that descents begin from, before the climb

    Raises
    ------
    InputError
        A start of another graph, tolerances out of range, or the proof tier.
    NumericalError
        No descent succeeded.
    """
    for start in starts:
        problem.check(start.estimate)
    tier = settings.tier or Tier.STANDARD
    case = RangedCase.of(problem, tier, settings.rtol, settings.atol, monitor)
    stop = case.stop
    with stop.within(settings.time_limit):
        search = Search(case, settings.max_rank)
        search.run(starts)
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
        note=f"initialized by {search.origin}; the relaxation ended at rank {search.rank}",
    )
    levels = tuple(replace(level, cost=case.unit * level.cost) for level in search.levels)
    return CertifiedSolution(solution, certificate, search.origin, levels, settings, problem)
