"""Every value that a paper's table prints, and whether ours reproduces it.

One rule for each statistic of ours:

- A single number is compared to the printed digits.
- A mean over the seeds, where the paper prints a mean: it reproduces what rounds to the same digits
  or lies within two of its standard errors, if these are at most half of it.
- A median over the seeds, where the paper prints one number and does not say of how many draws: it
  reproduces what rounds to the same digits. What does not, and lies between our lowest draw and our
  highest, is among our draws: it may be of a single draw like ours, and that is all that is known.

Times are not counted: machines and years differ, and only the claimed order can be checked, see
`reports.harness.experiments.claims`. Nor are the columns that say what a row is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import fmean, median, stdev

from reports.harness.experiments.metrics import metric_of
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Cause, Method, Row, Table
from reports.harness.rendering.published import Printed, published

#: A printed number is reproduced within this many standard errors of our mean over the seeds.
ERRORS = 2.0
#: If that error is at most this part of it: a mean that rare draws decide agrees with anything.
SHARPEST = 0.5


class CellStatus(StrEnum):
    """The outcome of a printed number, the best first."""

    REPRODUCED = "reproduced"
    AMONG = "among our draws"
    BETTER = "better"
    EXPLAINED = "differs, explained"
    UNEXPLAINED = "differs, unexplained"
    NOT_RUN = "not run"

    @property
    def differs(self) -> bool:
        """Whether ours is another number, and not a better one."""
        return self in (CellStatus.EXPLAINED, CellStatus.UNEXPLAINED)


@dataclass(frozen=True)
class Cell:
    """A printed value.

    Attributes
    ----------
    key, column : its line and column in the published file
    printed : as the paper prints it
    found : the outcome
    row, method, metric : ours that come nearest, or empty
    ours : our number, or None
    standard_error : of our mean over the seeds, or None
    draws : the lowest and highest, where ours is their median, or None
    draws_in_all : how many there are
    reason : why it differs or was not run, or what was tried where that is not known
    of_other : it is of a program that the paper compares its own methods with
    """

    key: str
    column: str
    printed: str
    found: CellStatus
    row: str = ""
    method: str = ""
    metric: str = ""
    ours: float | None = None
    standard_error: float | None = None
    draws: tuple[float, float] | None = None
    draws_in_all: int = 0
    reason: str = ""
    of_other: bool = False


def value_columns(table: Table) -> tuple[str, ...]:
    """The published columns that hold values: those of some method's metric that is no time."""
    columns = (
        column
        for method in table.methods
        for key, column in method.published.items()
        if not metric_of(key).is_time
    )
    return tuple(dict.fromkeys(columns))


def cells(table: Table, records: Iterable[Record]) -> tuple[Cell, ...]:
    """Every value that the paper's table prints, whether or not it is among our rows.

    Where several of our rows or methods correspond to one, that of the best outcome counts, and of
    equal outcomes the nearest.
    """
    return tuple(_cells(table, list(records)))


def _cells(table: Table, records: Sequence[Record]) -> Iterator[Cell]:
    if not table.published:
        return
    places: dict[tuple[str, str], list[tuple[Row, Method, str]]] = {}
    for row in table.rows + table.stand_ins:
        for method in filter(row.runs, table.methods):
            for metric, column in method.published.items():
                if row.published:
                    key = "/".join(filter(None, (row.published, method.printed)))
                    places.setdefault((key, column), []).append((row, method, metric))
    for key, line in published(table.published, table.key).items():
        for column in value_columns(table):
            printed = line.get(column)
            if not printed:
                continue
            blank = Cell(
                key,
                column,
                printed,
                CellStatus.NOT_RUN,
                reason=_said_of_line(table, key),
                of_other=not {column, *key.split("/")}.isdisjoint(table.others),
            )
            ours = places.get((key, column), ())
            found = [judged(table, blank, *place, records) for place in ours]
            nearest = min(found, key=_distance, default=blank)
            yield replace(nearest, reason=_of_all(nearest, found))


