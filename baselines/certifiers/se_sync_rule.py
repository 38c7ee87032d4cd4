"""SE-Sync's rule: S + 1e-3 I has a Cholesky factor, whatever the weights (SESync.h, Rosen 2019)."""

from __future__ import annotations

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic

from ._shifted import has_factor

#: ``min_eig_num_tol``.
ETA = 1e-3


def certifier(problem: Quadratic, estimate: Estimate) -> Estimate | None:
    """The estimate, if the rule accepts it."""
    return estimate if has_factor(problem, estimate, ETA) else None


CERTIFIER = certifier
