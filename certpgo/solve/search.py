"""The best estimate of a problem, with its certificate, in any cost."""

from __future__ import annotations

from certpgo.certify.chordal_case import Case
from certpgo.certify.range_case import RangedCase
from certpgo.certify.similarity_case import SimilarCase
from certpgo.certify.surrogate_case import OwnCostCase
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, silent
from certpgo.solve.range_search import RangeSearch
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Report, Search, case_under
from certpgo.solve.settings import SolveSettings
from certpgo.solve.similarity_search import SimilaritySearch
from certpgo.solve.staircase import Staircase
from certpgo.solve.surrogates import SurrogateSearch

#: The search of each kind of certificate.
_SEARCHES: dict[type[Case], type[Search]] = {
    Case: Staircase,
    OwnCostCase: SurrogateSearch,
    RangedCase: RangeSearch,
    SimilarCase: SimilaritySearch,
}


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
    case = case_under(problem, settings, monitor)
    return _SEARCHES[type(case)](problem, case, settings).solved(initial, stored, on_disagreement)
