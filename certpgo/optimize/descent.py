"""Local descent on any cost."""

from __future__ import annotations

from dataclasses import replace

from certpgo.graph import Estimate
from certpgo.objective.objective import Objective
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize import levenberg_marquardt
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution, Status

#: Descent to a local minimum; a point that has not converged by then is none.
DESCENT = NewtonSettings(max_iterations=200)
#: Descent to more digits than other purposes need.
CLOSE = NewtonSettings(tolerance=1e-11)
#: Descents on a truncated cost, each with the measurements that the last one takes back.
ROUNDS = 20


def descend(
    problem: Objective,
    start: Estimate,
    settings: NewtonSettings = DESCENT,
    *,
    near: bool = False,
    tolerance: float = 1e-11,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from an estimate to a stationary point of the cost.

    By Newton's method where translations are eliminated, else by that of Levenberg and Marquardt.
    Of a truncated cost, by descents on the cost of the measurements that count, until these no
    longer change.

    Parameters
    ----------
    settings, near : of Newton's method
    tolerance : of Levenberg and Marquardt's
    watch : stopwatch that already timed the initialization
    """
    if isinstance(problem, TruncatedCost):
        return _taking_back(problem, start, monitor, watch)
    if problem.eliminates:
        return newton(problem, start, settings, near=near, monitor=monitor, watch=watch)  # type: ignore[arg-type]
    return levenberg_marquardt.descend(
        problem,  # type: ignore[arg-type]
        start,
        tolerance=tolerance,
        max_iterations=problem.most_steps,
        monitor=monitor,
        watch=watch,
    )


def polished(
    problem: Objective, start: Estimate, settings: NewtonSettings = CLOSE, *, near: bool = False
) -> Estimate:
    """The end of a descent that begins near it."""
    return descend(problem, start, settings, near=near, tolerance=problem.polished).estimate


def rested(problem: Objective, point: Estimate) -> Estimate:
    """The stationary point near an estimate, to as many digits as a proof shows.

    The estimate itself, where negative weights leave a surrogate without a minimum.
    """
    if isinstance(problem, Quadratic) and _has_no_minimum(problem):
        return point
    return problem.settled(polished(problem, problem.settled(point), near=True))


def _has_no_minimum(problem: Quadratic) -> bool:
    """Whether negative weights of translations, or of their levers, prevail."""
    if not (problem.has_positions and problem.graph.is_signed):
        return False
    return not min(problem.graph.tau.sum(), problem.lever_weights.sum()) > 0.0


def _taking_back(
    problem: TruncatedCost, start: Estimate, monitor: Monitor, watch: Stopwatch | None
) -> Solution:
    counted = problem.counted(start)
    for _ in range(ROUNDS):
        prices = float(problem.prices[~counted].sum())

        def truncated(iteration: Iteration, prices: float = prices) -> bool:
            return monitor(replace(iteration, cost=iteration.cost + prices))

        part = problem.counting(counted)
        found = descend(part, part.settled(start), monitor=truncated, watch=watch)
        before, start = counted, found.estimate
        counted = problem.counted(start)
        if (counted == before).all() or found.status is Status.INTERRUPTED:
            break
    return replace(found, cost=problem.cost(start))
