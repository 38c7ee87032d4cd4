"""Where descents end, with the bound that belongs there."""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.certify.dual import DualBound
from certpgo.graph import Estimate


@dataclass(frozen=True)
class Climbed:
    """How far the relaxation of measured distances was minimised.

    Attributes
    ----------
    solved : whether its minimum is known
    rank : of the last point
    """

    solved: bool
    rank: int


@dataclass(frozen=True)
class LocalMinimum:
    """The end of a descent, whether it converged, and the bound by its multipliers.

    Without descent, it is the estimate with its best translations. With distances, the bound is
    that of a relaxation above this space.
    """

    point: Estimate
    cost: float
    settled: bool
    bound: DualBound | None
    descended: bool = True
    climbed: Climbed | None = None

    def is_at(self, estimate: Estimate) -> bool:
        """Whether the point is this very estimate, in the same memory."""
        point = self.point
        return estimate.rotations is point.rotations and estimate.translations is point.translations

    @property
    def value(self) -> float:
        """A lower bound on F*, which is never negative."""
        return max(self.bound.value, 0.0) if self.bound else 0.0
