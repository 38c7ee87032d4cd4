"""The certified pipeline on the measurements that agree with one another.

A certificate proves that no estimate fits *all* measurements better, including wrong ones. Here a
robust method first rejects outliers; the pipeline solves and certifies the remaining problem.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.accept_paths import AnyPath, measured
from certpgo.linalg.arrays import IntArray
from certpgo.objective.problem import problem_of
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import Stop
from certpgo.solve.outliers import select
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.settings import SolveSettings


def solve_robustly(
    graph: Graph | Instance | AnyPath,
    settings: SolveSettings | None = None,
    *,
    initial: Estimate | None = None,
    trusted: IntArray | None = None,
    monitor: Monitor = silent,
    **options: Any,
) -> CertifiedSolution:
    """The best estimate of the measurements that agree with one another, with its certificate.

    `certpgo.solve.outliers.select` chooses the measurements to reject; the others
    are solved by `certpgo.solve`.

    Parameters
    ----------
    graph : the measurements, an instance, or the path of its file; F is minimised in any case
    initial : initial estimate of the robust fit; n poses, in metres
    trusted : (k,) indices of measurements that are known to be right, such as those of odometry:
        they are never rejected, and lead the choice among the others
    settings, monitor, options : as in `certpgo.solve`; the time limit covers the choice and
        the search together

    Returns
    -------
    Certificate, levels and trace are about the kept measurements: they prove that no estimate fits
    these better, not that the right ones were kept. ``solution.weights`` is 0 for rejected ones,
    ``solution.rejected`` lists these, and ``solution.judged(problem)`` is the certified problem;
    ``cost`` is F of all measurements.

    Raises
    ------
    GraphError, InputError, SpecError, NumericalError
        As in `certpgo.solve`.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> result = certpgo.solve_robustly(instance.graph)
    >>> wrong = np.flatnonzero(instance.outliers)
    >>> result.verdict.value, bool(np.array_equal(result.solution.rejected, wrong))
    ('CERTIFIED', True)
    """
    given = measured(graph)
    source = given if isinstance(given, Instance) else None
    problem = problem_of(given if source is None else source.graph)
    chosen = (settings or SolveSettings()).changed(options)
    limit = chosen.time_limit
    if initial is not None:
        problem.check(initial)
    stop = Stop(monitor, objective="the chordal cost F of all measurements, in a robust fit")
    with stop.within(limit):
        with stop.watch.phase("select"):
            selection = select(problem, initial=initial, trusted=trusted, monitor=stop)
        left = None if limit is None else limit - min(limit, stop.watch.total)
        ended = stop.ended_by
        found = search(
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
    return replace(
        found,
        solution=solution,
        start=selection.method,
        settings=chosen,
        disagreement=None,
        instance=source,
    )
