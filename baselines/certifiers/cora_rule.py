"""CORA's rule: S + eta I has a Cholesky factor, with eta = 5e-6 F/2 between 1e-7 and 1e-1."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic

from ._shifted import has_factor

#: Of its objective, which carries a factor 1/2.
RELATIVE, SMALLEST, LARGEST = 5e-6, 1e-7, 1e-1


def certifier(problem: Quadratic, estimate: Estimate) -> Estimate | None:
    """The estimate, if the rule accepts it."""
    eta = float(np.clip(0.5 * RELATIVE * problem.cost(estimate), SMALLEST, LARGEST))
    return estimate if has_factor(problem, estimate, eta) else None


CERTIFIER = certifier
