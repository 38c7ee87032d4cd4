"""Truncated least squares by graduated non-convexity, for poses and rotations.

Yang, Antonante, Tzoumas, Carlone, "Graduated Non-Convexity for Robust Spatial Perception", RA-L
2020: minimise sum min(r_e^2, c^2), r_e^2 the terms of F, by surrogates that are practically convex
for small mu and approach the truncated squares for large mu. For fixed mu, poses solve a weighted
problem, and weights have a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.trees import edges_of, spanning_tree
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.chi_squared import quantiles
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.initialization import start_of
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.methods._robust import FAINT, fitted
from certpgo.optimize.methods.spanning_tree import SpanningTree
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution

#: 1 / mu from which the surrogate is practically the sum of r_e: the paper starts from
#: 2 max(r_e^2) / c^2 - 1, where one gross error makes all weights but a tree's vanish.
CONVEX = 1e4
#: Newton steps for each mu.
STEPS = 3


@dataclass(frozen=True)
class GraduatedNonConvexity(Iterative):
    """Robust pose-graph optimization and rotation averaging; d = 2 and 3.

    Initialized by the tree of the earliest measurements, usually the odometry.

    Attributes
    ----------
    probability : that an inlier is kept, if the weights state its noise; c^2 is this quantile of
        r_e^2, see `quantile`
    scale : standard deviation of the noise over that stated by the weights
    rate : factor of mu in each step; 1.4 in the paper
    tolerance : distance of the weights from 0 and 1 at which to stop
    max_iterations : stop anyway

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> problem = Quadratic(instance.graph.with_weights(180.0))
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
            raise SpecError("probability must lie between 0 and 1, and rate between 1 and 1000")
        if not 1e-100 < self.scale < 1e100:
            raise SpecError(f"scale must be positive and less extreme than {self.scale}")

    def solve(
        self,
        problem: Quadratic,
        *,
        initial: Estimate | None = None,
        trusted: IntArray | None = None,
        monitor: Monitor = silent,
    ) -> Solution:
        """The estimate, and weights: 1 for the measurements kept, 0 for the others.

        Parameters
        ----------
        trusted : (k,) measurements that are known to be right: their weights stay 1
        """
        c = self.scale * np.sqrt(quantiles(problem, self.probability))

        def truncated(found: Solution) -> float:
            return float(np.minimum(problem.edge_costs(found.estimate), c**2).sum())

        starts = _starts(problem) if initial is None else [initial]
        ends = (self._from(start, problem, c, trusted, monitor) for start in starts)
        return min(ends, key=truncated)

    def _from(
        self,
        point: Estimate,
        problem: Quadratic,
        c: FloatArray,
        trusted: IntArray | None,
        monitor: Monitor,
    ) -> Solution:
        """The solution from a start, where residuals above c (m,) are truncated."""
        watch = Stopwatch()
        problem.check(point)
        r = np.sqrt(problem.edge_costs(point))
        mu = 1.0 / float(np.clip(2.0 * (r / c).max() ** 2 - 1.0, 1e-6, CONVEX))
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        undecided, turned = np.inf, 0.0
        known = np.zeros(0, dtype=np.intp) if trusted is None else trusted
        while progress.advance(problem.cost(point), undecided, turned):
            before = point.rotations
            with watch.phase("descent"):
                weights = surrogate_weights(r, c, mu)
                weights[known] = 1.0
                weighted = problem.reweighted(np.maximum(weights, FAINT))
                point = newton(
                    weighted, point, NewtonSettings(tolerance=1e-9, max_iterations=STEPS)
                ).estimate
                r = np.sqrt(problem.edge_costs(point))
                # Below 1, small weights may still belong to inliers.
                if mu >= 1.0:
                    undecided = float(np.minimum(weights, 1.0 - weights).max())
                mu *= self.rate
                turned = float(
                    np.linalg.norm(so.angle(np.swapaxes(before, 1, 2) @ point.rotations))
                )
        kept = r <= c
        kept[known] = True
        return fitted(problem, kept, point, progress, note=_threshold(problem, float(c.max())))


def _starts(problem: Quadratic) -> list[Estimate]:
    """Poses along the tree of the earliest measurements.

    Where some measure no whole pose, such as GPS and sightings, these are fitted together with the
    tree of the earliest ones that do: loop closures do not take part, as some may be wrong. Of the
    others some may be, too: another start fits all.
    """
    graph = problem.graph
    if not graph.is_partial:
        return [SpanningTree("earliest").solve(problem).estimate]
    whole = graph.measures_rotation & graph.measures_translation
    order = np.arange(1.0, graph.num_edges + 1.0)
    tree = edges_of(graph, spanning_tree(graph, np.where(whole, order, graph.num_edges + order)))
    weights = np.where(whole, FAINT, 1.0)
    weights[tree] = 1.0
    weighted = problem.reweighted(weights)
    start = start_of(weighted)
    without_loops = newton(weighted, start.estimate, near=start.near).estimate
    return [without_loops, start_of(problem).estimate]


def largest_angle(problem: Quadratic, c: float) -> float:
    """The angle whose residual is c at the median weight, at most pi, radians.

    Zero where no rotation is measured.
    """
    kappa = problem.rotation.median_kappa
    sine = c / float(np.sqrt(8.0 * kappa)) if kappa > 0.0 else 0.0
    return 2.0 * float(np.arcsin(min(sine, 1.0)))


def _threshold(problem: Quadratic, c: float) -> str:
    """A remark on which angles are rejected."""
    if not problem.rotation.median_kappa > 0.0:
        return "no rotation is measured"
    degrees = np.degrees(largest_angle(problem, c))
    if degrees >= 180.0:
        return "no angle alone is rejected: set scale if the weights do not state the noise"
    return f"residuals above {degrees:.3g} degrees are rejected, at the median weight"


def surrogate_weights(r: FloatArray, c: FloatArray | float, mu: float) -> FloatArray:
    """(m,) optimal weights in [0, 1] for residuals r and surrogate mu; eq. 14 of the paper."""
    low, high = np.sqrt(mu / (mu + 1.0)) * c, np.sqrt((mu + 1.0) / mu) * c
    between = c * np.sqrt(mu * (mu + 1.0)) / np.clip(r, low, high) - mu
    return np.where(r <= low, 1.0, np.where(r >= high, 0.0, between))


SOLVER = GraduatedNonConvexity
