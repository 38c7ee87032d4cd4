"""Initialization of the certified pipeline: cheap, and usually in the right basin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.kinds import Node
from certpgo.graph.trees import tree_initialization
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.laplacian_averaging import laplacian_gauss_newton

#: Stationarity at which averaged rotations are good enough for Newton's method on poses.
ROUGH = 1e-2
#: The same for rotation averaging.
FINE = 1e-11
#: Consecutive slow steps allowed in averaging: more from LARGE nodes on, where eigenvectors cost
#: more than many steps.
HASTY, PATIENT, LARGE = 2, 20, 20_000
#: Relative accuracy of the eigenvectors of Q, and of L, whose eigenvectors are farther from the
#: basins.
Q_TOL, L_TOL = 1e-2, 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Start(Brief):
    """An initial estimate.

    Attributes
    ----------
    estimate : rotations, and translations if the problem has them
    name : the method that computed it, for reports
    near : whether it is probably close to a minimum, where the Hessian is definite
    """

    estimate: Estimate
    name: str
    near: bool = False


def start_of(problem: Quadratic) -> Start:
    """The initial estimate of a problem.

    Rotations are composed along a spanning tree and averaged with the scalar Laplacian
    (`laplacian_gauss_newton`). If large noise keeps that from converging fast, eigenvectors are
    used: in 3D those of the data matrix, which includes the translations (`eigen_q`), in 2D and for
    rotations alone those of the connection Laplacian (`eigen_ma`, `eigen_ra`). If these fail,
    because weights range over many decades, the averaged rotations are kept. Where some
    measurements are of translations alone, eigenvectors of the data matrix are used at once. Nodes
    of other kinds start as poses, rounded.
    """
    if problem.graph.has_others:
        plain = np.where(problem.graph.is_other, Node.POSE, problem.graph.nodes)
        found = start_of(problem.of_same_edges(replace(problem.graph, nodes=plain)))
        blocks = problem.kinds.apply("rounded", found.estimate.rotations)
        return Start(problem.complete(blocks), found.name)
    if problem.has_positions and problem.graph.is_partial:
        return _of_partial_edges(problem)
    averaged, converged = _averaged(problem)
    if converged:
        return _of_averages(problem, averaged)
    try:
        return _of_eigenvectors(problem, averaged)
    except (NumericalError, np.linalg.LinAlgError):
        return replace(_of_averages(problem, averaged), near=False)


def averaged_start(problem: Quadratic) -> Start | None:
    """Averaged rotations with best translations, where little noise lets averaging converge."""
    if problem.graph.has_others or (problem.has_positions and problem.graph.is_partial):
        return None
    averaged, converged = _averaged(problem)
    return _of_averages(problem, averaged) if converged else None


def _of_averages(problem: Quadratic, averaged: Estimate) -> Start:
    # In the plane the Hessian is nearly always definite there.
    near = problem.d == 2
    return Start(problem.complete(averaged.rotations), "laplacian_gauss_newton", near)


def _of_eigenvectors(problem: Quadratic, averaged: Estimate) -> Start:
    if problem.has_positions and problem.d == 2:
        return Start(spectral.spectral_start(problem, tol=L_TOL, start=averaged), "eigen_ma")
    if problem.has_positions:
        return Start(spectral.rough_start(problem, tol=Q_TOL, start=averaged), "eigen_q", near=True)
    return Start(spectral.rough_start(problem, tol=L_TOL, start=averaged), "eigen_ra", near=True)


def _of_partial_edges(problem: Quadratic) -> Start:
    tree = tree_initialization(problem.graph.rotations_alone)
    try:
        found = spectral.rough_start(problem, tol=Q_TOL, start=tree)
    except (NumericalError, np.linalg.LinAlgError):
        return Start(problem.complete(tree.rotations), "tree")
    return Start(found, "eigen_q")


def _averaged(problem: Quadratic) -> tuple[Estimate, bool]:
    """Rotations along a tree, averaged, and whether that converged fast."""
    tree = tree_initialization(problem.rotation.graph)
    tolerance = ROUGH if problem.has_positions else FINE
    patience = HASTY if problem.n < LARGE else PATIENT
    try:
        found = laplacian_gauss_newton(
            problem.rotation, tree, tolerance=tolerance, patience=patience
        )
    except NumericalError:
        return tree, False
    return found.estimate, found.trace[-1].gradient <= ROUGH
