"""What can be said about an answer, and with what right."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from certpgo.certify.bounds import Bounds
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray


class Verdict(Enum):
    """The judgement of an estimate; never a bare boolean.

    Attributes
    ----------
    CERTIFIED : the gap is proven to be at most rtol F + atol W
    REFUTED : a better estimate is in hand, which descent from this one does not reach
    BOUNDED : a gap is proven, and it is larger than that
    UNDECIDED : no useful bound was found

    Examples
    --------
    >>> from certpgo import Verdict
    >>> Verdict("CERTIFIED") is Verdict.CERTIFIED
    True
    """

    CERTIFIED = "CERTIFIED"
    REFUTED = "REFUTED"
    BOUNDED = "BOUNDED"
    UNDECIDED = "UNDECIDED"


class Tier(Enum):
    """What a certificate trusts, besides the mathematics.

    Attributes
    ----------
    SCREEN : a factorization as it is; never yields CERTIFIED
    STANDARD : that the factorization and BLAS keep the usual componentwise error bound; the
        rounding they cause is bounded (Rump and Jeannerod 2014, see `certpgo.certify.dual`)
    PROOF : IEEE 754 arithmetic, Python, and NumPy's sums of products; what a factorization leaves
        over is measured, as `certpgo.checker` does

    Examples
    --------
    >>> from certpgo import RotationProblem, certify
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> problem = RotationProblem(instance.graph)
    >>> certify(problem, instance.truth, tier="proof").verdict.value
    'CERTIFIED'
    >>> certify(problem, instance.truth, tier="screen").verdict.value
    'BOUNDED'
    """

    SCREEN = "screen"
    STANDARD = "standard"
    PROOF = "proof"


@dataclass(frozen=True, eq=False)
class Certificate:
    """The judgement of an estimate against the best possible one.

    Costs and gaps are in units of F, which has none where kappa and tau are inverse variances. How
    a bound follows from the multipliers: Eriksson et al. 2018, eq. 16 and 18, for any feasible
    point.

    Attributes
    ----------
    verdict : see `Verdict`
    tier : what was trusted
    cost_upper : F of the estimate as given, rounded up
    lower_bound : no estimate of this graph has a smaller F; 0 when nothing more was proven
    gap : ``cost_upper - lower_bound``, rounded up
    rtol, atol : CERTIFIED means gap <= rtol * cost_upper + atol * scale
    scale : W, the problem's scale
    stationarity : largest gradient of a node over its weight at the estimate as given, radians
    max_residual_angle : largest angle between R_i R_ij and R_j, radians
    multipliers : (n, d, d) blocks Lam_i of the point that gave the lower bound; None without one
    shift : eta with S + eta I >= 0 on the rotations, part of the bound; 0 without one
    refined : the point that descent from the estimate reaches; unrefined, the estimate with its
        best translations
    refined_cost : F of ``refined``
    basin_is_global : whether ``refined`` is itself within the tolerance of the lower bound
    better : a feasible estimate that is better, from another start, or None; of a REFUTED one,
        descent does not lead there
    better_cost : its F
    bounds : bounds that need no factorization, at ``refined``; None where they failed
    engine : factorization engine
    reason : why the verdict is what it is, one sentence that needs no paper

    Examples
    --------
    >>> from certpgo import RotationProblem, certify
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> certificate = certify(RotationProblem(instance.graph), instance.truth)
    >>> certificate.lower_bound <= certificate.cost_upper
    True
    >>> certificate.gap <= certificate.tolerance
    True
    >>> print(f"{certificate.max_residual_angle:.3f}")  # theta / n at every edge, radians
    0.050
    """

    verdict: Verdict
    tier: Tier
    cost_upper: float
    lower_bound: float
    gap: float
    rtol: float
    atol: float
    scale: float
    stationarity: float
    max_residual_angle: float
    multipliers: FloatArray | None
    shift: float
    refined: Estimate
    refined_cost: float
    basin_is_global: bool
    better: Estimate | None
    better_cost: float | None
    bounds: Bounds | None
    engine: str
    reason: str

    @property
    def relative_gap(self) -> float:
        """``gap / cost_upper``."""
        return self.gap / self.cost_upper if self.cost_upper > 0.0 else math.inf

    @property
    def best(self) -> Estimate:
        """The lowest-cost estimate found: ``better``, or else ``refined``."""
        return self.refined if self.better is None else self.better

    @property
    def best_cost(self) -> float:
        """F of ``best``, rounded up."""
        return self.refined_cost if self.better_cost is None else self.better_cost

    @property
    def tolerance(self) -> float:
        """The gap up to which this estimate counts as optimal."""
        return self.rtol * self.cost_upper + self.atol * self.scale
