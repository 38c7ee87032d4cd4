"""A table's printed values and claims as text, for below the table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from certpgo.graph.phrases import counted
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments import claim_outcomes
from reports.harness.experiments.claim_outcomes import ClaimOutcome
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table
from reports.harness.rendering import cells
from reports.harness.rendering.cells import Cell, CellStatus

#: Titles of the columns of `differing`.
DIFFERING = ("row", "method", "metric", "printed", "ours", "found", "why, or what was tried")


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
        f"Of {counted(len(found), 'printed value{s}')} {counts[CellStatus.REPRODUCED]} reproduced, "
        f"{among(counts)}{counts[CellStatus.BETTER]} better, {different(counts)}, "
        f"{counts[CellStatus.NOT_RUN]} not run."
    )


def among(counts: Mapping[CellStatus, int]) -> str:
    """How many lie among our draws, if any, with a comma."""
    count = counts[CellStatus.AMONG]
    return f"{count} among our draws, " if count else ""


def different(counts: Mapping[CellStatus, int]) -> str:
    """How many differ, and of how many it was checked why."""
    explained, unexplained = counts[CellStatus.EXPLAINED], counts[CellStatus.UNEXPLAINED]
    if not explained + unexplained:
        return "0 different"
    return f"{explained + unexplained} different ({explained} explained, {unexplained} unexplained)"


def differing(found: Iterable[Cell]) -> tuple[tuple[str, ...], ...]:
    """The lines of a table of the values that are run and not reproduced, see `DIFFERING`."""
    return tuple(
        (c.row, c.method, c.metric, c.printed, our_number(c), c.found.value, _why(c))
        for c in found
        if c.found not in (CellStatus.REPRODUCED, CellStatus.NOT_RUN)
    )


def not_run(found: Iterable[Cell]) -> list[str]:
    """The reasons why values were not run, and of how many."""
    reasons = Counter(cell.reason for cell in found if cell.found is CellStatus.NOT_RUN)
    rows = [(reason, str(count)) for reason, count in reasons.items()]
    return [*markdown_table(("not run, because", "values"), rows), ""] if rows else []


def claims_table(found: Iterable[ClaimOutcome]) -> list[str]:
    """Claims, where they are made, and their outcomes."""
    rows = [(outcome.claim.text, outcome.claim.source, outcome.in_full) for outcome in found]
    return [*markdown_table(("claim", "where", "found"), rows), ""]


def _why(cell: Cell) -> str:
    return cell.reason or ("nothing was tried" if cell.found is CellStatus.UNEXPLAINED else "")


def our_number(cell: Cell) -> str:
    """Our number, with its standard error over the seeds, or the range of the draws."""
    if cell.ours is None:
        return ""
    if cell.draws is not None:
        lowest, highest = cell.draws
        return f"{cell.ours:.3g} (draws {lowest:.3g} to {highest:.3g})"
    error = cell.standard_error
    return f"{cell.ours:.7g}" + ("" if error is None else f" (standard error {error:.1g})")
