"""Settings that iterative methods share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from certpgo.errors import SpecError


@dataclass(frozen=True)
class Iterative:
    """Settings of a method that descends on poses or on rotations until it has converged.

    Attributes
    ----------
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway
    """

    tolerance: float
    max_iterations: int

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.tolerance >= 0.0 or self.max_iterations < 1:
            raise SpecError("tolerance must not be negative and max_iterations at least 1")
