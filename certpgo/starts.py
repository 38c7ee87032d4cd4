"""Where the certified pipeline starts: cheap and usually in the right basin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo import spectral
from certpgo.averaging import laplacian_gauss_newton
from certpgo.errors import NumericalError
from certpgo.estimate import Estimate
from certpgo.linalg.factor import Factor
from certpgo.problem import PoseProblem, Problem
from certpgo.reduced import Reduced
from certpgo.solution import Solution, Status
from certpgo.trees import compose, spanning_tree

#: Stationarity at which averaged rotations are good enough for Newton's method on poses.
ROUGH = 1e-3
#: Stationarity asked of rotations when they are all there is.
FINE = 1e-11
#: Relative accuracy of eigenvectors that only start something.
EIGEN_TOL = 1e-2
#: A cost this many times the spectral bound, or less, is near the optimum, unless the graph is so
#: large that long waves remain.
NEAR, LARGE = 1.5, 20_000


@dataclass(frozen=True, eq=False)
class Start:
    """A starting point.

    Attributes
    ----------
    estimate : where to start
    name : the method it is from, for reports
    near : whether its cost is near a lower bound, so that it is in the core of a basin
    """

    estimate: Estimate
    name: str
    near: bool = False


def start_of(problem: Problem) -> tuple[Start, Factor | None]:
    """A start for a problem, and the factor of a shifted M when one was needed on the way.

    In space, poses start from the eigenvectors of the data matrix, which know the translations
    (`eigen_q`), seeded by a spanning tree. In the plane, and for rotations alone, they start from
    rotations averaged with the scalar Laplacian (`laplacian_gauss_newton`), or, where the noise
    is too large for that to settle, from eigenvectors (`eigen_ma`, `eigen_ra`).

    Raises
    ------
    NumericalError
        No factorization, or no convergence.
    """
    graph = problem.rotation.graph
    tree = compose(graph, spanning_tree(graph, root="center"))
    if isinstance(problem, PoseProblem) and problem.d == 3:
        Q = Reduced(problem)
        pairs = spectral.eliminated_eigenpairs(problem, tol=EIGEN_TOL, Q=Q, start=tree)
        rotations = spectral.round_to_rotations(pairs.vectors, problem.d)
        estimate = problem.complete(rotations)
        floor = spectral.spectral_bound(problem, pairs)
        near = problem.n < LARGE and problem.cost(estimate) < NEAR * floor
        return Start(estimate, "eigen_q", near), Q.factor
    averaged = _averaged(problem, tree)
    if averaged is not None:
        rotations = averaged.estimate.rotations
        return Start(problem.complete(rotations), "laplacian_gauss_newton"), None
    name = "eigen_ma" if isinstance(problem, PoseProblem) else "eigen_ra"
    return Start(spectral.spectral_start(problem), name), None


def _averaged(problem: Problem, tree: Estimate) -> Solution | None:
    """Averaged rotations; None where they did not settle fast."""
    tolerance = ROUGH if isinstance(problem, PoseProblem) else FINE
    try:
        found = laplacian_gauss_newton(problem.rotation, tree, tolerance=tolerance)
    except (NumericalError, np.linalg.LinAlgError):
        return None
    near = found.trace[-1].gradient <= ROUGH
    return found if near or found.status is Status.CONVERGED else None
