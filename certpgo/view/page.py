"""A page from its template: style and scripts are part of it, and nothing is fetched."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from certpgo.errors import MissingDependency
from certpgo.io.plain import plain

try:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup
except ImportError:
    raise MissingDependency("jinja2, which fills pages,", "pages") from None

#: Cells of columns that stand at the right.
NUMBER = re.compile(r"[-+]?[\d.,]+(e[-+]?\d+)?( %)?")
TEMPLATES = Path(__file__).parent / "templates"


def page(template: str, **context: Any) -> str:
    """The page of a template in ``templates``; every text of the context is escaped."""
    return _environment().get_template(template).render(**context) + "\n"


def data_uri(text: str, kind: str) -> str:
    """A link that holds the text itself.

    Parameters
    ----------
    kind : its media type, such as ``"text/csv"``
    """
    encoded = base64.b64encode(text.encode()).decode()
    return f"data:{kind};charset=utf-8;base64,{encoded}"


def embedded(data: Any) -> Markup:
    """Data as JSON that cannot end the script element it stands in."""
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def numeric(rows: Sequence[Sequence[str]]) -> list[bool]:
    """Which columns hold numbers alone, or nothing."""
    columns = zip(*rows, strict=True)
    return [all(not cell or NUMBER.fullmatch(cell) for cell in column) for column in columns]


def source(name: str) -> Markup:
    """One of our own files, as it is."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8"))


@cache
def _environment() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["embedded"] = embedded
    made.globals["numeric"] = numeric
    made.globals["source"] = source
    return made
