"""Local minima near estimates, and those that are reached without one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import AT_REST, SETTLED
from certpgo.errors import GraphError, NumericalError
from certpgo.graph import Estimate
from certpgo.optimize import similarity_starts, spectral
from certpgo.optimize.descent import descend
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Status
from certpgo.solve import bounding
from certpgo.solve.relaxation import near_relaxation


def local_minimum(
    normalized: NormalizedProblem[Any],
    start: Estimate,
    refine: bool = True,
    known: LocalMinimum | None = None,
    monitor: Monitor | None = None,
    *,
    may_rest: bool = False,
) -> LocalMinimum:
    """The end of descent from an estimate, or the estimate with its best translations.

    The bound of a ``known`` minimum is reused if it is good enough. Where a ``monitor`` of the
    descent stops it, no bound is computed. One that ``may_rest`` does not descend from a stationary
    point that its own multipliers prove optimal.
    """
    problem, stop, settled = normalized.problem, normalized.stop, True
    try:
        point = problem.settled(start)
        if may_rest and (found := _at_rest(normalized, point)) is not None:
            return found
        if refine:
            solution = descend(problem, point, monitor=monitor or stop, watch=stop.watch)
            point = problem.settled(solution.estimate)
            settled = solution.status is Status.CONVERGED or (
                solution.status is Status.STALLED and problem.stationarity(point) < SETTLED
            )
        end, cost = _lowest(normalized, point, start)
        if stop.should_stop() or (refine and solution.status is Status.INTERRUPTED):
            return LocalMinimum(end, cost, settled, None, refine)
        if known is not None and known.value >= cost - normalized.tolerance(cost):
            return LocalMinimum(end, cost, settled, known.bound, refine)
        bound = bounding.bound_near(normalized, point, cost, refine=refine)
    except (NumericalError, np.linalg.LinAlgError):
        return LocalMinimum(start, normalized.cost_upper(start), False, None, refine)
    return LocalMinimum(end, cost, settled, bound, refine)


def _lowest(
    normalized: NormalizedProblem[Any], end: Estimate, start: Estimate
) -> tuple[Estimate, float]:
    """The end of a descent, or its start if rounding under large weights has raised the cost.

    With the cost, rounded up.
    """
    cost, problem = normalized.cost_upper(end), normalized.problem
    if problem.cost(start) < problem.cost(end) - normalized.difference(cost):
        given = normalized.cost_upper(start)
        if given < cost:
            return start, given
    return end, cost


def _at_rest(normalized: NormalizedProblem[Any], point: Estimate) -> LocalMinimum | None:
    """A stationary point that its own multipliers prove optimal, else None."""
    try:
        if normalized.stop.should_stop() or not normalized.problem.stationarity(point) <= SETTLED:
            return None
        cost = normalized.cost_upper(point)
        found = LocalMinimum(point, cost, True, bounding.bound_near(normalized, point, cost))
    except (NumericalError, np.linalg.LinAlgError):
        return None
    proven = cost - found.value <= AT_REST * normalized.difference(cost)
    return found if proven or normalized.fits(point) else None


def elsewhere(normalized: NormalizedProblem[Any]) -> LocalMinimum | None:
    """The best of the minima that are reached without an estimate; None if there is none."""
    if normalized.problem.is_lifted:
        with suppress(NumericalError):
            return near_relaxation(normalized)
        return None
    best: LocalMinimum | None = None
    for start in _starts(normalized):
        found = local_minimum(normalized, start)
        if best is None or found.cost < best.cost:
            best = found
        if normalized.is_sharp(best) or normalized.stop.should_stop():
            break
    return best


def _starts(normalized: NormalizedProblem[Any]) -> Iterator[Estimate]:
    """Where descents begin: over similarities at several estimates, else at one."""
    problem = normalized.problem.kept
    if not problem.takes_scales:
        yield _near_relaxation_of_f(normalized, problem) or _spectral(normalized, problem)
        return
    for start in similarity_starts.STARTS:
        with suppress(NumericalError, np.linalg.LinAlgError):
            yield start(problem).estimate


def _spectral(normalized: NormalizedProblem[Any], problem: Any) -> Estimate:
    """Eigenvectors, and under another cost than F the local optimum of F near them."""
    chordal, stop = problem.chordal, normalized.stop
    try:
        start = spectral.spectral_start(chordal)
        if problem.is_chordal:
            return start
        return descend(chordal, start, monitor=lambda _: stop.stop_requested).estimate
    except (NumericalError, np.linalg.LinAlgError):
        n, d = chordal.n, chordal.d
        return Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))


def _near_relaxation_of_f(normalized: NormalizedProblem[Any], problem: Any) -> Estimate | None:
    """With distances, the best estimate under F near its relaxation; None without one."""
    with suppress(GraphError, NumericalError):  # what F has no terms for may join some nodes
        if (isotropic := problem.isotropic).is_lifted:
            found = near_relaxation(replace(normalized, problem=isotropic))
            return None if found is None else found.point
    return None
