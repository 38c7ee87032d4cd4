"""Burer and Monteiro's factorization of the relaxation, rounded to an estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, Point, rounded
from certpgo.linalg.rotations import orthonormal
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.low_rank_descent import descend
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution


@dataclass(frozen=True)
class LowRank(Iterative):
    """Burer and Monteiro's method for the semidefinite relaxation, rounded to an estimate.

    Attributes
    ----------
    rank : r >= d; by default d + 1
    seed : of a random initial point, which replaces the eigenvectors
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    At rank d + 1 a winding can be undone, which at rank d it cannot:

    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(9, 0.3, 1)
    >>> problem = Quadratic(instance.graph)
    >>> solution = get_solver("low_rank")(seed=1).solve(problem)
    >>> bool(abs(solution.cost - problem.cost(instance.truth)) < 1e-9)
    True
    """

    tolerance: float = 1e-10
    max_iterations: int = 500
    rank: int | None = None
    seed: int | None = None

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The estimate nearest to the point reached, with optimal translations.

        Raises
        ------
        SpecError
            The rank is below the dimension of space.
        """
        rank = problem.d + 1 if self.rank is None else self.rank
        if rank < problem.d:
            raise SpecError(f"the rank must be at least {problem.d} here, not {rank}")
        watch = Stopwatch()
        with watch.phase("start"):
            start = initial or self._start(problem, rank)
        found = descend(
            problem,
            start,
            rank,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
            monitor=monitor,
            watch=watch,
        )
        with watch.phase("round"):
            estimate = problem.complete(rounded(found.point.subset(problem.poses)).rotations)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=found.status,
            iterations=found.trace[-1].number,
            seconds=watch.seconds,
            trace=found.trace,
            counts=found.counts,
            note=f"rank {rank}, F {found.cost:.10g} before rounding",
        )

    def _start(self, problem: Quadratic, rank: int) -> Point:
        if self.seed is None:
            return spectral.spectral_start(problem)
        rng = np.random.default_rng(self.seed)
        Y = orthonormal(rng.standard_normal((problem.n, rank, problem.d)))
        return Lift(Y, np.zeros((problem.n, rank)))


SOLVER = LowRank
