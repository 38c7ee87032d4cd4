"""Comma-separated values: one row per method and section, numbers in full precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from reports.harness.experiments.averages import LOWER, UPPER, summarized
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import FIELDS, Table
from reports.harness.rendering.formats import Form
from reports.harness.rendering.published import printed_number
from reports.harness.rendering.render import grouped, work

#: What a row is of, before the table's own columns.
LEADING = ("row", "part", "seed", "instances", "d", "n", "m", "method")


def csv_text(table: Table, records: Sequence[Record]) -> str:
    """The table as CSV, with the quartiles of a summary, and each printed number next to ours."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, _header(table), restval="", lineterminator="\n")
    writer.writeheader()
    for group in grouped(table, records):
        instances = len({record.seed for record in group})
        shown = summarized(group, table.summary) if table.summary else group
        for record in shown:
            writer.writerow(_line(table, record, instances))
    return stream.getvalue()


def _header(table: Table) -> list[str]:
    keys = []
    for column in table.columns:
        keys.append(column.key)
        if table.summary == "median" and column.key in table.metrics:
            keys += [column.key + LOWER, column.key + UPPER]
    printed = {f"{metric}.printed": None for m in table.methods for metric in m.published}
    return [*LEADING, *keys, *printed, "error"]


def _line(table: Table, record: Record, instances: int) -> dict[str, object]:
    line: dict[str, object] = {name: getattr(record, name, None) for name in LEADING}
    line |= {"instances": instances, "error": record.why_missing}
    if table.summary:
        line["seed"] = None
    for column in table.columns:
        if column.key in FIELDS:
            line[column.key] = _field(record, column.key)
        else:
            for key in (column.key, column.key + LOWER, column.key + UPPER):
                if key in record.metrics:
                    line[key] = record.metrics[key]
    line |= dict(_printed(table, record))
    return {key: "" if value is None else value for key, value in line.items()}


def _field(record: Record, key: str) -> object:
    if key == "seconds":
        return sum(record.seconds.values()) if record.seconds else None
    return work(record) if key == "counts" else getattr(record, key)


def _printed(table: Table, record: Record) -> Iterator[tuple[str, str]]:
    rows = [row for row in table.rows + table.stand_ins if row.label == record.row]
    methods = [method for method in table.methods if method.label == record.method]
    for row in rows:
        for method in methods:
            for metric in method.published:
                yield f"{metric}.printed", printed_number(table, row, method, metric) or ""


FORM = Form("csv", "CSV", csv_text)
