"""Steps with the factor of an earlier Hessian: the chord method.

They cost a solve, and converge linearly, the faster the nearer the Hessian was to the minimum; see
Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), section 5.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from certpgo.linalg.arrays import FloatArray

#: Limits of the curvature along a step over the factor's: beyond, another step is the better one.
FLATTEST, STEEPEST = 0.2, 2.0


@dataclass(frozen=True, eq=False)
class Chord:
    """A step with the factor of an earlier Hessian P, and what it promises.

    Its length is that of Barzilai and Borwein (1988), by the curvature along the last such step.

    Attributes
    ----------
    direction : (N,) -P^-1 g, for half the gradient g
    decrease : of F, as P predicts it for the direction; positive
    last : the decrease that was predicted for the step before
    curvature : of F along the last chord over that of P; 1 after a step of another kind
    """

    direction: FloatArray
    decrease: float
    last: float
    curvature: float = 1.0

    @property
    def step(self) -> FloatArray:
        """(N,) the step."""
        return self.direction / self.curvature

    @property
    def predicted(self) -> float:
        """The decrease of F that its length promises."""
        return self.decrease / self.curvature

    def curvature_for(self, decrease: float) -> float:
        """The curvature of F along the step, over that of P, if F fell by ``decrease``."""
        length = 1.0 / self.curvature
        found = (2.0 * length - decrease / self.decrease) / length**2
        return min(max(found, FLATTEST), STEEPEST)

    @property
    def rate(self) -> float:
        """The predicted decrease over that of the step before, at most 1."""
        return self.decrease / self.last if self.decrease < self.last else 1.0

    def count(self, enough: float) -> float:
        """Steps until the predicted decrease is ``enough``, at the rate of the last one."""
        if self.decrease <= enough:
            return 0.0
        if not (enough > 0.0 and self.rate < 1.0):
            return math.inf
        return math.log(self.decrease / enough) / -math.log(self.rate)
