"""Running a table from the command line: progress, files, and what is printed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from certpgo.cli._show import document, notice, table, working
from certpgo.cli._verdict import INTERRUPTED
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.harness.records import Journal, Record
    from certpgo.harness.spec import Table


def run_table(
    spec: Table,
    out: Path,
    *,
    data: Path | None,
    seeds: int | None = None,
    quick: bool = False,
    json: bool = False,
    named: bool = False,
) -> int:
    """Run a table; print it, and write its records and Markdown into ``out``.

    Parameters
    ----------
    named : the rows were asked for by name, so that one that cannot be read is an error
    """
    from certpgo.harness.records import Journal
    from certpgo.harness.runner import chosen_rows, run

    chosen_rows(spec, data=data, quick=quick)  # that there are any is said before files are opened
    journal = Journal(out, spec.name)
    records: list[Record] = []
    interrupted = False
    with working(spec.title) as status:
        try:
            for record in run(spec, data=data, seeds=seeds, quick=quick, announce=status.update):
                records.append(record)
                journal.add(record)
        except KeyboardInterrupt:
            interrupted = True
    failed = [record for record in records if named and record.n is None]
    unread = tuple(dict.fromkeys(record.error for record in failed))
    if len(failed) == len(records):
        journal.discard()
        if interrupted:
            raise KeyboardInterrupt
        raise InputError("; ".join(unread) or "nothing to run")
    _publish(spec, records, journal, interrupted, json)
    for reason in unread:
        notice(f"not read: {reason}")
    if interrupted:
        return INTERRUPTED
    return 1 if unread else 0


def _publish(
    spec: Table, records: list[Record], journal: Journal, interrupted: bool, json: bool
) -> None:
    from certpgo.harness.records import as_data
    from certpgo.harness.render import markdown, sections
    from certpgo.io.wording import counted

    path = journal.publish(markdown(spec, records, interrupted=interrupted), partial=interrupted)
    if json:
        document([as_data(record) for record in records])
    else:
        typer.echo(spec.title)
        for section in sections(spec, records):
            typer.echo()
            table(section.title, section.header, section.rows, section.caption)
        for sentence in spec.notes:
            typer.echo(sentence)
    if interrupted:
        notice(
            f"interrupted with {counted(len(records), 'result{s}')}; earlier files are as before"
        )
    if interrupted or not json:
        notice(f"written to {path} and {path.stem}.md beside it")
