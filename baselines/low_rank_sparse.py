"""Low-rank and sparse decomposition of M_B, which removes outliers.

Arrigoni, Rossi, Fusiello, "Global registration of 3D point sets via LRS decomposition", ECCV 2016;
Moreira 2020, eq. 2.15. In the form of their R-GoDec:

    minimise 1/2 ||W o (Mtilde_B - L - S)||_F^2 + threshold ||S||_1

over L of rank b and S with the support of the mask W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.linalg.arrays import FloatArray

from ._completion import Alternation, Start


@dataclass(frozen=True)
class LowRankSparse(Alternation):
    """R-GoDec, with the nearest L in each step instead of a random bilateral projection.

    Missing blocks are filled from L; S is the residual, shrunk by the threshold. Like
    expectation-maximization it stagnates if few blocks are known.

    Attributes
    ----------
    tolerance : relative decrease of the cost at which to stop
    max_iterations : stop anyway
    start : ``"measurements"``, with zeros for missing blocks, or ``"tree"``, which is better for
        sparse graphs but trusts outliers
    threshold : residual of an entry above which S absorbs it, radians or metres
    """

    tolerance: float = 1e-7
    max_iterations: int = 2000
    start: Start = "measurements"
    threshold: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.threshold > 0.0:
            raise SpecError(f"threshold must be positive: {self.threshold}")

    def loss(self, residuals: FloatArray) -> tuple[float, FloatArray]:
        """The cost for the best S, with each edge counted twice; residuals without S."""
        small = np.clip(residuals, -self.threshold, self.threshold)
        S = residuals - small
        return 0.5 * float((small * small).sum()) + self.threshold * float(np.abs(S).sum()), small


SOLVER = LowRankSparse
