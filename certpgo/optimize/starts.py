"""Where the certified pipeline starts: cheap and usually in the right basin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.trees import compose, spanning_tree
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize import spectral
from certpgo.optimize.averaging import laplacian_gauss_newton

#: Stationarity at which averaged rotations are good enough for Newton's method on poses.
ROUGH = 1e-2
#: Stationarity asked of rotations when they are all there is.
FINE = 1e-11
#: Slow steps in a row that averaging may take, and nodes from which eigenvectors cost many more.
HASTY, PATIENT, LARGE = 2, 20, 20_000
#: Relative accuracy of eigenvectors that only start something: of Q, and of L, whose basins are
#: farther from its eigenvectors.
Q_TOL, L_TOL = 1e-2, 1e-4


@dataclass(frozen=True, eq=False)
class Start:
    """A starting point.

    Attributes
    ----------
    estimate : where to start
    name : the method it is from, for reports
    near : whether it is likely in the core of its basin, where the Hessian is definite
    """

    estimate: Estimate
    name: str
    near: bool = False


def start_of(problem: Problem) -> Start:
    """A start for a problem.

    Rotations are composed along a spanning tree and averaged with the scalar Laplacian
    (`laplacian_gauss_newton`). Where the noise is too large for that to settle fast, eigenvectors
    take its place: in space those of the data matrix, which know the translations (`eigen_q`),
    in the plane and for rotations alone the connection Laplacian's (`eigen_ma`, `eigen_ra`). Where
    these fail, which weights over many decades cause, the average serves as it is.
    """
    graph = problem.rotation.graph
    tree = compose(graph, spanning_tree(graph, root="center"))
    averaged, settled = _averaged(problem, tree)
    if settled:
        return Start(problem.complete(averaged.rotations), "laplacian_gauss_newton")
    try:
        return _of_eigenvectors(problem, averaged)
    except (NumericalError, np.linalg.LinAlgError):
        return Start(problem.complete(averaged.rotations), "laplacian_gauss_newton")


def _of_eigenvectors(problem: Problem, averaged: Estimate) -> Start:
    if isinstance(problem, PoseProblem) and problem.d == 3:
        pairs = spectral.eliminated_eigenpairs(problem, tol=Q_TOL, start=averaged)
        rotations = spectral.round_to_rotations(pairs.vectors, problem.d)
        return Start(problem.complete(rotations), "eigen_q", near=True)
    name = "eigen_ma" if isinstance(problem, PoseProblem) else "eigen_ra"
    return Start(spectral.spectral_start(problem, tol=L_TOL, start=averaged), name)


def _averaged(problem: Problem, tree: Estimate) -> tuple[Estimate, bool]:
    """Averaged rotations, and whether they settled fast."""
    tolerance = ROUGH if isinstance(problem, PoseProblem) else FINE
    patience = HASTY if problem.n < LARGE else PATIENT
    try:
        found = laplacian_gauss_newton(
            problem.rotation, tree, tolerance=tolerance, patience=patience
        )
    except NumericalError:
        return tree, False
    return found.estimate, found.trace[-1].gradient <= ROUGH
