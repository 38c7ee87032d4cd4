"""Tables as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from certpgo.graph.phrases import NO_UTF8
from certpgo.io.writing import atomically

Cell = str | float | None


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Iterable[Cell]]) -> None:
    """Write rows below the names of their columns, in full precision; never half a file.

    None and infinite numbers are empty cells, True is 1. A text that a spreadsheet would compute
    gets an apostrophe, see `text_of`.

    Raises
    ------
    InputError
        The file cannot be written.
    """

    def lines(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8", errors=NO_UTF8) as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(map(_shown, row) for row in rows)

    atomically(path, lines)


def text_of(cell: str) -> str:
    """The text that `write_csv` was given for a cell."""
    return cell[1:] if cell.startswith("'") and _is_formula(cell[1:]) else cell


def _is_formula(text: str) -> bool:
    """Whether a spreadsheet would compute a cell."""
    if not text.startswith(("=", "+", "-", "@", "\t", "\r")):
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False


def _shown(cell: Cell) -> str | float:
    if isinstance(cell, str):
        return f"'{cell}" if _is_formula(cell) else cell
    if cell is None or not math.isfinite(cell):
        return ""
    return int(cell) if isinstance(cell, bool) else cell
