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
class Printed:
    """A number as a paper prints it.

    Attributes
    ----------
    text : the digits
    number : their value
    half_unit : half a unit of the last digit, and rounding's worth
    """

    text: str
    number: float
    half_unit: float

    @classmethod
    def of(cls, text: str) -> Printed:
        """Read it.

        Raises
        ------
        InputError
            The text is no number.
        """
        try:
            number = Decimal(text)
            exponent = int(number.as_tuple().exponent)
        except (InvalidOperation, ValueError):
            raise InputError(f"{text!r} is no printed number") from None
        return cls(text, float(number), 0.5 * 10.0**exponent * (1.0 + 1e-9))

    def agrees(self, ours: float) -> bool:
        """Whether a number of ours rounds to the printed digits."""
        return abs(ours - self.number) <= self.half_unit

    def is_within(self, lowest: float, highest: float) -> bool:
        """Whether numbers from lowest to highest, as rounded, include the printed one."""
        return lowest - self.half_unit <= self.number <= highest + self.half_unit

    def is_worse_than(self, ours: float, better: Better) -> bool:
        """Whether ours is better, where lower or higher numbers are."""
        sign = {"": 0.0, "lower": -1.0, "higher": 1.0}[better]
        return sign * (ours - self.number) > 0.0


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
