"""Rotation averaging that trims the worst measurements, down to the noise level of the others.

Truncated least squares: minimise sum min(r_e^2, c^2) over the rotations, r_e^2 the terms of F,
by alternating between the edges below c and the rotations that fit them. The threshold starts above
all residuals and shrinks slowly, which avoids poor local minima, as in graduated non-convexity
(Yang et al., RA-L 2020) and adaptive trimming (Tzoumas, Antonante, Carlone, IROS 2019). It ends at
a multiple of the noise, which is estimated from the kept residuals and need not be known if there
are plenty of measurements. With little redundancy, as in most pose graphs, the remaining
measurements would fit exactly whatever their noise: such graphs are refused, and trimming stops
before it produces one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import special

from certpgo.errors import GraphError, SpecError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.laplacian_averaging import laplacian_step
from certpgo.optimize.methods._robust import FAINT, fitted
from certpgo.optimize.methods.eigen_ra import EigenRA
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

#: Measurements per node, below which residuals say little about the noise.
PLENTY = 4
#: Residuals (radians) below which measurements count as exact.
EXACT = 1e-7


@dataclass(frozen=True)
class AdaptiveTrimming(Iterative):
    """Robust rotation averaging by truncated least squares; d = 2 and 3.

    Attributes
    ----------
    multiple : the last threshold, in standard deviations (per axis) of the kept residuals; 3.4
        keeps 99 % of the inliers
    rate : factor of the threshold in each step
    tolerance : norm of the step at which to stop, radians
    max_iterations : stop anyway

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> problem = Quadratic(instance.graph)
    >>> solution = get_solver("adaptive_trimming")().solve(problem)
    >>> bool((solution.weights[instance.outliers] == 0.0).all())  # all outliers are rejected
    True
    """

    multiple: float = 3.4
    rate: float = 0.9
    tolerance: float = 1e-6
    max_iterations: int = 300

    poses: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.multiple >= 2.0 and 0.0 < self.rate < 1.0):
            raise SpecError("multiple must be at least 2, and rate between 0 and 1")

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations, and weights: 1 for the measurements kept, 0 for the others.

        Raises
        ------
        GraphError
            There are fewer than four measurements per node.
        """
        watch = Stopwatch()
        rotation = problem.rotation
        if initial is None:
            R, _ = EigenRA().rotations_of(rotation, watch)
            initial = Estimate(R)
        problem.check(initial)
        point, plenty = Estimate(initial.rotations), PLENTY * rotation.n
        if rotation.graph.num_edges < plenty:
            raise GraphError(
                f"{rotation.graph.num_edges} measurements of {rotation.n} nodes are too few to "
                f"estimate their noise: adaptive trimming needs {PLENTY} per node"
            )
        # kappa |E|^2 is about 2 kappa times the squared angle, a sum over axes.
        freedom = so.tangent_dim(problem.d)  # chi^2's median is twice gamma's
        median = np.sqrt(2.0 * special.gammaincinv(0.5 * freedom, 0.5))
        exact = EXACT * np.sqrt(2.0 * rotation.graph.kappa.mean())
        r = np.sqrt(rotation.edge_costs(point))
        threshold, kept, moved = np.inf, np.ones(len(r), dtype=bool), np.inf
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        while progress.advance(rotation.cost(point), moved, moved):
            with watch.phase("trim"):
                count = int(kept.sum())
                redundant = (count - rotation.n + 1) / count
                noise = float(np.median(r[kept])) / (median * math.sqrt(redundant))
                shrunk = self.rate * min(threshold, float(r.max()) / self.rate)
                least = float(np.partition(r, plenty - 1)[plenty - 1])
                threshold = min(max(shrunk, self.multiple * noise, exact, least), threshold)
                before, kept = kept, r <= threshold
                final = np.array_equal(before, kept) and threshold > shrunk
                weighted = rotation.reweighted(np.where(kept, 1.0, FAINT))
                point, step = laplacian_step(weighted, point)
                moved = step if final else np.inf
                r = np.sqrt(rotation.edge_costs(point))
        return fitted(rotation, kept, point, progress)


SOLVER = AdaptiveTrimming
