"""Common to the rules: whether S + eta I has a Cholesky factor.

S is the certificate matrix of the unmodified estimate, in SE-Sync's scaling, which is ours; for
poses it includes all translations.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.objective.quadratic import Quadratic


def has_factor(problem: Quadratic, estimate: Estimate, eta: float) -> bool:
    """Whether the factorization of S + eta I runs to completion."""
    S = problem.certificate_matrix(problem.multipliers(estimate))
    shifted = add_to_diagonal(S, np.full(S.shape[0], eta))
    return problem.symbolic(shifted).factor(shifted) is not None
