"""Records to text: a pure function, so that a caption costs no re-run.

A section holds the records of one instance under one reading of its weights: costs under two
readings are of two objectives, and are never in one column.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from certpgo.graph.phrases import counted, reading_sentence
from certpgo.solve.comparison_table import remarks, seconds_by_phase, sizes
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments.averages import LOWER, UPPER, summarized
from reports.harness.experiments.journal import latest
from reports.harness.experiments.keys import QUICK_NOTES
from reports.harness.experiments.metrics import metric_of
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import FIELDS, Column, Method, Row, Table
from reports.harness.rendering.cells import Cell, CellStatus, judged
from reports.harness.rendering.citations import citation
from reports.harness.rendering.findings import findings
from reports.harness.rendering.published import printed_number

#: Columns of a table that are left out of a section in which they are empty.
SPARSE = ("kept_percent",)
#: What is said of a printed number, by how ours compares.
COMPARED = {
    CellStatus.REPRODUCED: " agrees",
    CellStatus.AMONG: " is among our draws",
    CellStatus.BETTER: " differs, better",
    CellStatus.EXPLAINED: " differs",
    CellStatus.UNEXPLAINED: " differs",
    CellStatus.NOT_RUN: "",
}
#: A warning about times taken while more ran than there are cores, or an unknown number.
CROWDED = (
    "Not every run had a core to itself: those times are longer than necessary and should not be "
    "compared."
)


@dataclass(frozen=True)
class Section:
    """A table of text.

    Attributes
    ----------
    title : the instance and its size
    caption : which reading of the weights was used
    header : column titles
    rows : cells, one text per column
    """

    title: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def sections(table: Table, records: Iterable[Record]) -> tuple[Section, ...]:
    """The table's sections, in the order of its rows."""
    return tuple(_section(table, group) for group in grouped(table, records))


def grouped(table: Table, records: Iterable[Record]) -> tuple[list[Record], ...]:
    """The records of each section: of one instance, or of all that a row is a summary of."""
    groups: dict[tuple[str, ...], list[Record]] = {}
    for record in arranged(table, records):
        seed = "" if table.summary else str(record.seed)
        key = (record.row, record.part, _reading(record), seed)
        groups.setdefault(key, []).append(record)
    return tuple(groups.values())


def arranged(table: Table, records: Iterable[Record]) -> list[Record]:
    """The last record of each key and part, in the order of the table's rows and methods.

    The order in which they were made is that of the processes that made them.
    """
    rows = {row.label: k for k, row in enumerate(table.rows + table.stand_ins)}
    methods = {method.label: k for k, method in enumerate(table.methods)}

    def place(record: Record) -> tuple[int, int, int]:
        row = rows.get(record.row, len(rows))
        return row, record.seed or 0, methods.get(record.method, len(methods))

    return sorted(latest(records), key=place)


def notes(table: Table, records: Iterable[Record]) -> tuple[str, ...]:
    """The sentences below the table: its own, and what they do not say of these records."""
    listed = list(records)
    own = table.notes
    if own and any(record.profile == "quick" for record in listed):
        own = (QUICK_NOTES, *own)
    said = [record.provenance.get("alone", "yes") for record in listed if record.seconds]
    if not any(column.is_time for column in table.columns) or set(said) <= {"yes"}:
        return own
    return (*own, CROWDED)


def table_markdown(table: Table, records: Sequence[Record], *, interrupted: bool = False) -> str:
    """The table as Markdown, with its provenance; it says if the run was interrupted."""
    lines = [f"# {table.title}", ""]
    if interrupted:
        lines += ["**Interrupted: the results of a run that did not end.**", ""]
    if table.source:
        lines += [f"Published numbers: {table.source}.", ""]
    for section in sections(table, records):
        lines += [f"## {section.title}", "", section.caption, ""]
        lines += [*markdown_table(section.header, section.rows), ""]
    lines += findings(table, latest(records))
    for note in notes(table, records):
        lines += [note, ""]
    if entry := citation(table.published or table.name):
        lines += ["```bibtex", entry, "```", ""]
    if records:
        origin = arranged(table, records)[0].provenance
        lines += ["; ".join(f"{key}: {origin[key]}" for key in sorted(origin)), ""]
    return "\n".join(lines)


