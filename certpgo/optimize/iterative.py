"""Settings of methods, and the checks that all of them share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, wraps
from numbers import Integral, Real
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from certpgo.errors import InputError, SpecError, kind_of
from certpgo.objective.quadratic import NO_SCALES


@dataclass(frozen=True)
class Settings:
    """Settings of a method, checked at construction.

    Numbers and nested settings must be of their type, a setting whose type is a Literal must be one
    of its values, ``tol`` must lie between 0 and 1, and ``seed`` must not be negative.
    """

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True
    takes_initial: ClassVar[bool] = True
    compiled: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if (solve := cls.__dict__.get("solve")) is not None:
            setattr(cls, "solve", _of_problems(solve))  # noqa: B010 - not in every class

    def __post_init__(self) -> None:
        refuse_mistyped(self)
        for name, hint in _types_of(_kind(self)).items():
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
        if not 0.0 <= self.tolerance < math.inf or self.max_iterations < 1:
            raise SpecError(
                "tolerance must not be negative or infinite, and max_iterations at least 1"
            )


def _of_problems(solve: Callable[..., Any]) -> Callable[..., Any]:
    """The method, refusing what is no problem, such as a graph."""

    @wraps(solve)
    def checked(self: Any, problem: Any, **options: Any) -> Any:
        if not hasattr(problem, "edge_costs"):
            raise InputError(f"a Quadratic(graph) expected, not {kind_of(problem)}")
        if problem.takes_scales:
            raise InputError(NO_SCALES)
        return solve(self, problem, **options)

    return checked


def refuse_mistyped(settings: Any) -> None:
    """Refuse settings whose type is a number, a truth value or nested settings if they are not.

    Raises
    ------
    SpecError
        One is not.
    """
    for name, kinds in _kinds_of(_kind(settings)).items():
        value = getattr(settings, name)
        if type(value) not in kinds and not any(_is_of(kind, value) for kind in kinds):
            wanted = " or ".join("None" if kind is type(None) else _words(kind) for kind in kinds)
            raise SpecError(f"{name} must be {wanted}, not {value!r}")


def _kind(settings: Any) -> Any:
    return type(settings)


@cache
def _kinds_of(settings: Any) -> dict[str, tuple[Any, ...]]:
    """The types that each setting may have."""
    hints = _types_of(settings)
    options = {field.name: hints[field.name] for field in fields(settings)}
    return {
        name: get_args(hint) if type(None) in get_args(hint) else (hint,)
        for name, hint in options.items()
    }


@cache
def _types_of(settings: Any) -> dict[str, Any]:
    return get_type_hints(settings)


def _is_of(kind: Any, value: Any) -> bool:
    if kind in (int, float):
        number = Integral if kind is int else Real
        return isinstance(value, number) and not isinstance(value, bool)
    if kind in (bool, type(None)) or is_dataclass(kind):
        return isinstance(value, kind)
    return True


def _words(kind: Any) -> str:
    known = {int: "an integer", float: "a number", bool: "True or False"}
    return known.get(kind) or f"of type {kind.__name__}"
