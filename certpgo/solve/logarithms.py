"""The cost of logarithms of similarities: its descent, and its bound for scales near the end's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.display import Brief
from certpgo.io.accept_paths import AnyPath, measured
from certpgo.linalg.ball_arithmetic import U
from certpgo.objective.choose_cost import objective_of, require_scales
from certpgo.objective.logarithms import LogarithmCost
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import Stop
from certpgo.optimize.similarity_starts import separate_start
from certpgo.optimize.solution import Solution
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings, settings_from
from certpgo.solve.solving import solve

#: Stationarity at which a descent ends, which differences of logarithms resolve, and steps.
TOLERANCE, STEPS = 1e-9, 300


@dataclass(frozen=True, eq=False, repr=False)
class LogarithmFit(Brief):
    """A map that is stationary for the cost of logarithms.

    Attributes
    ----------
    solution : the end of the descent, with its cost
    nearby : the certified answer for the quadratic cost that bounds it, whose scales are over those
        of the estimate; see `lower_bound`

    Examples
    --------
    Two measurements of a scale, 2 and 8: the fit is their geometric mean.

    >>> import numpy as np
    >>> import certpgo
    >>> rotation = certpgo.RotationGraph(2, [[0, 1]] * 2, [np.eye(2)] * 2, kappa=np.ones(2))
    >>> scales = np.array([2.0, 8.0])
    >>> graph = certpgo.SimilarityGraph(rotation, np.zeros((2, 2)), np.ones(2), scales=scales)
    >>> found = certpgo.fit_logarithms(graph)
    >>> found.estimate.scales.round(6).tolist()
    [1.0, 4.0]
    >>> found.lower_bound(within=1.1) < found.cost
    True
    """

    solution: Solution
    nearby: CertifiedSolution

    @property
    def estimate(self) -> Estimate:
        """The map."""
        return self.solution.estimate

    @property
    def cost(self) -> float:
        """Its cost of logarithms."""
        return self.solution.cost

    def lower_bound(self, within: float) -> float:
        """A bound on the cost of every map with nearly these scales.

        Parameters
        ----------
        within : at least 1; a map is meant whose scales, over those of the estimate, are within
            this factor of their root mean square

        Raises
        ------
        InputError
            A factor less than 1.
        """
        if not 1.0 <= within < math.inf:
            raise InputError(f"scales are within a factor of at least 1 of others, not {within:g}")
        return (1.0 - 8.0 * U) * self.nearby.certificate.lower_bound / within**2


def fit_logarithms(
    graph: Graph | Quadratic | Instance | AnyPath,
    settings: SolveSettings | None = None,
    *,
    initial: Estimate | None = None,
    monitor: Monitor = silent,
    **options: Any,
) -> LogarithmFit:
    """Minimise the cost of logarithms, by descent from scales that fit best, and poses with these.

    It is that of GTSAM's BetweenFactorSimilarity2 and 3, as `certpgo.to_gtsam` makes them, and of
    g2o's EdgeSim3 with the same precisions. No quadratic form lies below it, so the map is not
    certified. What is proven is a bound on the cost of maps whose scales are near those found.

    Parameters
    ----------
    graph : of poses, with unknown scales; or its problem, the instance that was read, or its file's
        path
    settings, options : of the search for the bound, as for `certpgo.solve`; the time limit is that
        of the descent and of this search together
    initial : where to begin, in place of that

    Raises
    ------
    InputError
        No scale is unknown, or there are points or distances; or as `certpgo.solve`.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import fit_logarithms
    >>> from certpgo.io.datasets.monocular import random_maps
    >>> graph, _ = random_maps(np.random.default_rng(0), turn=0.02, scale=0.02, move=0.02)
    >>> found = fit_logarithms(graph)
    >>> 0.99 * found.cost < found.lower_bound(within=1.0) < found.cost
    True
    """
    posed: Any = measured(graph)
    require_scales(posed)
    problem = LogarithmCost(objective_of(posed).graph)
    chosen = settings_from(settings, options)
    stop = Stop(monitor, objective="the cost of logarithms")
    with stop.within(chosen.time_limit):
        begin = separate_start(problem.quadratic) if initial is None else initial
        found = descend(
            problem,
            begin,
            tolerance=TOLERANCE,
            max_iterations=STEPS,
            monitor=stop,
            watch=stop.watch,
        )
        estimate, left = found.estimate, chosen.time_limit
        if stop.ended_by is not None:
            left = 0.0
        elif left is not None:
            left = max(stop.remaining, 0.0)
        nearby = solve(problem.minorant(estimate), replace(chosen, time_limit=left))
    if isinstance(posed, Instance):
        estimate = replace(estimate, keys=posed.keys)
    status, trace = stop.ended_by or found.status, tuple(stop.trace)
    solution = replace(found, estimate=estimate, status=status, trace=trace)
    return LogarithmFit(solution, nearby)
