"""The certificate of an estimate: verdict, tier and numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any

from certpgo.certify.bounds import Bounds
from certpgo.certify.dual import Support
from certpgo.certify.obstacle import NOTHING, LimitedBy, Obstacle
from certpgo.certify.region import ProvenDistance, Region
from certpgo.certify.regions import Regions
from certpgo.certify.tolerances import FLOOR, PROOF_GAIN, allowed
from certpgo.certify.wording import Statement
from certpgo.errors import SpecError
from certpgo.graph import Estimate, Instance
from certpgo.graph.held import displaced
from certpgo.graph.phrases import cost_shown, gap_shown
from certpgo.io.json_values import plain
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import CHORDAL

__all__ = ["CHORDAL", "Certificate", "Tier", "Verdict"]

#: Nodes up to which the distance to optima takes a fifth of a second, and is printed.
SMALL = 2000
#: Fields that are no numbers or words.
_ARRAYS = frozenset(
    {"multipliers", "refined", "better", "bounds", "support", "obstacle", "regions"}
)


class Verdict(StrEnum):
    """The verdict on an estimate; equal to its name.

    Attributes
    ----------
    CERTIFIED : the gap is proven to be at most rtol F + atol W, of which the latter is no more than
        0.001 F; or every residual is rounding, and so is the cost
    REFUTED : a better estimate is known. Descent from this one does not reach it, or was given up
        far from it
    BOUNDED : a gap is proven, but it is larger than that
    UNDECIDED : no useful bound was found

    Examples
    --------
    >>> from certpgo import Verdict
    >>> Verdict("CERTIFIED") is Verdict.CERTIFIED, Verdict.CERTIFIED == "CERTIFIED"
    (True, True)
    """

    CERTIFIED = "CERTIFIED"
    REFUTED = "REFUTED"
    BOUNDED = "BOUNDED"
    UNDECIDED = "UNDECIDED"


class Tier(StrEnum):
    """What a certificate relies on, apart from mathematics.

    Attributes
    ----------
    SCREEN : a factorization, ignoring its rounding; never yields CERTIFIED
    STANDARD : the usual componentwise error bound of the factorization and BLAS; their rounding is
        bounded (Rump and Jeannerod 2014, see `certpgo.certify.dual`)
    PROOF : IEEE 754 arithmetic, Python, and NumPy's sums of products; the residual of the
        factorization is measured, as in `certpgo.checker`. Under g2o's cost in the plane, also
        NumPy's sine and arctangent to 4 units in the last place, which proof files do without

    Examples
    --------
    >>> from certpgo import Quadratic, certify
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> problem = Quadratic(instance.graph)
    >>> certify(problem, instance.truth, tier="proof").verdict.value
    'CERTIFIED'
    >>> certify(problem, instance.truth, tier="screen").verdict.value
    'BOUNDED'
    """

    SCREEN = "screen"
    STANDARD = "standard"
    PROOF = "proof"


def tier_called(tier: Tier | str) -> Tier:
    """The tier itself, or the one with that name.

    Raises
    ------
    SpecError
        There is none.
    """
    if isinstance(tier, Tier):
        return tier
    known = {t.value: t for t in Tier}
    if not isinstance(tier, str) or tier not in known:
        raise SpecError.unknown("tier", str(tier), known)
    return known[tier]


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Statement):
    """The verdict on an estimate, with the bound that proves it.

    Costs and gaps are in units of F, which is dimensionless if kappa and tau are inverse variances.
    The bound follows from the multipliers by Eriksson et al. 2018, eq. 16 and 18, for any feasible
    point.

    Attributes
    ----------
    verdict : see `Verdict`
    tier : see `Tier`
    cost_computed : F of the estimate as given
    cost_upper : the same with all rounding of its evaluation added, which large weights raise
    lower_bound : no estimate of this graph has a smaller F; 0 when nothing more was proven
    gap : ``cost_upper - lower_bound``, rounded up
    rtol, atol : CERTIFIED means gap <= rtol * cost_upper + atol * scale, of which the latter is no
        more than 0.001 * cost_upper; or `is_exact_fit`
    scale : W, the problem's scale
    rounding : the cost of an estimate at hand whose residuals are all rounding, if there is one:
        the optimum is zero but for rounding; else 0
    stationarity : largest ratio of a node's gradient to its weight at the given estimate, radians
    max_residual_angle : largest angle between R_i R_ij and R_j, radians
    multipliers : (n, d, d) blocks Lam_i of the point that gave the lower bound; None without one
    shift : eta with S + eta I >= 0 on the rotations, part of the bound; 0 without one
    refined : the end of local descent from the estimate; without refinement, the estimate with its
        best translations
    refined_cost : F of ``refined``
    basin_is_global : whether ``refined`` is itself within the tolerance of the lower bound
    better : a lower-cost estimate from another initialization, or None; if REFUTED, descent from
        the estimate does not reach it, or was given up far from it
    better_cost : F of ``better``
    bounds : bounds that need no factorization, at ``refined``; None if they failed, or were not
        asked for
    engine : factorization engine
    objective : the cost that the certificate is about: F, or that of another program, see
        `certpgo.objective.choose_cost`; then F stands for that cost everywhere here
    descended : whether ``refined`` comes from local descent
    settled : whether that ended; else it was stopped, or given up as the optimum was known
    support : under the cost of another program, what the lower bound rests on; else None
    obstacle : what keeps the gap open
    broken : whether the estimate moves nodes that are held; its cost then contains the terms of
        these constraints, see `certpgo.graph.held`
    rejected : of how many measurements the cost is truncated, each at its price, if they are
        rejected; the optimum is then also over all choices of which to take back
    regions : what the bound says of where optima are, see `distance`; None if it says nothing

    Examples
    --------
    >>> from certpgo import Quadratic, certify
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> certificate = certify(Quadratic(instance.graph), instance.truth)
    >>> certificate.lower_bound <= certificate.cost_upper
    True
    >>> certificate.gap <= certificate.tolerance
    True
    >>> print(f"{certificate.max_residual_angle:.3f}")  # theta / n at every edge, radians
    0.050
    >>> print(certificate)
    CERTIFIED. Proven: at most ... above the optimum
    cost              0.029993...  (chordal cost F)
    lower bound       0.029993...  (no estimate of this graph costs less)
    ...
    next              nothing: keep the estimate
    """

    verdict: Verdict
    tier: Tier
    cost_computed: float
    cost_upper: float
    lower_bound: float
    gap: float
    rtol: float
    atol: float
    scale: float
    rounding: float
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
    objective: str = CHORDAL
    descended: bool = True
    settled: bool = True
    support: Support | None = None
    obstacle: Obstacle = NOTHING
    rejected: int = 0
    broken: bool = False
    regions: Regions | None = None

    def __repr__(self) -> str:
        cost = f"{cost_shown(self.cost_upper)}, gap {gap_shown(self.gap)}"
        return f"<Certificate: {self.verdict}, {self.objective} = {cost}>"

    def as_data(self) -> dict[str, Any]:
        """The fields without arrays, and what follows from them, for JSON."""
        names = [field.name for field in fields(self) if field.name not in _ARRAYS]
        shown = {name: getattr(self, name) for name in names}
        more = {"relative_gap": self.relative_gap, "tolerance": self.tolerance}
        more["is_exact_fit"] = self.is_exact_fit
        return {**shown, **more, "limited_by": self.limited_by, "reason": self.reason}

    def to_json(self, indent: int | None = 2) -> str:
        """Its numbers and words as a JSON object, without arrays; infinite numbers are null.

        Parameters
        ----------
        indent : of the lines; None for a single one
        """
        return json.dumps(plain(self.as_data()), indent=indent, allow_nan=False)

    def _picture(self) -> str:
        return self.best._picture()

    @property
    def limited_by(self) -> LimitedBy:
        """What keeps the gap open."""
        return self.obstacle.kind

    @property
    def distance(self) -> ProvenDistance | None:
        """How far the estimate can be from every optimum, in metres and degrees.

        Computed when it is first asked for. It is seen from the pose whose measurements weigh most,
        see `distance_from`; None if nothing can be proven, as at the screening tier, and for maps
        without any known scale.

        Examples
        --------
        >>> from certpgo import Quadratic, certify
        >>> from certpgo.io.datasets.synthetic import winding_cycle
        >>> instance, _ = winding_cycle(6, 0.3, 0)
        >>> certificate = certify(Quadratic(instance.graph), instance.truth)
        >>> bool(certificate.distance.degrees.max() < 0.001)
        True
        """
        return self.distance_from(None)

    def distance_from(self, reference: int | None) -> ProvenDistance | None:
        """The same seen from another pose.

        Raises
        ------
        InputError
            There is no such pose, or its scale is unknown.
        """
        return None if self.regions is None else self.regions.distance(reference)

    def stated_distance(self, reference: int | None = None) -> ProvenDistance | None:
        """The same where the verdict says something: None if it is UNDECIDED."""
        return None if self.verdict is Verdict.UNDECIDED else self.distance_from(reference)

    def far(self, named: Callable[[int], str] = "node {}".format) -> Iterator[tuple[str, str]]:
        """The distance in words, where it is known or takes no time."""
        known = self.regions
        if known is not None and (known.bound.inverses or known.form.n <= SMALL):
            distance = self.stated_distance()
            yield from () if distance is None else distance.in_words(named)

    def region(
        self, node: int, reference: int | None = None, *, excess: float = 0.0
    ) -> Region | None:
        """Where a node is, seen from a pose, in every estimate of low cost; see `Region`.

        None if nothing can be proven, as for `distance`, or if no estimate costs as little.

        Parameters
        ----------
        reference : by default that of `distance`
        excess : over the cost of the estimate, of which all are inside, in units of the cost

        Raises
        ------
        InputError
            There is no such node or pose, or it is the node itself, or its scale is unknown; or the
            excess is not finite.
        """
        if self.regions is None:
            return None
        return self.regions.region(node, reference, excess)

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
    def is_optimal(self) -> bool:
        """Whether the estimate is proven optimal, up to the tolerance: CERTIFIED."""
        return self.verdict is Verdict.CERTIFIED

    @property
    def is_exact_fit(self) -> bool:
        """Whether it is CERTIFIED as its cost is rounding, and no bound comes near it."""
        return self.is_optimal and self.gap > self._allowed(self.cost_upper)

    def proves_optimal(self, cost: float) -> bool:
        """Whether the best estimate, of this cost, is proven optimal, up to the tolerance."""
        return self.tier is not Tier.SCREEN and cost - self.lower_bound <= self._tolerance_at(cost)

    @property
    def tolerance(self) -> float:
        """The gap up to which this estimate counts as optimal."""
        return self._tolerance_at(self.cost_upper)

    @property
    def is_near(self) -> bool:
        """Whether the proof tier may close a gap that rounding leaves.

        Also that of a CERTIFIED estimate, if only its part of W makes it so.
        """
        if self.is_exact_fit:
            return False
        least = allowed(self.cost_upper, self.rtol, FLOOR * self.atol * self.scale)
        return least < self.gap <= PROOF_GAIN * (least if self.is_optimal else self.tolerance)

    def _tolerance_at(self, cost: float) -> float:
        return max(self._allowed(cost), self.rounding)

    def _allowed(self, cost: float) -> float:
        return allowed(cost, self.rtol, self.atol * self.scale)


def of_instance(certificate: Certificate, instance: Instance, estimate: Estimate) -> Certificate:
    """The certificate of an estimate, which knows whether that moves nodes that are held."""
    return replace(certificate, broken=bool(displaced(instance, estimate)))
