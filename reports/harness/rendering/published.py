"""The papers' numbers, and whether ours agree with them to the digits they print."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import cache
from pathlib import Path

from certpgo import registry
from certpgo.errors import FormatError, InputError, SpecError
from reports.harness.experiments.metrics import Better
from reports.harness.experiments.spec import Method, Row, Table


@dataclass(frozen=True)
class PrintedComparison:
    """A number of ours compared with a printed one.

    Attributes
    ----------
    printed : as the paper prints it
    agrees : whether ours rounds to the printed digits
    is_better : whether it does not and is better
    """

    printed: str
    agrees: bool
    is_better: bool = False

    def __str__(self) -> str:
        found = "agrees" if self.agrees else "differs, better" if self.is_better else "differs"
        return f"{self.printed} {found}"


def compared(printed: str, ours: float, better: Better = "") -> PrintedComparison:
    """Compare to the printed digits: within half a unit of the last one (and rounding's worth).

    Parameters
    ----------
    better : which numbers are better than the printed one, if any

    Raises
    ------
    InputError
        The text is no number.
    """
    try:
        number = Decimal(printed)
        exponent = int(number.as_tuple().exponent)
    except (InvalidOperation, ValueError):
        raise InputError(f"{printed!r} is no printed number") from None
    difference = ours - float(number)
    agrees = abs(difference) <= 0.5 * 10.0**exponent * (1.0 + 1e-9)
    sign = {"": 0.0, "lower": -1.0, "higher": 1.0}[better]
    return PrintedComparison(printed, agrees, not agrees and sign * difference > 0.0)


def printed_number(table: Table, row: Row, method: Method, metric: str) -> str | None:
    """What the paper prints for this metric, or None where it prints nothing."""
    if not (table.published and row.published and metric in method.published):
        return None
    key = f"{row.published}/{method.printed}" if method.printed else row.published
    line = published(table.published, table.key).get(key, {})
    return line.get(method.published[metric]) or None


@cache
def published(name: str, key: str) -> dict[str, dict[str, str]]:
    """The lines of a file of published numbers, by their key, see `Table`.

    Raises
    ------
    SpecError
        There is no such file, or no such column.
    """
    folder = registry.repository() / "reports" / "published"
    path = folder / f"{name}.csv"
    if not path.is_file():
        raise SpecError.unknown("published table", name, (p.stem for p in folder.glob("*.csv")))
    return _lines(path, key)


def _lines(path: Path, key: str) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        reader = csv.DictReader(stream)
        columns = key.split(",")
        for column in columns:
            if column not in (reader.fieldnames or ()):
                raise FormatError(path, 1, f"a column called {column}")
        return {"/".join(line[column] for column in columns): line for line in reader}
