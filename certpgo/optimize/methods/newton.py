"""Newton's method from an initial estimate, by default from eigenvectors."""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution


@dataclass(frozen=True)
class Newton(NewtonSettings):
    """Damped Newton with the exact Hessian; local.

    Its settings are those of `certpgo.optimize.riemannian_newton.NewtonSettings`.

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("newton")().solve(problem)
    >>> solution.status.value, problem.stationarity(solution.estimate) < 1e-9
    ('converged', True)
    """

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The stationary point that descent from ``initial`` reaches."""
        watch = Stopwatch()
        if initial is None:
            with watch.phase("start"):
                initial = spectral.spectral_start(problem)
        return newton(problem, initial, self, monitor=monitor, watch=watch)


SOLVER = Newton
