"""GTSAM's Shonan: the smallest eigenvalue that its Lanczos finds is above -1e-4."""

from __future__ import annotations

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic

from ..gtsam_shonan import calls_optimal


def certifier(problem: Quadratic, estimate: Estimate) -> Estimate | None:
    """The estimate, if `checkOptimality` accepts it."""
    if problem.has_positions:
        raise InputError("Shonan judges rotations alone")
    return estimate if calls_optimal(problem, estimate)[0] else None


CERTIFIER = certifier
