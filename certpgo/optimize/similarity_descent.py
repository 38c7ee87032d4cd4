"""Starts, descents and ways out of saddles over similarities."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.relaxed_point import Lift, Point, lifted, translations_of
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import add_to_diagonal, divided, pinned, scatter_sum
from certpgo.linalg.rotations import orthonormal
from certpgo.objective.operators import laplacian
from certpgo.objective.problem import PoseProblem
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.optimize.initialization import Start, start_of
from certpgo.optimize.levenberg_marquardt import minimise
from certpgo.optimize.low_rank_descent import lowest_of_halvings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress, Stop
from certpgo.optimize.range_saddles import MORE, RESOLUTION, smallest_eigenpair
from certpgo.optimize.solution import Solution, Status

if TYPE_CHECKING:
    from certpgo.objective.logarithms import LogarithmProblem

#: Stationarity at which a descent ends, and steps.
TOLERANCE, STEPS = 1e-11, 300
#: The same of a rank of the relaxation.
STATIONARY = 1e-10


def starts(problem: SimilarityProblem) -> Iterator[Start]:
    """Estimates from which descents begin: the nearest to a basin, then the least shrunk.

    Raises
    ------
    NumericalError
        The weights are too uneven for both.
    """
    try:
        yield Start(problem.linear_start(), "linear relaxation")
    except (NumericalError, np.linalg.LinAlgError):
        yield Start(separate_start(problem), "scales, then poses")
        return
    with suppress(NumericalError, np.linalg.LinAlgError):
        yield Start(separate_start(problem), "scales, then poses")


def separate_start(problem: SimilarityProblem) -> Estimate:
    """Least squares of the logarithms of scales, then poses as of measurements in one unit.

    Raises
    ------
    NumericalError
        The weights are too uneven for a factorization.
    """
    graph, (i, _) = problem.graph, problem.graph.edges.T
    scales = log_scales(problem)
    steps = scales[i, None] * graph.translations
    flags = graph.points, graph.assumed, graph.absolute
    posed = PoseProblem(PoseGraph(graph.rotation, steps, graph.tau, None, *flags), problem.engine)
    rotations = start_of(posed).estimate.rotations
    return problem.complete(rotations, scales)


def log_scales(problem: SimilarityProblem) -> FloatArray:
    """(n,) scales whose logarithms fit the measured ones best; 1 where they are known."""
    graph, n = problem.graph, problem.n
    i, j = graph.edges.T
    weights = graph.rotation.kappa
    known = np.flatnonzero(~graph.free)
    if problem.in_mean_unit:
        known = np.append(known, problem.root)
    measured = weights * np.log(graph.scales)
    forces = scatter_sum(j, measured, n) - scatter_sum(i, measured, n)
    forces[known] = 0.0
    L = laplacian(problem.pattern, weights)
    # Some known ones, such as points, have no measured scale and a diagonal of zero.
    L = add_to_diagonal(pinned(L, known), np.isin(np.arange(n), known).astype(float))
    factor = problem.symbolic(L).factor(L)
    if factor is None:
        raise NumericalError("the measured scales do not determine the scales of all poses")
    return np.asarray(np.exp(factor.solve(forces[:, None])[:, 0]))


def descend(
    problem: SimilarityProblem | LogarithmProblem,
    start: Estimate,
    *,
    tolerance: float = TOLERANCE,
    max_iterations: int = STEPS,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Levenberg and Marquardt's method from an estimate; see `levenberg_marquardt.descend`."""
    problem.check(start)
    progress = Progress(monitor, tolerance, max_iterations, watch or Stopwatch())
    end = minimise(problem.linearized(start), progress)
    return progress.solution(problem.estimate_of(end.point), end.cost)


def climb(
    problem: SimilarityProblem, start: Point, highest: int, stop: Stop
) -> Iterator[tuple[Lift, float, Status]]:
    """Lower and lower points of the relaxation with their costs: the Riemannian staircase.

    Parameters
    ----------
    start : a stationary point
    highest : the largest rank

    Yields
    ------
    The end of descent at each higher rank, until the certificate matrix has no way down.
    """
    point = start
    for _ in range(start.rotations.shape[1], highest):
        with stop.watch.phase("escape"):
            following = escape(problem, point, stop.should_stop)
        if following is None:
            return
        progress = Progress(stop, STATIONARY, STEPS, stop.watch)
        end = minimise(problem.linearized(following), progress)
        yield end.point, end.cost, stop.request or progress.status
        point = end.point


def escape(
    problem: SimilarityProblem, point: Point, asked: Callable[[], bool] = lambda: False
) -> Lift | None:
    """A lower point of the next rank; None where the certificate matrix has no way down.

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop.
    """
    here = problem.blocks(point)
    S = problem.certificate_matrix(problem.multipliers(here))
    layout = problem.pattern.layout_of(S)
    first = layout.first_row(problem.root)
    S = pinned(S, np.array([first]))
    root = np.sqrt(np.maximum(problem.matrix.diagonal(), np.finfo(float).tiny))
    value, v = smallest_eigenpair(problem, divided(S, root), here.rank + MORE, asked)
    if value > -RESOLUTION:
        return None
    rows = layout.unpack(v / root)
    rows[problem.root, 0] = 0.0
    start = lifted(here, here.rank + 1)
    V, w = np.zeros_like(start.rotations), np.zeros_like(translations_of(start))
    V[:, -1], w[:, -1] = rows[:, 1:], rows[:, 0]
    scales = np.sqrt(np.einsum("nra,nra->n", start.rotations, start.rotations) / problem.d)
    scales[problem.graph.is_point] = 1.0
    shares = np.linalg.norm(V, axis=(1, 2)) / scales
    step = 1.0 / max(float(shares.max()), 1e-300)

    def moved(step: float) -> Lift:
        turned = orthonormal((start.rotations + step * V) / scales[:, None, None])
        return Lift(scales[:, None, None] * turned, translations_of(start) + step * w)

    return lowest_of_halvings(problem.cost, moved, step, problem.cost(start))
