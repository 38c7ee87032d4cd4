"""Rotation averaging by Gauss-Newton steps with the scalar Laplacian as Hessian.

For world-frame tangents, X_i <- exp(delta_i) X_i, a small residual R_j - R_i R_ij changes by
delta_j - delta_i whatever the rotations are, so one n x n factorization serves every step and axis.
Converges linearly, the more slowly the larger the residual angles.
"""

from __future__ import annotations

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.factor import Factor
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

#: A step is slow if it leaves more than this fraction of the cost and of the gradient.
SLOW = 0.5


def laplacian_gauss_newton(
    problem: Quadratic,
    initial: Estimate,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 100,
    patience: int = 2,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` by steps that solve with the graph Laplacian.

    Parameters
    ----------
    initial : only its rotations are used
    tolerance : stationarity (radians, see `FirstOrder`) at which to stop
    patience : consecutive slow steps after which the method is STALLED
    watch : stopwatch that already timed the initialization

    Raises
    ------
    NumericalError
        The Laplacian could not be factorized.
    """
    watch = watch or Stopwatch()
    point = Estimate(initial.rotations)
    with watch.phase("averaging"):
        factor = problem.grounded_factor(problem.laplacian)
        first = problem.first_order(point)
    if factor is None:
        raise NumericalError("the graph Laplacian could not be factorized")
    progress = Progress(monitor, tolerance, max_iterations, watch)
    step_norm, slow = 0.0, 0
    while progress.advance(first.cost, first.stationarity, step_norm):
        with watch.phase("averaging"):
            candidate, step_norm = _stepped(factor, point, first.tangent)
            following = problem.first_order(candidate)
        slow_gradient = following.stationarity > SLOW * first.stationarity
        slow = slow + 1 if slow_gradient and following.cost > SLOW * first.cost else 0
        if slow > patience or not following.cost <= first.cost * (1.0 + 1e-12):
            progress.status = Status.STALLED
            break
        point, first = candidate, following
    return progress.solution(Estimate(point.rotations), first.cost, counts={"factorizations": 1})


def laplacian_step(problem: Quadratic, point: Estimate) -> tuple[Estimate, float]:
    """One step, accepted even if it increases F, and its norm."""
    factor = problem.grounded_factor(problem.laplacian)
    if factor is None:
        raise NumericalError("the graph Laplacian could not be factorized")
    return _stepped(factor, point, problem.first_order(point).tangent)


def _stepped(factor: Factor, point: Estimate, tangent: FloatArray) -> tuple[Estimate, float]:
    delta = -0.5 * factor.solve(_in_world(point.rotations, tangent))
    turned = so.turned(point.rotations, delta, left=True)
    return Estimate.trusted(turned), float(np.linalg.norm(delta))


def _in_world(R: FloatArray, tangent: FloatArray) -> FloatArray:
    """Body-frame tangents (n, p) in the world frame; the first, of the fixed node, is zero."""
    world = tangent.copy() if R.shape[-1] == 2 else (R @ tangent[:, :, None])[:, :, 0]
    world[0] = 0.0
    return world
