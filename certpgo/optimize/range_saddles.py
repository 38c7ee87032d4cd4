"""The way out of saddles of the relaxation, for graphs with measured distances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.relaxed_point import Lift, Point, lifted, translations_of
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal, divided, pinned
from certpgo.linalg.eigen import krylov_schur
from certpgo.linalg.factor import Factor
from certpgo.linalg.rotations import orthonormal
from certpgo.objective.problem import PoseProblem
from certpgo.objective.range_problem import RangeModel, RangeProblem
from certpgo.optimize.levenberg_marquardt import minimise
from certpgo.optimize.low_rank_descent import lowest_of_halvings
from certpgo.optimize.progress import Progress, Stop
from certpgo.optimize.solution import Status

#: Stationarity at which a rank of the relaxation ends, and steps: its bound needs all digits.
STATIONARY, STEPS = 1e-11, 400
#: Shifts that make a scaled certificate matrix definite.
SHIFTS = tuple(1e-9 * 4.0**k for k in range(20))
#: Relative accuracy of escape directions, and how many more than the gauge's are computed.
ACCURACY, MORE = 1e-3, 2
#: Negative eigenvalues above minus this, of a matrix of unit diagonal, may be rounding.
RESOLUTION = 1e-13


def climb(
    problem: RangeProblem, start: Point, highest: int, stop: Stop
) -> Iterator[tuple[RangeModel, Status]]:
    """As `descents`, from the first way down of a stationary point of lower rank."""
    with suppress(NumericalError, np.linalg.LinAlgError):
        following = escape(problem, start, stop.should_stop)
        if following is not None:
            yield from descents(problem, following, highest, stop)


def descents(
    problem: RangeProblem, start: Lift, highest: int, stop: Stop
) -> Iterator[tuple[RangeModel, Status]]:
    """Lower and lower points of the relaxation: the Riemannian staircase.

    Parameters
    ----------
    start : above rank d
    highest : the largest rank

    Yields
    ------
    The end of descent at each rank, and how it ended, until the certificate matrix has no way down.
    """
    following: Lift | None = start
    while following is not None and following.rank <= highest:
        progress = Progress(stop, STATIONARY, STEPS, stop.watch)
        end = minimise(problem.linearized(following), progress)
        yield end, stop.request or progress.status
        with stop.watch.phase("escape"):
            following = escape(problem, end.point, stop.should_stop)


def escape(
    problem: RangeProblem, point: Point, asked: Callable[[], bool] = lambda: False
) -> Lift | None:
    """A lower point of the next rank; None where the certificate matrix has no way down.

    Along an eigenvector of a negative eigenvalue of the pose graph's certificate matrix there (see
    `RangeProblem.surrogate`), whose curvature in a new dimension is that of f.

    Parameters
    ----------
    asked : whether to stop; called before each factorization and each solve

    Raises
    ------
    NumericalError
        No factorization, no convergence, or a stop.
    """
    below, _ = problem.surrogate(point)
    G = problem.gradient(point)[:, :, -problem.d :]
    S = below.certificate_matrix(below.constrained(G, point.rotations))
    layout = below.pattern.layout_of(S)
    moved = int(layout.sizes.max()) - problem.d
    S = pinned(S, layout.first_row(0) + np.arange(moved))
    weights = problem.whole.matrix.diagonal()
    root = np.sqrt(np.maximum(np.abs(weights), np.finfo(float).tiny))
    A = divided(S, root)
    # The motions of the whole have eigenvalue zero, and must not hide the one that is looked for.
    value, v = smallest_eigenpair(below, A, point.rotations.shape[1] + MORE, asked)
    if value > -RESOLUTION:
        return None
    direction = layout.unpack(v / root)
    direction[0, :moved] = 0.0
    return _leave(problem, point, below.rising(direction))


def smallest_eigenpair(
    below: PoseProblem, A: CSC, pairs: int, asked: Callable[[], bool]
) -> tuple[float, FloatArray]:
    """The smallest eigenvalue, of as many that are computed together, and its vector."""
    for shift in SHIFTS:
        _refuse_to_go_on(asked)
        shifted = add_to_diagonal(A, shift)
        factor = below.symbolic(shifted).factor(shifted)
        if factor is None:
            continue

        def solve(B: FloatArray, factor: Factor = factor) -> FloatArray:
            _refuse_to_go_on(asked)
            return factor.solve(B)

        start = np.random.default_rng(0).standard_normal((A.shape[0], pairs))
        found = krylov_schur(shifted, solve, pairs, shift=shift, tol=ACCURACY, start=start)
        return float(found.values[0]), found.vectors[:, 0]
    raise NumericalError("the certificate matrix could not be factorized, even when shifted")


def _refuse_to_go_on(asked: Callable[[], bool]) -> None:
    if asked():
        raise NumericalError("stopped before a way down was found")


def _leave(problem: RangeProblem, point: Point, rising: Lift) -> Lift | None:
    """The point moved into new dimensions as far as f decreases; None if it does not."""
    start = lifted(point, point.rotations.shape[1] + rising.rank)
    V, w = np.zeros_like(start.rotations), np.zeros_like(translations_of(start))
    V[:, -rising.rank :], w[:, -rising.rank :] = rising.rotations, translations_of(rising)
    size = float(np.linalg.norm(V, axis=(1, 2)).max())
    reach = float(np.linalg.norm(translations_of(start), axis=1).max())
    step = min(1.0 / max(size, 1e-300), reach / max(float(np.abs(w).max()), 1e-300))

    def moved(step: float) -> Lift:
        return Lift(orthonormal(start.rotations + step * V), translations_of(start) + step * w)

    return lowest_of_halvings(problem.cost, moved, step, problem.cost(start))
