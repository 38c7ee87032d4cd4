"""A table's printed values and claims as text, for below the table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from certpgo.graph.phrases import counted
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments import claim_outcomes
from reports.harness.experiments.claim_outcomes import ClaimOutcome
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table
from reports.harness.rendering import cells
from reports.harness.rendering.cells import Cell

#: Titles of the columns of `differing`.
DIFFERING = ("row", "method", "metric", "printed", "ours", "found", "why they differ")


def findings(table: Table, records: Sequence[Record]) -> list[str]:
    """Lines of Markdown: the outcomes of the printed values and of the claims."""
    lines: list[str] = []
    if printed := cells.cells(table, records):
        lines += ["## Printed values", "", in_words(printed), ""]
        if rows := differing(printed):
            lines += [*markdown_table(DIFFERING, rows), ""]
        lines += not_run(printed)
    if found := claim_outcomes.of_table(table, records):
        lines += ["## Claims", "", *claims_table(found)]
    return lines


def in_words(found: Sequence[Cell]) -> str:
    """How many values are printed, and their outcomes."""
    counts = cells.tally(found)
    return (
        f"Of {counted(len(found), 'printed value{s}')} {counts[cells.CellStatus.REPRODUCED]} "
        f"reproduced, {counts[cells.CellStatus.BETTER]} better, {counts[cells.CellStatus.DIFFERS]} "
        f"different, {counts[cells.CellStatus.NOT_RUN]} not run."
    )


def differing(found: Iterable[Cell]) -> tuple[tuple[str, ...], ...]:
    """The lines of a table of the values that differ or are better, see `DIFFERING`."""
    return tuple(
        (c.row, c.method, c.metric, c.printed, our_number(c), c.found.value, _why(c))
        for c in found
        if c.found in (cells.CellStatus.DIFFERS, cells.CellStatus.BETTER)
    )


def not_run(found: Iterable[Cell]) -> list[str]:
    """The reasons why values were not run, and of how many."""
    reasons = Counter(cell.reason for cell in found if cell.found is cells.CellStatus.NOT_RUN)
    rows = [(reason, str(count)) for reason, count in reasons.items()]
    return [*markdown_table(("not run, because", "values"), rows), ""] if rows else []


def claims_table(found: Iterable[ClaimOutcome]) -> list[str]:
    """Claims, where they are made, and their outcomes."""
    rows = [(outcome.claim.text, outcome.claim.source, outcome.in_full) for outcome in found]
    return [*markdown_table(("claim", "where", "found"), rows), ""]


def _why(cell: Cell) -> str:
    return cell.reason or ("not explained" if cell.found is cells.CellStatus.DIFFERS else "")


def our_number(cell: Cell) -> str:
    """Our number, with its standard error over the seeds."""
    if cell.ours is None:
        return ""
    error = cell.standard_error
    return f"{cell.ours:.7g}" + ("" if error is None else f" (standard error {error:.1g})")
