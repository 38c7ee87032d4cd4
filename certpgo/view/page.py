"""Pages from templates, with style and scripts inlined."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from certpgo.errors import MissingDependency
from certpgo.io.json_values import plain

try:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup
except ImportError:
    raise MissingDependency("jinja2, which renders pages,", "pages") from None

#: Cells of right-aligned columns.
NUMBER = re.compile(r"[-+]?[\d.,]+(e[-+]?\d+)?( %)?")
TEMPLATES = Path(__file__).parent / "templates"


def page(template: str, **context: Any) -> str:
    """Render a template of the folder ``templates``; all text of the context is escaped."""
    return _environment().get_template(template).render(**context) + "\n"


def data_uri(text: str, kind: str) -> str:
    """A data link with the text itself; ``kind`` is its media type, such as ``"text/csv"``."""
    encoded = base64.b64encode(text.encode()).decode()
    return f"data:{kind};charset=utf-8;base64,{encoded}"


def embedded(data: Any) -> Markup:
    """Data as JSON that cannot close its script element."""
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))


def numeric(rows: Sequence[Sequence[str]]) -> list[bool]:
    """Which columns contain only numbers or nothing."""
    columns = zip(*rows, strict=True)
    return [all(not cell or NUMBER.fullmatch(cell) for cell in column) for column in columns]


def source(name: str) -> Markup:
    """A file of the folder ``templates``, unescaped."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8"))


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["embedded"] = embedded
    environment.globals["numeric"] = numeric
    environment.globals["source"] = source
    return environment
