"""The certified pipeline on the measurements that agree with one another.

A certificate proves that no estimate fits *all* measurements better, including wrong ones. Here a
robust method first rejects outliers; the pipeline solves and certifies the remaining problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.certify.certificate import of_instance
from certpgo.errors import InputError, require_numbers
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.capabilities import require_capable
from certpgo.io.accept_paths import AnyPath, measured
from certpgo.linalg.arrays import IntArray
from certpgo.objective.choose_cost import Sum, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import UncertifiableError, indices_of
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.notebook import watched
from certpgo.optimize.progress import Stop
from certpgo.optimize.solution import Status
from certpgo.solve.outliers import select
from certpgo.solve.rejection import certify_rejection
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.selection import Selection
from certpgo.solve.settings import SolveSettings, settings_from


def solve_robustly(
    graph: Graph | Instance | AnyPath,
    settings: SolveSettings | None = None,
    *,
    cost: str | None = None,
    initial: Estimate | None = None,
    trusted: IntArray | None = None,
    quantile: float | None = None,
    monitor: Monitor | None = None,
    **options: Any,
) -> CertifiedSolution:
    """The best estimate of the measurements that agree with one another, with its certificate.

    `certpgo.solve.outliers.select` chooses the measurements to reject; the others
    are solved by `certpgo.solve`.

    Parameters
    ----------
    graph : the measurements, an instance, or the path of its file
    cost : what is minimised, and by which measurements are chosen, as in `certpgo.solve`
    initial : initial estimate of the robust fit; n poses, in metres
    trusted : (k,) indices of measurements that are known to be right, such as those of odometry:
        they are never rejected, and lead the choice among the others
    quantile : of chi^2, the price c_e of leaving a measurement out, by which the rejections are
        certified; it does not change the choice. By default that from which measurements are
        rejected, 1 - 0.01 / m
    settings, monitor, options : as in `certpgo.solve`; the time limit covers the choice and
        the search together

    Returns
    -------
    Certificate, levels and trace are about the kept measurements: they prove that no estimate fits
    these better. ``rejection`` has the verdict about the truncated cost, that of the kept ones plus
    min(f_e, c_e) of each rejected one: if CERTIFIED, no other estimate costs less, whichever of
    them it takes back. None if nothing was rejected, or where there is none, as the note says.
    ``noise_scale`` is 1, or how many times the stated noise is assumed, because hardly more than a
    tree agrees with the stated one; ``at_stated_noise`` is then the answer at that, if it rejects
    others.
    ``solution.weights`` is 0 for rejected ones, ``solution.rejected`` lists these, and
    ``solution.judged(problem)`` is the certified problem; ``cost`` is that of all measurements.

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
    >>> print(result.rejection.verdict)
    CERTIFIED
    >>> result.verdict.value, bool(np.array_equal(result.solution.rejected, wrong))
    ('CERTIFIED', True)
    """
    require_numbers(quantile=quantile)
    given = measured(graph)
    source = given if isinstance(given, Instance) else None
    posed: Any = objective_of(given, cost)
    if posed.kernel is not None:
        raise InputError(f"a robust fit rejects measurements, which {posed.kernel.kernel} keeps")
    require_capable(posed.graph, "robust fit", "" if source is None else source.name)
    chosen = settings_from(settings, options)
    limit = chosen.time_limit
    if initial is not None:
        posed.check(initial)
    if trusted is not None:
        trusted = indices_of(trusted, posed.graph.num_edges, "trusted")
    with watched(monitor) as shown:
        stop = Stop(shown, objective="the chordal cost F of all measurements, in a robust fit")
        with stop.within(limit), stop.watch.phase("select"):
            selection = select(posed, initial=initial, trusted=trusted, monitor=stop)
            ended = stop.ended_by
        of_choice = dict(stop.watch.seconds)
        left = _left(limit, of_choice) if ended is None else 0.0

        def answer(choice: Selection) -> CertifiedSolution:
            how = replace(chosen, time_limit=left)
            found = _answered(posed, choice, how, quantile, ended, shown)
            certificate, solution = found.certificate, found.solution
            if source is not None:
                certificate = of_instance(certificate, source, found.estimate)
            seconds = {**of_choice, **solution.seconds}
            return replace(
                found,
                certificate=certificate,
                solution=replace(solution, seconds=seconds),
                settings=chosen,
                instance=source,
            )

        found = answer(selection)
        if selection.stated is None or found.solution.status is Status.INTERRUPTED:
            return found
        left = _left(left, found.solution.seconds)
        return replace(found, at_stated_noise=answer(selection.stated))


def _answered(
    posed: Quadratic | Sum,
    selection: Selection,
    settings: SolveSettings,
    quantile: float | None,
    ended: Status | None,
    monitor: Monitor,
) -> CertifiedSolution:
    """The answer for a choice, and what is proven about the choice."""
    found = search(
        posed.reweighted(selection.weights),
        settings,
        Start(selection.estimate, "the robust fit"),
        monitor,
    )
    rejection, note = None, f"{selection.note(posed)}; {found.solution.note}"
    rejected = np.flatnonzero(selection.rejected)
    if len(rejected) and Status.INTERRUPTED in (ended, found.solution.status):
        note = f"{note}; rejections are not certified: interrupted"
    elif len(rejected):
        left = _left(settings.time_limit, found.solution.seconds)
        how: dict[str, Any] = {"quantile": quantile, "scale": selection.scale, "monitor": monitor}
        how["settings"] = replace(settings, time_limit=left)
        try:
            rejection = certify_rejection(posed, found.estimate, rejected, **how)
        except UncertifiableError as error:
            note = f"{note}; rejections are not certified: {error}"
    solution = replace(
        found.solution,
        cost=posed.cost(found.estimate),
        status=ended or found.solution.status,
        note=note,
        weights=selection.weights,
    )
    return replace(
        found,
        solution=solution,
        start=selection.method,
        found_disagreement=(None,),
        rejection=rejection,
        noise_scale=selection.scale,
    )


def _left(limit: float | None, seconds: Mapping[str, float]) -> float | None:
    """Seconds that are left of a limit."""
    return None if limit is None else max(limit - sum(seconds.values()), 0.0)
