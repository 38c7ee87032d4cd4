"""A choice of the measurements that agree with one another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certpgo.certify.certificate import Tier
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.methods._robust import remark
from certpgo.solve import relaxation

#: What measurements are chosen for.
Posed = Quadratic | Sum


@dataclass(frozen=True, eq=False, repr=False)
class Selection(Brief):
    """Measurements that agree with one another, and a fit to them.

    Attributes
    ----------
    weights : (m,) 1 for kept measurements, which connect the graph, and 0 for the others
    estimate : a robust fit, near the best one to the kept measurements
    method : the method that computed the fit
    scale : assumed standard deviation of the noise, relative to that stated by the weights
    stated : the choice at the noise that the weights state, where another is assumed and that
        choice differs
    """

    weights: FloatArray
    estimate: Estimate
    method: str
    scale: float
    stated: Selection | None = None

    @property
    def rejected(self) -> BoolArray:
        """(m,) which measurements were rejected."""
        return np.asarray(self.weights == 0.0)

    def note(self, problem: Posed) -> str:
        """How the measurements were chosen, with remarks."""
        scale = "" if self.scale == 1.0 else f"{self.scale:.3g} times "
        chosen = f"chosen by {self.method}, assuming {scale}the noise stated by the weights"
        return "; ".join(filter(None, (chosen, remark(problem.chordal, self.weights))))

    def with_more(self, weights: FloatArray) -> Selection:
        """The choice with more measurements, of these weights."""
        stated = None if self.stated is None else self.stated.with_more(weights)
        return replace(self, weights=np.append(self.weights, weights), stated=stated)


def near_relaxation(problem: Sum) -> Estimate:
    """An estimate under F, for nodes that distances alone join to the others."""
    isotropic = NormalizedProblem.of(problem.isotropic, Tier.STANDARD, RTOL, ATOL)
    found = relaxation.near_relaxation(isotropic)
    if found is None:
        raise NumericalError("no estimate of measurements with distances was found")
    return found.point
