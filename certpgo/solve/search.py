"""The best estimate of a problem, with its certificate, in any cost."""

from __future__ import annotations

from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, silent
from certpgo.solve.range_search import RangeSearch
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Report, Search, normalized_for
from certpgo.solve.settings import SolveSettings
from certpgo.solve.staircase import Staircase
from certpgo.solve.surrogates import SurrogateSearch


def _kind(problem: Certifiable) -> type[Search]:
    """The search of a cost."""
    if problem.is_lifted:
        return RangeSearch
    of_poses = problem.is_chordal and not problem.takes_scales
    return Staircase if of_poses else SurrogateSearch


def search(
    problem: Certifiable,
    settings: SolveSettings,
    initial: Start | None = None,
    monitor: Monitor = silent,
    on_disagreement: Report | None = None,
    stored: Start | None = None,
) -> CertifiedSolution:
    """The best estimate found, with its certificate; see `certpgo.solve`.

    Parameters
    ----------
    initial : where the search begins; by default it finds a start of its own
    on_disagreement : is called with measurements that disagree with the rest
    stored : another start, that of the file, which is tried if the first descent is not certified
    """
    normalized = normalized_for(problem, settings, monitor)
    return _kind(problem)(problem, normalized, settings).solved(initial, stored, on_disagreement)
