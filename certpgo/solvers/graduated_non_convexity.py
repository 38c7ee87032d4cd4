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

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.newton import NewtonSettings, newton
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution
from certpgo.solvers._robust import FAINT, fitted
from certpgo.solvers.spanning_tree import SpanningTree

#: 1 / mu from which on the surrogate is in effect the sum of r_e, whatever mu is: the paper starts
#: at 2 max(r_e^2) / c^2 - 1, where one gross error makes all other weights vanish next to a tree's.
CONVEX = 1e4
#: Steps of Newton's method for each mu.
STEPS = 3


@dataclass(frozen=True)
class GraduatedNonConvexity(Iterative):
    """Robust pose-graph optimization and rotation averaging; d = 2 and 3.

    It starts from the tree of the earliest measurements, which of poses is the odometry.

    Attributes
    ----------
    probability : with which a right measurement is kept, where the weights state its noise; c^2 is
        the quantile of r_e^2, see `quantile`
    scale : standard deviations of the noise, in units that the weights state
    rate : what mu is multiplied by in each step; 1.4 in the paper
    tolerance : distance of the weights from 0 and 1 at which to stop
    max_iterations : stop anyway

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import RotationProblem, get_solver
    >>> from certpgo.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> problem = RotationProblem(instance.graph.with_weights(180.0))
    >>> solution = get_solver("graduated_non_convexity")().solve(problem)
    >>> float((solution.weights[instance.outliers] == 0.0).mean()) > 0.9
    True
    """

    probability: float = 0.99
    scale: float = 1.0
    rate: float = 1.4
    tolerance: float = 1e-3
    max_iterations: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0.0 < self.probability < 1.0 and 1.0 < self.rate < 1e3):
            raise SpecError("probability lies between 0 and 1, and rate between 1 and 1000")
        if not 1e-100 < self.scale < 1e100:
            raise SpecError(f"scale must be positive, and no more extreme than {self.scale}")

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The estimate, and weights: 1 for the measurements that were kept, 0 for the others."""
        watch = Stopwatch()
        point = initial or SpanningTree("earliest").solve(problem).estimate
        problem.check(point)
        c = self.scale * float(np.sqrt(quantile(problem, self.probability)))
        r = np.sqrt(problem.edge_costs(point))
        mu = 1.0 / float(np.clip(2.0 * (r.max() / c) ** 2 - 1.0, 1e-6, CONVEX))
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        undecided = np.inf
        while progress.advance(problem.cost(point), undecided, undecided):
            with watch.phase("descent"):
                weights = surrogate_weights(r, c, mu)
                weighted = problem.reweighted(np.maximum(weights, FAINT))
                point = newton(
                    weighted, point, NewtonSettings(tolerance=1e-9, max_iterations=STEPS)
                ).estimate
                r = np.sqrt(problem.edge_costs(point))
                # Below 1, small weights are those of residuals that may yet be right.
                if mu >= 1.0:
                    undecided = float(np.minimum(weights, 1.0 - weights).max())
                mu *= self.rate
        return fitted(problem, r <= c, point, progress, note=_threshold(problem, c))


def largest_angle(problem: Problem, c: float) -> float:
    """The angle that alone has the residual c, at the median weight; pi where none has, radians."""
    sine = c / float(np.sqrt(8.0 * np.median(problem.rotation.graph.kappa)))
    return 2.0 * float(np.arcsin(min(sine, 1.0)))


def _threshold(problem: Problem, c: float) -> str:
    """Which angle alone is rejected."""
    degrees = np.degrees(largest_angle(problem, c))
    if degrees >= 180.0:
        return "no angle alone is rejected: set scale, if the weights do not state the noise"
    return f"residuals of {degrees:.3g} degrees and more are rejected, at the median weight"


def quantile(problem: Problem, probability: float) -> float:
    """Of a right measurement's r_e^2, where the weights state its noise.

    A rotation adds the square of a normal variable an axis, twice that in 2D, where kappa |E|^2 is
    2 kappa times the squared angle and kappa the angle's information; a translation adds d
    squares. The distribution of the sum is taken for a multiple of a chi-square one with the same
    mean and variance (Welch and Satterthwaite), which is exact but for poses in 2D.
    """
    axes = np.full(so.tangent_dim(problem.d), 2.0 if problem.d == 2 else 1.0)
    terms = np.r_[axes, np.ones(problem.d)] if isinstance(problem, PoseProblem) else axes
    unit = float((terms**2).sum() / terms.sum())
    freedom = float(terms.sum()) / unit
    return unit * float(stats.chi2.ppf(probability, freedom))


def surrogate_weights(r: FloatArray, c: float, mu: float) -> FloatArray:
    """(m,) best weights in [0, 1] for residuals r of the surrogate mu; eq. 14 of the paper."""
    low, high = np.sqrt(mu / (mu + 1.0)) * c, np.sqrt((mu + 1.0) / mu) * c
    between = c * np.sqrt(mu * (mu + 1.0)) / np.clip(r, low, high) - mu
    return np.where(r <= low, 1.0, np.where(r >= high, 0.0, between))


SOLVER = GraduatedNonConvexity
