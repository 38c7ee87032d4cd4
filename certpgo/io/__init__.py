"""Reading and writing graphs and estimates; all conversion of conventions is here."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from certpgo.io.estimates import read_estimate, read_truth
    from certpgo.io.reading import read
    from certpgo.io.writing import write

__all__ = ["read", "read_estimate", "read_truth", "write"]

#: Where each name is; it is imported on first use: finding a file needs no numerics.
_HOME = {
    "read": "reading",
    "read_estimate": "estimates",
    "read_truth": "estimates",
    "write": "writing",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
