"""Objects that print as words: a line, a screen, and in notebooks a table with a picture."""

from __future__ import annotations

import dataclasses
import textwrap
from abc import abstractmethod
from collections.abc import Iterable
from typing import Any

import numpy as np

from certpgo.graph.phrases import aligned

#: Width of a screen, characters.
WIDTH = 80
_CELL = "white-space:normal;text-align:left;vertical-align:top;background:none"


class Text(str):
    """A string that shows itself as it is printed, also at a prompt."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class Brief:
    """A dataclass, made with ``repr=False``, whose arrays are shown by their shape."""

    def __repr__(self) -> str:
        values: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)  # type: ignore[arg-type]
            if field.repr
        }
        shown = (f"{name}={_brief(value)}" for name, value in values.items())
        return f"{type(self).__name__}({', '.join(shown)})"


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, tuple | list) and len(value) > 3:
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)


class Speaking:
    """What it is in a line, facts in a screen, and perhaps a picture; dataclasses need repr=False.

    Subclasses write ``_headline`` and ``_facts``, and ``_picture`` if there is one.
    """

    @property
    @abstractmethod
    def _headline(self) -> str:
        """What it is, in a line."""

    @abstractmethod
    def _facts(self) -> Iterable[tuple[str, str]]:
        """Names and values."""

    def _picture(self) -> str:
        """An SVG element; or empty."""
        return ""

    def __repr__(self) -> str:
        return f"<{self._headline}>"

    def __str__(self) -> str:
        head = textwrap.fill(self._headline, WIDTH, break_long_words=False)
        return "\n".join([head, *aligned(self._facts(), WIDTH)])

    def _repr_html_(self) -> str:
        from html import escape

        rows = "".join(
            f'<tr><th style="{_CELL};white-space:nowrap">{escape(name)}</th>'
            f'<td style="{_CELL}">{escape(value)}</td></tr>'
            for name, value in self._facts()
        )
        said = f"<strong>{escape(self._headline)}</strong><table>{rows}</table>"
        return (
            '<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:flex-start">'
            f'<div style="max-width:36em">{said}</div>{self._picture()}</div>'
        )