def _distance(cell: Cell) -> tuple[int, float]:
    away = math.inf if cell.ours is None else abs(cell.ours - Printed.of(cell.printed).number)
    return list(CellStatus).index(cell.found), away


def _of_all(cell: Cell, readings: Sequence[Cell]) -> str:
    """The cell's reason, with how many draws of all readings there are where none reaches it."""
    draws = [reading.draws_in_all for reading in readings if reading.draws_in_all]
    if cell.found in (CellStatus.REPRODUCED, CellStatus.AMONG) or not cell.draws_in_all:
        return cell.reason
    which = "" if len(draws) == 1 else f" of {len(draws)} readings"
    return "; ".join(filter(None, (f"none of {sum(draws)} draws{which} reaches it", cell.reason)))


def judged(
    table: Table, blank: Cell, row: Row, method: Method, metric: str, records: Iterable[Record]
) -> Cell:
    """The outcome of a printed value, by the records of the method on the row."""
    mine = [r for r in records if (r.row, r.method) == (row.label, method.label)]
    values = [value for r in mine if (value := r.metrics.get(metric)) is not None]
    said, cause = explanation(table, row.label, method.label)
    cell = replace(blank, row=row.label, method=method.label, metric=metric)
    if not values:
        failed = next((r.error for r in mine if r.absence), "")
        return replace(cell, reason=failed or (said if mine else "") or "no record")
    of_draws = table.summary == "median" and len(values) > 1
    ours = median(values) if of_draws else fmean(values)
    cell = replace(
        cell,
        ours=ours,
        standard_error=None if of_draws else _standard_error(values),
        draws=(min(values), max(values)) if of_draws else None,
        draws_in_all=len(values) if of_draws else 0,
        reason="",
    )
    if not (table.comparable and row.comparable):
        return replace(cell, reason=said or "of another instance")
    printed = Printed.of(blank.printed)
    if printed.agrees(ours) or _is_near_mean(cell, printed.number):
        return replace(cell, found=CellStatus.REPRODUCED)
    if cell.draws is not None and printed.is_within(*cell.draws):
        lower = sum(value < printed.number for value in values)
        reason = f"{lower} of {len(values)} draws are lower"
        return replace(cell, found=CellStatus.AMONG, reason=reason)
    better = {column.key: column.better for column in table.columns}.get(metric, "")
    if printed.is_worse_than(ours, better):
        return replace(cell, found=CellStatus.BETTER, reason=said)
    found = CellStatus.UNEXPLAINED if cause is None else CellStatus.EXPLAINED
    return replace(cell, found=found, reason=said)


def _is_near_mean(cell: Cell, printed: float) -> bool:
    error = cell.standard_error
    if cell.ours is None or error is None or error > SHARPEST * abs(printed):
        return False
    return abs(cell.ours - printed) <= ERRORS * error


def _standard_error(values: Sequence[float]) -> float | None:
    count = len(values)
    return float(stdev(values) / count**0.5) if count > 1 else None


def explanation(table: Table, row: str, method: str) -> tuple[str, Cause | None]:
    """What the table says of the method on that row, of the row, or of the method.

    The second is the cause, where one was checked.
    """
    for key in (f"{row}/{method}", row, method):
        if (cause := table.explained.get(key)) is not None:
            return f"{cause.text} (shown in {cause.shown})", cause
        if said := table.remarks.get(key, ""):
            return said, None
    return "", None


def _said_of_line(table: Table, key: str) -> str:
    """What the table says of a line that none of its rows corresponds to."""
    said = (table.remarks.get(part, "") for part in (key, *key.split("/")))
    return next(filter(None, said), "not among our rows")


def tally(found: Iterable[Cell]) -> dict[CellStatus, int]:
    """How many cells have each outcome."""
    counts = dict.fromkeys(CellStatus, 0)
    for cell in found:
        counts[cell.found] += 1
    return counts
