"""Expectation-maximization for the completion of M_B.

Guerreiro and Aguiar 2002; Moreira 2020, eq. 2.14 and algorithm 1:

    minimise ||W o (Mtilde_B - M_B)||_F^2 over M_B of rank b.

The E-step fills missing blocks of Mtilde_B from the current M_B, the M-step takes the truncated SVD
of the filled matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.linalg.arrays import FloatArray

from ._completion import Alternation


@dataclass(frozen=True)
class ExpectationMaximization(Alternation):
    """Stagnates if few blocks are known, as steps become tiny.

    Neither cost nor status distinguish that from convergence.

    Attributes
    ----------
    tolerance : relative decrease of the cost at which to stop
    max_iterations : stop anyway
    start : ``"tree"``, or ``"measurements"``, with zeros for missing blocks
    """

    tolerance: float = 1e-7
    max_iterations: int = 2000

    def loss(self, residuals: FloatArray) -> tuple[float, FloatArray]:
        """Half the sum of squares, with each edge counted twice; the residuals."""
        return 0.5 * float((residuals * residuals).sum()), residuals


SOLVER = ExpectationMaximization
