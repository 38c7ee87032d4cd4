"""Values of options as Typer converts them, without Pydantic, which it imports for that.

The import takes as long as NumPy's. What is not plainly right is left to Typer, which says why.
"""

from __future__ import annotations

import os
import re
from enum import Enum
from pathlib import Path
from typing import Any, get_args, get_origin

import typer

_INTEGER = re.compile(r"-?(0|[1-9][0-9]{0,17})")
_NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?(e-?[0-9]{1,2})?")
#: What a file may be asked to be, unless it is only named.
_ASKED = ("exists", "writable", "resolve_path", "allow_dash", "path_type")


def plainly(parameters: list[Any]) -> list[Any]:
    """Parameters of a command that take plain values without Typer's conversion."""
    for parameter in parameters:
        parameter._runtime_param = _Plain()
    return parameters


class _Plain:
    """In the place of Typer's conversion, which it fetches when it does not know a value."""

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value of a parameter from what stands on the command line, or from its default."""
        asked, info = param.type_descriptor.annotation, param.type_descriptor.parameter_info
        listed = param.multiple or param.nargs == -1
        if value is None:
            return () if listed else None
        if listed and get_origin(asked) is list and isinstance(value, list | tuple):
            found = [_plain(one, get_args(asked)[0], info) for one in value]
        else:
            found = [] if listed else [_plain(value, asked, info)]
        if not found or None in found:
            param._runtime_param = None
            try:
                return param.get_runtime_param().coerce(value, param=param, ctx=ctx)
            except typer.BadParameter as error:
                listed_type = get_args(asked)[0] if listed else asked
                if said := _wanted(listed_type, info):
                    values = value if listed else [value]
                    wrong = next(v for v in values if _plain(v, listed_type, info) is None)
                    error.message = f"{wrong!r} is not {said}."
                raise
        return found if listed else found[0]


def _plain(value: Any, asked: Any, info: Any) -> Any:
    """The value as what is asked; None if that is not plain."""
    if info.parser is not None:
        try:
            return info.parser(value)
        except (ValueError, AssertionError):
            return None
    if not isinstance(asked, type):
        return None
    if issubclass(asked, Enum):
        named = (one for one in asked if type(value) in (asked, str) and value == one.value)
        return next(named, None) if info.case_sensitive else None
    if asked is int or asked is float:
        if isinstance(value, str) and (_INTEGER if asked is int else _NUMBER).fullmatch(value):
            value = asked(value)
        low, high = info.min, info.max
        within = (
            type(value) is asked
            and not info.clamp
            and (low is None or value >= low)
            and (high is None or value <= high)
        )
        return value if within else None
    if asked is Path and isinstance(value, str):
        return _named(value, info)
    return value if isinstance(value, asked) else None


def _wanted(asked: Any, info: Any) -> str:
    """What a value must be, in words; empty where Typer's are kept."""
    if not isinstance(asked, type) or info.parser is not None:
        return ""
    if issubclass(asked, Enum):
        return f"one of {', '.join(str(one.value) for one in asked)}"
    if asked not in (int, float):
        return ""
    kind = "a whole number" if asked is int else "a number"
    limits = [] if info.clamp else [(info.min, "at least"), (info.max, "at most")]
    said = [f"{word} {limit:g}" for limit, word in limits if limit is not None]
    return f"{kind} of {' and '.join(said)}" if said else kind


def _named(value: str, info: Any) -> Path | None:
    """A path that is not there yet, or that can be read."""
    if not value or any(getattr(info, name) for name in _ASKED):
        return None
    if not (info.file_okay and info.dir_okay):
        return None
    readable = not info.readable or os.access(value, os.R_OK)
    return Path(value) if readable or not os.path.lexists(value) else None
