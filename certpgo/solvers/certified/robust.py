"""The certified pipeline on the measurements that agree with one another.

A certificate says that no answer explains *all* measurements better, also those that are wrong.
Here a robust method says which to believe, and the pipeline solves and certifies what they pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from certpgo.graph import Estimate, Graph
from certpgo.objective.problem import problem_of
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import stoppable
from certpgo.optimize.starts import Start
from certpgo.solvers.certified.disagreement import select
from certpgo.solvers.certified.pipeline import CertifiedSolution, search_and_certify
from certpgo.solvers.certified.settings import SolveSettings


def solve_robustly(
    graph: Graph,
    settings: SolveSettings | None = None,
    *,
    initial: Estimate | None = None,
    monitor: Monitor = silent,
    **options: Any,
) -> CertifiedSolution:
    """The best estimate of the measurements that agree with one another, with its certificate.

    Measurements that disagree with the rest are left out, as
    `certpgo.solvers.certified.disagreement.select` chooses them; the others are solved like any
    graph, by `certpgo.solve`.

    Parameters
    ----------
    initial : where the robust fit starts; n poses, in metres
    graph, settings, monitor, options : as in `certpgo.solve`; the time limit is for the choice and
        the search together

    Returns
    -------
    The answer. Its certificate, its levels and its trace are of the measurements that were kept:
    that no answer fits these better, not that the right ones were kept. ``solution.weights`` is 0
    where one was rejected, ``solution.rejected`` lists those, and ``solution.judged(problem)`` is
    the problem that the certificate is about; ``cost`` is F of all measurements.

    Raises
    ------
    GraphError, InputError, SpecError, NumericalError
        As `certpgo.solve`.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> answer = certpgo.solve_robustly(instance.graph)
    >>> wrong = np.flatnonzero(instance.outliers)
    >>> answer.verdict.value, bool(np.array_equal(answer.solution.rejected, wrong))
    ('CERTIFIED', True)
    """
    problem = problem_of(graph)
    chosen = (settings or SolveSettings()).changed(options)
    limit = chosen.time_limit
    if initial is not None:
        problem.check(initial)
    with stoppable(monitor, 1.0, limit) as stop:
        with stop.watch.phase("select"):
            selection = select(problem, initial=initial, monitor=stop)
        left = None if limit is None else limit - min(limit, stop.watch.total)
        ended = stop.status
        found = search_and_certify(
            problem.reweighted(selection.weights),
            replace(chosen, time_limit=left if ended is None else 0.0),
            Start(selection.estimate, "the robust fit"),
            monitor,
        )
    solution = replace(
        found.solution,
        cost=problem.cost(found.estimate),
        status=ended or found.solution.status,
        seconds={**stop.watch.seconds, **found.solution.seconds},
        note=f"{selection.note(problem)}; {found.solution.note}",
        weights=selection.weights,
    )
    return replace(found, solution=solution, start=selection.method, disagreement=None)
