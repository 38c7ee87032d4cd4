"""Truncated least squares by graduated non-convexity, for poses and rotations.

Yang, Antonante, Tzoumas, Carlone, "Graduated Non-Convexity for Robust Spatial Perception", RA-L
2020: minimise sum min(r_e^2, c^2), r_e^2 the terms of F, through surrogates that are convex in
effect for small mu and the truncated squares themselves for large ones. Given mu, minimising over
poses is a weighted problem, and over weights has a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from certpgo import newton
from certpgo.errors import SpecError
from certpgo.estimate import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.monitor import Monitor, Stopwatch, silent
from certpgo.problem import PoseProblem, Problem
from certpgo.progress import Progress
from certpgo.robust import connected
from certpgo.solution import Solution
from certpgo.solvers._iterative import Iterative
from certpgo.solvers.spanning_tree import SpanningTree

#: Weight of a measurement rejected for now, and steps of Newton's method for each mu.
FAINT, STEPS = 1e-9, 3


@dataclass(frozen=True)
class GraduatedNonConvexity(Iterative):
    """Robust pose-graph optimization and rotation averaging; d = 2 and 3.

    It starts from the tree of the earliest measurements, which of poses is the odometry.

    Attributes
    ----------
    probability : with which a right measurement is kept, where the weights state its noise: r_e^2
        then has a chi-square distribution of about d degrees of freedom for the rotation and d for
        the translation, and c^2 is its quantile
    scale : standard deviations of the noise, in units that the weights state
    rate : what mu is multiplied by in each step; 1.4 in the paper
    tolerance : distance of the weights from 0 and 1 at which to stop
    max_iterations : stop anyway
    """

    probability: float = 0.99
    scale: float = 1.0
    rate: float = 1.4
    tolerance: float = 1e-3
    max_iterations: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0.0 < self.probability < 1.0 and self.scale > 0.0 and self.rate > 1.0):
            raise SpecError("probability lies between 0 and 1, scale above 0 and rate above 1")

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The estimate, and weights: 1 for the measurements that were kept, 0 for the others."""
        watch = Stopwatch()
        point = initial or SpanningTree("earliest").solve(problem).estimate
        problem.check(point)
        freedom = problem.d * (1 + isinstance(problem, PoseProblem))
        c = self.scale * float(np.sqrt(stats.chi2.ppf(self.probability, freedom)))
        r = np.sqrt(problem.edge_costs(point))
        mu = 1.0 / max(2.0 * float(r.max() / c) ** 2 - 1.0, 1e-6)
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        undecided = np.inf
        while not progress.ends(problem.cost(point), undecided, undecided):
            with watch.phase("descent"):
                weights = surrogate_weights(r, c, mu)
                weighted = problem.reweighted(np.maximum(weights, FAINT))
                point = newton.newton(
                    weighted, point, tolerance=1e-9, max_iterations=STEPS
                ).estimate
                r = np.sqrt(problem.edge_costs(point))
                undecided = float(np.minimum(weights, 1.0 - weights).max())
                mu *= self.rate
        weights = connected(problem, np.where(r <= c, 1.0, 0.0), r)
        with watch.phase("newton"):
            point = newton.newton(problem.reweighted(weights), point, tolerance=1e-9).estimate
        return Solution(
            estimate=point,
            cost=problem.cost(point),
            status=progress.status,
            iterations=progress.steps,
            seconds=watch.seconds,
            trace=tuple(progress.trace),
            weights=weights,
        )


def surrogate_weights(r: FloatArray, c: float, mu: float) -> FloatArray:
    """(m,) best weights in [0, 1] for residuals r of the surrogate mu; eq. 14 of the paper."""
    low, high = np.sqrt(mu / (mu + 1.0)) * c, np.sqrt((mu + 1.0) / mu) * c
    between = c * np.sqrt(mu * (mu + 1.0)) / np.clip(r, low, high) - mu
    return np.where(r <= low, 1.0, np.where(r >= high, 0.0, between))


SOLVER = GraduatedNonConvexity
