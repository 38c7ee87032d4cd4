"""Pymanopt's Riemannian trust region (Townsend, Koep, Weichwald, JMLR 2016) on St(r, d)^n."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.errors import MissingDependency, SpecError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, lifted, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status
from certpgo.optimize.spectral import spectral_start


@dataclass(frozen=True)
class TrustRegion(Settings):
    """Pymanopt on the low-rank problem, with its own defaults and no preconditioner.

    Attributes
    ----------
    rank : r >= d; by default d + 1
    max_iterations : stop anyway
    min_gradient_norm : norm of the Riemannian gradient of F at which to stop, in units of weights
    """

    rank: int | None = None
    max_iterations: int = 1000
    min_gradient_norm: float = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        self._rank(2)
        if not (self.max_iterations > 0 and self.min_gradient_norm > 0.0):
            raise SpecError("max_iterations and min_gradient_norm must be positive")

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Minimise from the eigenvectors and round; the note is pymanopt's own reason to stop.

        Pymanopt calls nothing back, so the monitor is not used.
        """
        rank = self._rank(problem.d)
        if initial is not None:
            problem.check(initial)
        library()  # importing it is not timed
        watch = Stopwatch()
        with watch.phase("start"):
            start = lifted(initial or spectral_start(problem), rank).rotations
        # At a stationary initial point its first step is 0/0, which is harmless.
        with watch.phase("solve"), np.errstate(divide="ignore", invalid="ignore"):
            result = self._run(problem, start)
        with watch.phase("round"):
            estimate = problem.complete(rounded(Lift(result.point)).rotations)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=self._status(result),
            iterations=result.iterations,
            seconds=dict(watch.seconds),
            note=f"rank {rank}, pymanopt: {result.stopping_criterion}",
        )

    def _rank(self, d: int) -> int:
        rank = d + 1 if self.rank is None else self.rank
        if rank < d:
            raise SpecError(f"the rank must be at least {d} here, not {rank}")
        return rank

    def _run(self, problem: Quadratic, start: FloatArray) -> Any:
        search = library().optimizers.TrustRegions(
            max_iterations=self.max_iterations,
            min_gradient_norm=self.min_gradient_norm,
            verbosity=0,
        )
        return search.run(_stated(problem, start.shape[1]), initial_point=start)

    def _status(self, result: Any) -> Status:
        if result.gradient_norm < self.min_gradient_norm:
            return Status.CONVERGED
        limited = result.iterations >= self.max_iterations
        return Status.ITERATION_LIMIT if limited else Status.TIME_LIMIT


def library() -> Any:
    """The pymanopt module, or MissingDependency."""
    try:
        import pymanopt
    except ImportError:
        raise MissingDependency("pymanopt", "test", package="pymanopt") from None
    return pymanopt


def _stated(problem: Quadratic, rank: int) -> Any:
    """The problem for pymanopt, with translations eliminated exactly."""
    pymanopt = library()
    manifold = pymanopt.manifolds.Stiefel(rank, problem.d, k=problem.n)
    origin = np.zeros((problem.n, rank)) if problem.has_positions else None

    @pymanopt.function.numpy(manifold)
    def cost(Y: FloatArray) -> float:
        return problem.cost(problem.with_optimal_translations(Lift(Y, origin)))

    @pymanopt.function.numpy(manifold)
    def gradient(Y: FloatArray) -> FloatArray:
        point = problem.with_optimal_translations(Lift(Y, origin))
        return 2.0 * problem.gradient(point)[:, :, -problem.d :]

    hessian = pymanopt.function.numpy(manifold)(lambda Y, V: gradient(V))  # gradient is linear
    return pymanopt.Problem(manifold, cost, euclidean_gradient=gradient, euclidean_hessian=hessian)


SOLVER = TrustRegion
