"""Which search a problem's cost has: the one place that asks for the kind of a problem."""

from __future__ import annotations

from collections.abc import Callable

from certpgo.costs import Certifiable
from certpgo.costs.problem import InformationProblem
from certpgo.costs.ranges import RangeProblem
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.starts import Start
from certpgo.solvers.certified.disagreement import Disagreement
from certpgo.solvers.certified.own_cost import search_own_cost
from certpgo.solvers.certified.pipeline import CertifiedSolution, search_and_certify
from certpgo.solvers.certified.ranged import search_ranges
from certpgo.solvers.certified.settings import SolveSettings


def search(
    problem: Certifiable,
    settings: SolveSettings,
    initial: Start | None = None,
    monitor: Monitor = silent,
    on_disagreement: Callable[[Disagreement], object] | None = None,
    stored: Start | None = None,
) -> CertifiedSolution:
    """The best estimate found, with its certificate; see `certpgo.solve`.

    Parameters
    ----------
    initial : where the search begins; by default it finds a start of its own
    stored : another start, that of the file
    """
    if isinstance(problem, RangeProblem):
        starts = [start for start in (initial, stored) if start is not None]
        return search_ranges(problem, settings, starts, monitor)
    if isinstance(problem, InformationProblem):
        return search_own_cost(problem, settings, initial, monitor, on_disagreement, stored)
    return search_and_certify(problem, settings, initial, monitor, on_disagreement, stored)
