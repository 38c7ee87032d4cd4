"""The certified pipeline on the measurements that agree with one another.

A certificate says that no answer explains *all* measurements better, also those that are wrong.
Here a robust method says which to believe, and the pipeline solves and certifies what they pose.
"""

from __future__ import annotations

from dataclasses import replace

from certpgo.certify import Tier
from certpgo.certify.case import ATOL, RTOL
from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph
from certpgo.objective.problem import problem_of
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import stoppable
from certpgo.solvers.certified.disagreement import select
from certpgo.solvers.certified.pipeline import CertifiedSolution, solve


def solve_robustly(
    graph: Graph,
    *,
    initial: Estimate | None = None,
    time_limit: float | None = None,
    max_rank: int | None = None,
    tier: Tier | str | None = None,
    rtol: float = RTOL,
    atol: float = ATOL,
    monitor: Monitor = silent,
) -> CertifiedSolution:
    """The best estimate of the measurements that agree with one another, with its certificate.

    Measurements that disagree with the rest are left out, as
    `certpgo.solvers.certified.disagreement.select` chooses them; the others are solved like any
    graph, by `certpgo.solve`.

    Parameters
    ----------
    initial : where the robust fit starts; n poses, in metres
    time_limit : seconds for the choice and the search
    graph, max_rank, tier, rtol, atol, monitor : as in `certpgo.solve`

    Returns
    -------
    The answer. Its certificate, its levels and its trace are of the measurements that were kept:
    that no answer fits these better, not that the right ones were kept. ``solution.weights`` is 0
    where one was rejected, ``solution.rejected`` lists those, and ``solution.judged(problem)`` is
    the problem that the certificate is about; ``cost`` is F of all measurements.

    Raises
    ------
    GraphError, InputError, NumericalError
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
    if time_limit is not None and not time_limit >= 0.0:
        raise InputError(f"the time limit must not be negative: {time_limit}")
    if initial is not None:
        problem.check(initial)
    with stoppable(monitor, 1.0, time_limit) as stop:
        with stop.watch.phase("select"):
            chosen = select(problem, initial=initial, monitor=stop)
        left = None if time_limit is None else time_limit - min(time_limit, stop.watch.total)
        found = solve(
            problem.reweighted(chosen.weights).graph,
            initial=chosen.estimate,
            time_limit=0.0 if stop.asked else left,
            max_rank=max_rank,
            tier=tier,
            rtol=rtol,
            atol=atol,
            monitor=monitor,
        )
    solution = replace(
        found.solution,
        cost=problem.cost(found.estimate),
        status=stop.status or found.solution.status,
        seconds={**stop.watch.seconds, **found.solution.seconds},
        note=f"{chosen.note(problem)}; {found.solution.note}".replace(
            "started from given", "started from the robust fit"
        ),
        weights=chosen.weights,
    )
    return replace(found, solution=solution, start=chosen.method, disagreement=None)
