"""A method from its name and settings, with errors that name the setting."""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from certpgo import registry
from certpgo.errors import SpecError, UnusableFile
from certpgo.solution import Solver


def build(name: str, settings: Mapping[str, Any]) -> Solver:
    """The method called ``name`` with these settings.

    Raises
    ------
    SpecError
        The method or a setting is unknown, or a setting has neither value nor default.
    InputError
        A setting's value is not allowed; said by the method.
    """
    solver = registry.get_solver(name)
    known = setting_fields(solver)
    for key in settings:
        if key not in known:
            raise SpecError.unknown(f"setting of {name}", key, known)
    for key in known.keys() - defaults(solver).keys() - settings.keys():
        said = f"{name}'s setting {key} has no default: --set {key}=VALUE gives it one"
        raise UnusableFile(inspect.getfile(solver), said)
    return solver(**settings)


def setting_fields(solver: type[Solver]) -> dict[str, Field[Any]]:
    """The settings of a method by name."""
    return {f.name: f for f in fields(solver) if f.init}  # type: ignore[arg-type]


def defaults(solver: type[Solver]) -> dict[str, Any]:
    """Settings with their default values, those without one left out."""
    found = {}
    for name, field in setting_fields(solver).items():
        if field.default is not MISSING:
            found[name] = field.default
        elif field.default_factory is not MISSING:
            found[name] = field.default_factory()
    return found


def parse_settings(name: str, assignments: Iterable[str]) -> dict[str, Any]:
    """Settings of a method from texts ``key=value``, each converted to its field's type.

    Raises
    ------
    SpecError
        The setting is unknown, there is no ``=``, or the value is of another type.
    """
    solver = registry.get_solver(name)
    try:
        hints = get_type_hints(solver)
    except NameError as error:
        raise UnusableFile(inspect.getfile(solver), error) from error
    parsed: dict[str, Any] = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        if not equals:
            raise SpecError(f"a setting is given as key=value, not {text!r}")
        if key not in setting_fields(solver):
            raise SpecError.unknown(f"setting of {name}", key, setting_fields(solver))
        parsed[key] = _converted(f"{name}: {key}", value, hints[key])
    return parsed


def _converted(what: str, text: str, wanted: Any) -> Any:
    origin = get_origin(wanted)
    if origin is Literal:
        if text not in get_args(wanted):
            raise SpecError.unknown(f"value of {what}", text, map(str, get_args(wanted)))
        return text
    if origin in (Union, types.UnionType):
        if text.lower() == "none" and type(None) in get_args(wanted):
            return None
        [wanted] = [kind for kind in get_args(wanted) if kind is not type(None)][:1]
        return _converted(what, text, wanted)
    if wanted is bool:
        if text.lower() not in ("true", "false"):
            raise SpecError(f"{what} is true or false, not {text!r}")
        return text.lower() == "true"
    if wanted in (int, float):
        try:
            return wanted(text)
        except ValueError:
            kind = "an integer" if wanted is int else "a number"
            raise SpecError(f"{what} is {kind}, not {text!r}") from None
    return text
