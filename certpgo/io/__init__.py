"""Reading and writing graphs and estimates; all conversion of conventions is here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from certpgo._lazy import attributes

if TYPE_CHECKING:
    from certpgo.io.estimates import read_estimate, read_truth
    from certpgo.io.reading import read
    from certpgo.io.writing import write

__all__ = ["read", "read_estimate", "read_truth", "write"]

# Finding a file needs no numerics.
_HOMES = {
    "read": "reading",
    "read_estimate": "estimates",
    "read_truth": "estimates",
    "write": "writing",
}
__getattr__ = attributes(__name__, _HOMES)
