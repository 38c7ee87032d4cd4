"""GTSAM's staircase, started at an estimate and held at the dimension of space.

It descends first, then asks whether S + 1e-3 I has a Cholesky factor.
"""

from __future__ import annotations

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status

from ..gtsam_staircase import Staircase


def certifier(problem: Quadratic, estimate: Estimate) -> Estimate | None:
    """What it calls certified, near the estimate or where its descent ended."""
    if problem.has_positions:
        raise InputError("GTSAM's staircase takes rotations alone")
    solution = Staircase(max_rank=problem.d).solve(problem, initial=estimate)
    return solution.estimate if solution.status is Status.CONVERGED else None


CERTIFIER = certifier
