"""A problem with weights of order one, and when its gaps are closed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from certpgo.certify.bridge_blocks import Part, parts
from certpgo.certify.certificate import Tier, tier_called
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.stiff_edges import eased
from certpgo.certify.tolerances import FLOOR, allowed
from certpgo.certify.units import unit_of
from certpgo.errors import GraphError, InputError, kind_of, refuse, require_numbers
from certpgo.graph import Estimate
from certpgo.objective.exact_fit import fits_exactly
from certpgo.objective.objective import Objective
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import Stop

if TYPE_CHECKING:
    from certpgo import checker

AnyObjective = TypeVar("AnyObjective", bound=Objective)


@dataclass(frozen=True)
class NormalizedProblem(Generic[AnyObjective]):
    """A problem with weights of order one, and the settings of its certificates.

    Attributes
    ----------
    problem : the problem with its weights divided by ``unit``
    unit : the power of two nearest W; it makes verdicts independent of the weights' scale
    stop : the monitor of all descents; where it requests a stop, bounds are left out
    ranks : above d that points reach for better bounds; None for what suits the problem
    real : whether relaxations are over real numbers alone, of which proofs are
    softened : how often stiff measurements were left out
    """

    problem: AnyObjective
    unit: float
    tier: Tier
    rtol: float
    atol: float
    stop: Stop = field(default_factory=Stop)
    ranks: int | None = None
    real: bool = False
    softened: int = 0

    @classmethod
    def of(
        cls,
        problem: Any,
        tier: Tier | str,
        rtol: float,
        atol: float,
        monitor: Monitor = silent,
    ) -> NormalizedProblem[Any]:
        """Normalize a problem.

        Raises
        ------
        InputError
            It is no problem; tolerances that are negative or not finite, weights beyond the range
            of doubles, information that is not positive definite, or the proof tier for a cost that
            has none.
        SpecError
            An unknown tier.
        """
        if not isinstance(problem, Objective):
            said = "a Quadratic(graph) is judged, not"
            raise InputError(f"{said} {kind_of(problem)}")
        tier = tier_called(tier)
        require_numbers(rtol=rtol, atol=atol)
        refuse(problem.unbounded)
        if tier is Tier.PROOF:
            refuse(problem.unprovable)
        unit = unit_of(problem)
        try:
            scaled = problem.scaled(1.0 / unit)
        except GraphError as error:
            raise InputError(f"too uneven weights: divided by {unit:.2g}, {error}") from None
        stop, real = Stop(monitor, unit, problem.title), tier is Tier.PROOF
        return cls(scaled, unit, tier, rtol, atol, stop, real=real)  # type: ignore[arg-type]

    @property
    def rigorous(self) -> bool:
        """Whether rounding is bounded."""
        return self.tier is not Tier.SCREEN

    def tolerance(self, cost: float) -> float:
        """The gap up to which a point of this cost counts as optimal."""
        absolute, cap = self.atol * self.problem.scale, float(self.problem.cap)
        return min(allowed(cost, self.rtol, absolute), cap)

    def difference(self, cost: float) -> float:
        """The smallest decrease in cost that is not rounding."""
        absolute, cap = FLOOR * self.atol * self.problem.scale, float(self.problem.cap)
        return min(allowed(cost, self.rtol, absolute), cap)

    def fits(self, estimate: Estimate) -> bool:
        """Whether it meets all measurements: then its cost is rounding, and it is optimal."""
        return fits_exactly(self.problem, estimate)

    def is_closed(self, minimum: LocalMinimum) -> bool:
        """Whether the gap is closed."""
        cost = minimum.cost
        return cost - minimum.value <= self.tolerance(cost) or self.fits(minimum.point)

    def is_sharp(self, minimum: LocalMinimum) -> bool:
        """Whether no distinguishably better point exists."""
        cost = minimum.cost
        return cost - minimum.value <= self.difference(cost) or self.fits(minimum.point)

    def cost_upper(self, estimate: Estimate) -> float:
        """The cost of the estimate, rounded up: F in exact arithmetic at the proof tier."""
        chordal = self.problem.is_chordal and not self.problem.graph.has_couplings
        if self.tier is Tier.PROOF and chordal:
            from certpgo.certify.proof import exact_cost

            return exact_cost(self.problem.chordal, self.exact, estimate)
        return self.problem.enclosure(estimate)[1]

    def sure(self, estimate: Estimate, cost: float) -> float:
        """A smaller cost is lower than the estimate's, at most ``cost``, despite rounding."""
        return self.problem.enclosure(estimate)[0] - self.difference(cost)

    @cached_property
    def exact(self) -> checker.Graph:
        """The measurements in the checker's representation."""
        from certpgo.certify.proof import exact_graph

        return exact_graph(self.problem.chordal)

    @cached_property
    def eased(self) -> AnyObjective:
        """The problem without stiff bridges, whose cost is nowhere above this one."""
        return eased(self.problem, cycles=False)

    @cached_property
    def parts(self) -> list[Part]:
        """The parts between bridges, of F; see `certpgo.certify.bridge_blocks`."""
        problem = self.problem
        return parts(problem.chordal) if problem.is_chordal and not problem.takes_scales else []
