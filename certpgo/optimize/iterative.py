"""Settings of methods, and the checks that all of them share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args, get_origin, get_type_hints

from certpgo.errors import SpecError


@dataclass(frozen=True)
class Settings:
    """Settings of a method, checked at construction.

    A setting whose type is a Literal must be one of its values, ``tol`` must lie between 0 and 1,
    and ``seed`` must not be negative.
    """

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True
    takes_initial: ClassVar[bool] = True
    compiled: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self)).items():
            if get_origin(hint) is Literal and getattr(self, name) not in get_args(hint):
                raise SpecError.unknown(name, getattr(self, name), get_args(hint))
        tol, seed = getattr(self, "tol", None), getattr(self, "seed", None)
        if tol is not None and not 0.0 < tol < 1.0:
            raise SpecError(f"tol must lie between 0 and 1, not {tol}")
        if seed is not None and seed < 0:
            raise SpecError(f"seed must not be negative: {seed}")


@dataclass(frozen=True)
class Iterative(Settings):
    """Settings of an iterative method.

    Attributes
    ----------
    tolerance : stationarity at which to stop, radians
    max_iterations : stop anyway
    """

    tolerance: float
    max_iterations: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.tolerance >= 0.0 or self.max_iterations < 1:
            raise SpecError("tolerance must not be negative and max_iterations at least 1")
