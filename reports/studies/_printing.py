"""What several studies share: a table as CSV."""

import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TextIO


def print_table(table: Sequence[Mapping[str, object]], out: Path | None) -> None:
    """Print rows of the same columns, and write them to a file, too."""
    _write(table, sys.stdout)
    if out is not None:
        with out.open("w", newline="") as file:
            _write(table, file)


def _write(table: Sequence[Mapping[str, object]], file: TextIO) -> None:
    writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
