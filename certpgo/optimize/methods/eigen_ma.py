"""EigenMA: rotations from eigenvectors, then translations from one linear system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.methods.eigen_ra import Anchor, EigenRA, Eigensolver, Weights
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status


@dataclass(frozen=True)
class EigenMA(Settings):
    """The closed-form estimator of Moreira 2020, sections 4.3 and 4.6, d = 2 and 3.

    Attributes
    ----------
    weights : ``"graph"`` uses kappa and tau; ``"unit"`` weighs edges equally, as the thesis does
    translations : ``"ml"`` minimises F for the rotations found; ``"thesis"`` solves eq. 4.12,
        which counts each edge in both directions and does not minimise F exactly
    anchor, eigensolver, tol : as `EigenRA`

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import helix
    >>> problem = Quadratic(helix(3, np.random.default_rng(0)).graph)
    >>> ml, thesis = (
    ...     get_solver("eigen_ma")(translations=which).solve(problem) for which in ("ml", "thesis")
    ... )
    >>> ml.cost < thesis.cost
    True
    """

    weights: Weights = "graph"
    translations: Literal["ml", "thesis"] = "ml"
    anchor: Anchor = "none"
    eigensolver: Eigensolver = "krylov_schur"
    tol: float = 1e-5

    rotations: ClassVar[bool] = False
    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The poses; InputError for a problem without translations."""
        if not problem.has_positions:
            raise InputError("EigenMA needs translations; use eigen_ra for rotations alone")
        watch = Stopwatch()
        weighted = problem.with_unit_weights() if self.weights == "unit" else problem
        averaging = EigenRA(self.weights, self.anchor, self.eigensolver, self.tol)
        rotations, _ = averaging.rotations_of(weighted.rotation, watch)
        with watch.phase("translations"):
            if self.translations == "ml":
                t = weighted.complete(rotations).translations
            else:
                t = symmetrized_translations(weighted, rotations)
        estimate = Estimate(rotations, t)
        return Solution(estimate, problem.cost(estimate), Status.CLOSED_FORM, seconds=watch.seconds)


def symmetrized_translations(problem: Quadratic, rotations: FloatArray) -> FloatArray:
    """Translations (n, d) of the thesis' system, eq. 4.12, the first at zero.

    It counts each edge in both directions, equivalent to t_j - t_i ~
    (R_i t_ij + R_j R_ij^T t_ij) / 2. The sign of b between 4.11 and 4.12 is wrong; both are right.
    """
    graph = problem.graph
    require_capable(graph, "isotropic method")
    i, j = graph.edges.T
    t = graph.translations[:, :, None]
    forward = rotations[i] @ t
    backward = rotations[j] @ (np.swapaxes(graph.rotations, 1, 2) @ t)
    step = graph.tau[:, None] * 0.5 * (forward + backward)[:, :, 0]
    return problem.elimination.solve(
        scatter_sum(j, step, problem.n) - scatter_sum(i, step, problem.n)
    )


SOLVER = EigenMA
