"""The certified search as a method."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

from certpgo.graph import Estimate
from certpgo.objective.choose_cost import COSTS
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.solution import Solution
from certpgo.solve.result import GIVEN
from certpgo.solve.search import search
from certpgo.solve.settings import SolveSettings


@dataclass(frozen=True)
class Certified(SolveSettings):
    """The certified pipeline as a method.

    The estimate is that of `certpgo.solve`, the settings are those of `SolveSettings`.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = certpgo.Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> certpgo.get_solver("certified")().solve(problem).lower_bound > 0.029
    True
    """

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True
    own_costs: ClassVar[Collection[str]] = COSTS

    def solve(
        self,
        problem: Quadratic | Sum,
        *,
        initial: Estimate | None = None,
        monitor: Monitor = silent,
    ) -> Solution:
        """The best estimate found."""
        begin = None if initial is None else Start(initial, GIVEN)
        return search(problem, self, begin, monitor).solution


SOLVER = Certified