def _section(table: Table, group: Sequence[Record]) -> Section:
    first = group[0]
    size = "" if first.n is None else f" ({sizes(first.n, first.m or 0, first.d or 0)})"
    seed = "" if first.seed is None else f", seed {first.seed}"
    if table.summary:
        count = len({record.seed for record in group})
        seed = "" if first.seed is None else f", {table.summary} of {counted(count, 'instance{s}')}"
    compared = {record.method: "; ".join(_comparisons(table, record, group)) for record in group}
    if table.summary:
        group = summarized(group, table.summary)
    lines = [_line(table, record, compared[record.method]) for record in group]
    if len({line[1:] for line in lines}) == 1 and first.absence:
        lines = [("every method", *lines[0][1:])]
    header = ("method", *(c.title for c in table.columns), "published", "not run or failed")
    # Columns about a few methods or rows are shown where they say something.
    sparse = [k for k, c in enumerate(table.columns, 1) if c.key in SPARSE]
    sparse += [len(header) - 2, len(header) - 1]
    shown = [k for k in range(len(header)) if k not in sparse or any(line[k] for line in lines)]
    return Section(
        title=f"{first.part or first.row}{size}{seed}",
        caption=" ".join(_captions(group)),
        header=tuple(header[k] for k in shown),
        rows=tuple(tuple(line[k] for k in shown) for line in lines),
    )


def _captions(group: Sequence[Record]) -> Iterable[str]:
    first = group[0]
    if first.n is None:
        yield "Not read."
    else:
        yield f"Read with {_reading(first)}."
    if first.objective:
        yield f"Costs, bounds and verdicts are those of `--cost {first.objective}`."
    if first.judging is not None:
        yield f"f_ML and s are evaluated with {reading_sentence(first.judging)}."
    yield from remarks((record.method, record.note) for record in group)


def _reading(record: Record) -> str:
    return reading_sentence(record.reading)


def _line(table: Table, record: Record, compared: str) -> tuple[str, ...]:
    """One record's cells; the last two are the printed numbers and the error, or empty."""
    texts = [cell_text(column, record) for column in table.columns]
    return (record.method, *texts, compared, record.why_missing)


def cell_text(column: Column, record: Record) -> str:
    """The text of the column for the record."""
    if column.key == "seconds":
        return seconds_by_phase(record.seconds)
    if column.key == "counts":
        return work(record)
    if column.key in FIELDS:
        value = getattr(record, column.key)
        return "" if value is None else str(value)
    number = _certified_cost(record) if column.key == "cost" else record.metrics.get(column.key)
    if number is None:
        return ""
    shown = format(number, column.format)
    lower, upper = (record.metrics.get(column.key + end) for end in (LOWER, UPPER))
    if lower is None or upper is None:
        return shown
    return f"{shown} ({format(lower, column.format)} to {format(upper, column.format)})"


def _certified_cost(record: Record) -> float | None:
    """F of what the verdict is about: of a robust method, of the measurements that it kept."""
    metrics = record.metrics
    if metrics.get("kept_percent", 100.0) == 100.0 or "gap" not in metrics:
        return metrics.get("cost")
    return metrics["lower_bound"] + metrics["gap"]


def work(record: Record) -> str:
    """The counts of what was done, in words."""
    return ", ".join(f"{name} {number:,}" for name, number in record.counts.items())


def _comparisons(table: Table, record: Record, group: Sequence[Record]) -> Iterable[str]:
    """What is printed for the record's method, and how the group's records of it compare."""
    row, method = _found(table, record)
    if row is None or method is None:
        return
    titles = {column.key: column.title for column in table.columns}
    mine = [other for other in group if other.method == record.method]
    for metric, column in method.published.items():
        printed = printed_number(table, row, method, metric)
        if printed is None:
            continue
        cell = Cell(row.published, column, printed, CellStatus.NOT_RUN)
        if not metric_of(metric).is_time:
            cell = judged(table, cell, row, method, metric, mine)
        yield f"{titles.get(metric, metric)} {printed}{COMPARED[cell.found]}"


def _found(table: Table, record: Record) -> tuple[Row | None, Method | None]:
    rows = {row.label: row for row in table.rows + table.stand_ins}
    methods = {method.label: method for method in table.methods}
    return rows.get(record.row), methods.get(record.method)
