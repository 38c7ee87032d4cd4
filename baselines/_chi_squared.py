"""The base of the optimizers of g2o and Ceres, which minimise g2o's chi^2.

Residuals of an edge are y = R_ij^T (R_i^T (t_j - t_i) - t_ij), then the angle of E = R_ij^T R_i^T
R_j in the plane, or the vector part of its quaternion in space. With information (tau I, 2 kappa)
in the plane that is F to second order; with (tau I, 8 kappa I) in space it is F itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.g2o import G2oCost
from certpgo.objective.quadratic import Quadratic

from ._baseline import Baseline
from ._gtsam import chordal_start


@dataclass(frozen=True)
class ChiSquared(Baseline):
    """An optimizer of g2o's chi^2, with its default settings; the first pose is fixed.

    It begins at a given estimate, or else where GTSAM's optimizers do: at GTSAM's chordal
    initialization. It gets isotropic information from the weights of F; under g2o's own cost, all
    of it.

    Attributes
    ----------
    tolerance : relative decrease of chi^2 at which to stop
    max_iterations : stop anyway
    """

    own_costs: ClassVar[tuple[str, ...]] = (G2oCost.name,)

    tolerance: float = 1e-6
    max_iterations: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.tolerance < 1.0 or self.max_iterations < 1:
            raise SpecError(
                "tolerance must lie between 0 and 1, and max_iterations must be at least 1"
            )

    def note(self, problem: Quadratic | Sum) -> str:
        """Which weights the program has."""
        if isinstance(problem, Sum):
            return f"{self.program.name} with full information"
        if problem.d == 3:
            return f"{self.program.name} minimises F itself, by isotropic information"
        return f"{self.program.name} with isotropic information from kappa and tau"

    def _check(self, problem: Quadratic | Sum) -> None:
        super()._check(problem)
        if isinstance(problem, Sum):
            require_capable(problem.measured, "isotropic method")


def started(problem: Quadratic | Sum, initial: Estimate | None) -> Estimate:
    """The given estimate, or where GTSAM's optimizers begin."""
    return chordal_start(problem) if initial is None else initial


def information_of(problem: Quadratic | Sum) -> FloatArray:
    """(m, p, p) information about the residuals."""
    if isinstance(problem, Sum):
        return problem.graph.information_matrices
    graph, d = problem.graph, problem.d
    turned = np.repeat((2.0 if d == 2 else 8.0) * graph.kappa[:, None], so.tangent_dim(d), axis=1)
    diagonals = np.concatenate([np.repeat(graph.tau[:, None], d, axis=1), turned], axis=1)
    return np.asarray(diagonals[:, :, None] * np.eye(diagonals.shape[1]))
