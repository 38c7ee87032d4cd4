"""Rotation averaging from a spanning tree, with the scalar Laplacian as Hessian."""

from __future__ import annotations

from dataclasses import dataclass, replace

from certpgo.graph import Estimate
from certpgo.graph.trees import tree_initialization
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.laplacian_averaging import laplacian_gauss_newton
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution


@dataclass(frozen=True)
class LaplacianGaussNewton(Iterative):
    """Gauss-Newton with one n x n factorization; see `certpgo.optimize.laplacian_averaging`.

    Initialized by the breadth-first tree of a central node by default. Local: fast for small
    residual angles, stalls for large ones. Translations, if any, are optimal for the rotations.

    Attributes
    ----------
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> get_solver("laplacian_gauss_newton")().solve(problem).status.value
    'converged'
    """

    tolerance: float = 1e-11
    max_iterations: int = 100

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations, with optimal translations if the problem has any."""
        watch = Stopwatch()
        if initial is None:
            with watch.phase("tree"):
                initial = tree_initialization(problem.rotation.graph)
        found = laplacian_gauss_newton(
            problem.rotation,
            initial,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
            patience=self.max_iterations,
            monitor=monitor,
            watch=watch,
        )
        estimate = problem.complete(found.estimate.rotations)
        return replace(found, estimate=estimate, cost=problem.cost(estimate))


SOLVER = LaplacianGaussNewton
