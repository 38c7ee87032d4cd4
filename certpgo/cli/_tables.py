"""Running a table from the command line: progress, files, and what is printed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from certpgo.cli._show import document, notice, table, working

if TYPE_CHECKING:
    from certpgo.harness.records import Record
    from certpgo.harness.spec import Table

INTERRUPTED = 130


def run_table(
    spec: Table,
    out: Path,
    *,
    data: Path | None,
    seeds: int | None = None,
    quick: bool = False,
    json: bool = False,
) -> int:
    """Run a table; print it, and write its records and Markdown into ``out``."""
    from certpgo.harness.records import new_file, to_line
    from certpgo.harness.runner import chosen_rows, run

    chosen_rows(spec, data=data, quick=quick)  # that there are any is said before files are opened
    records: list[Record] = []
    code = 0
    with working(spec.title) as status, new_file(out / f"{spec.name}.jsonl") as stream:
        try:
            for record in run(spec, data=data, seeds=seeds, quick=quick, announce=status.update):
                records.append(record)
                stream.write(to_line(record) + "\n")
                stream.flush()
        except KeyboardInterrupt:
            code = INTERRUPTED
    _report(spec, records, out, json)
    if code == INTERRUPTED:
        notice(f"interrupted; {len(records)} results are kept")
    return code


def _report(spec: Table, records: list[Record], out: Path, json: bool) -> None:
    from certpgo.harness.records import as_data, new_file
    from certpgo.harness.render import markdown, sections

    with new_file(out / f"{spec.name}.md") as stream:
        stream.write(markdown(spec, records))
    if json:
        data: list[dict[str, Any]] = [as_data(record) for record in records]
        document(data)
        return
    typer.echo(spec.title)
    for section in sections(spec, records):
        typer.echo()
        table(section.title, section.header, section.rows, section.caption)
    for sentence in spec.notes:
        typer.echo(sentence)
    notice(f"written to {out / spec.name}.jsonl and {spec.name}.md beside it")
