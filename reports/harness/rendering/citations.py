"""The papers' BibTeX entries, by the word that the names of their tables and figures begin with."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from certpgo import registry

#: The file of entries, in the checkout.
SOURCES = "reports/published/sources.bib"


def citation(name: str) -> str:
    """The entry of the paper that a table or figure is of, or empty."""
    root = registry.checkout()
    return "" if root is None else entries(root / SOURCES).get(name.partition("_")[0], "")


@cache
def entries(path: Path) -> dict[str, str]:
    """The entries of a file by their keys; none where there is no file."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    found = (entry.strip() for entry in re.split(r"^(?=@)", text, flags=re.MULTILINE))
    return {key[1]: entry for entry in found if (key := re.match(r"@\w+\{([^,\s]+),", entry))}
