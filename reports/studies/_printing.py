"""What several studies share: their options, where results are, and a table as CSV."""

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TextIO

RESULTS = Path(__file__).parents[1] / "results"


def options(doc: str, **defaults: object) -> argparse.Namespace:
    """The options of a study's command line, each a keyword here with its default.

    A sequence is what stands without a name: values of the type of its first. False is a flag, a
    number is one of its type, a path or None a path.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in defaults.items():
        option = f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(option, action="store_true")
        elif isinstance(default, list | tuple):
            parser.add_argument(name, nargs="*", type=type(default[0]), default=default)
        else:
            kind = type(default) if isinstance(default, int | float) else Path
            parser.add_argument(option, type=kind, default=default)
    return parser.parse_args()


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
