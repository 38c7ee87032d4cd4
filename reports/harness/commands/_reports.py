"""A table or figure to reproduce: its files, its tasks, and what is printed of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from certpgo.cli._show import table

if TYPE_CHECKING:
    from reports.harness.experiments.execute import TaskResult
    from reports.harness.experiments.figure import Figure
    from reports.harness.experiments.journal import Journal
    from reports.harness.experiments.keys import Profile
    from reports.harness.experiments.plan import FigureTask, TableTask
    from reports.harness.experiments.records import Record
    from reports.harness.experiments.spec import Table


@dataclass(frozen=True)
class Order:
    """What to reproduce, and how.

    Attributes
    ----------
    out : folder for the results
    data : folder to look for files in first
    seeds : instances that a synthetic row represents, by default the table's
    quick : the small profile
    again : recompute existing results
    seconds : limit on the time of a method on an instance; None for none
    named : the rows were given by name: one that cannot be read is an error, and only what is
        computed now is shown
    """

    out: Path
    data: Path | None = None
    seeds: int | None = None
    quick: bool = False
    again: bool = False
    seconds: float | None = None
    named: bool = False

    @property
    def profile(self) -> Profile:
        """What records call the profile."""
        return "quick" if self.quick else "full"


class TableReport:
    """A table's file of records, and what is rendered from it.

    Attributes
    ----------
    tasks : what is left to run
    companion : suffix of the file that is written with the records
    """

    companion = "md"

    def __init__(self, spec: Table, order: Order) -> None:
        from reports.harness.experiments.journal import Journal
        from reports.harness.experiments.limits import Limit
        from reports.harness.experiments.plan import keys, table_tasks
        from reports.harness.experiments.records import Record

        self.spec, self._order = spec, order
        # A table without rows is refused before files are opened.
        self._keys = tuple(keys(spec, quick=order.quick, seeds=order.seeds, data=order.data))
        self._journal: Journal[Record] = Journal(order.out, spec.name, Record)
        self._fresh: dict[str, list[Record]] = {}
        self._unread: list[Record] = []
        self.tasks: tuple[TableTask, ...] = table_tasks(
            spec,
            (lambda key: ()) if order.again else self._journal.find,
            quick=order.quick,
            seeds=order.seeds,
            data=order.data,
            limit=Limit(order.seconds),
        )

    def keep(self, outcome: TaskResult) -> None:
        """Keep records; those of named graphs that were not read, only if there are others."""
        for record in outcome.records:
            self._fresh.setdefault(record.key, []).append(record)
            if self._order.named and record.n is None:
                self._unread.append(record)
            else:
                self._journal.add(record)

    @property
    def records(self) -> list[Record]:
        """The existing records, in the order of the table."""
        from reports.harness.experiments.plan import in_order

        found = self._fresh.get if self._order.named else self._journal.find
        return in_order(self._keys, lambda key: found(key) or ())

    @property
    def unread(self) -> tuple[str, ...]:
        """Why graphs given by name were not read."""
        return tuple(dict.fromkeys(record.why_missing for record in self._unread))

    @property
    def is_any(self) -> bool:
        """Whether there is any record of a graph that was read."""
        return len(self.records) > len(self._unread)

    def close(self, *, interrupted: bool) -> Path:
        """Render the existing records; returns the path of the records."""
        from certpgo.io.writing import write_whole
        from reports.harness.rendering.render import table_markdown

        if self.is_any:
            for record in self._unread:
                self._journal.add(record)
            text = table_markdown(self.spec, self.records, interrupted=interrupted)
            write_whole(self._journal.path.with_suffix(".md"), text.encode())
        self._journal.close()
        return self._journal.path

    def data(self) -> list[dict[str, Any]]:
        """The records as plain data."""
        from reports.harness.experiments.journal import as_data

        return [as_data(record) for record in self.records]

    def show(self) -> None:
        """Print it."""
        from certpgo.graph.phrases import counted
        from reports.harness.rendering.render import notes, sections

        records = self.records
        typer.echo(self.spec.title)
        shown = sections(self.spec, records)
        for section in shown:
            rows = [[in_brief(cell) for cell in row] for row in section.rows]
            typer.echo()
            table(section.title, section.header, rows, section.caption)
        parts = [p for section in shown for row in section.rows for c in row for p in compared(c)]
        if parts:
            agree = sum(part.endswith(AGREES) for part in parts)
            typer.echo(f"{agree} of {counted(len(parts), 'printed number{s}')} agree.")
        for sentence in notes(self.spec, records):
            typer.echo(sentence)

    def line(self) -> str:
        """A summary in one line."""
        from certpgo.graph.phrases import counted

        records = self.records
        failed = sum(bool(record.absence) for record in records)
        said = f", {failed} failed or not run" if failed else ""
        return f"{self.spec.name}: {counted(len(records), 'result{s}')}{said}"


#: How a number ends that agrees with a printed one.
AGREES = " agrees"


def compared(cell: str) -> list[str]:
    """What a cell says of numbers that were compared with printed ones."""
    from reports.harness.rendering.render import COMPARED

    ends = tuple(filter(None, COMPARED.values()))
    return [part for part in cell.split("; ") if part.endswith(ends)]


def in_brief(cell: str) -> str:
    """A cell for a screen: of several numbers that agree, how many they are."""
    parts = compared(cell)
    agree = [part for part in parts if part.endswith(AGREES)]
    if len(agree) < 2:
        return cell
    others = [part for part in cell.split("; ") if part not in agree]
    return "; ".join([f"{len(agree)} of {len(parts)} agree", *others])


class FigureReport:
    """A figure's files.

    Attributes
    ----------
    tasks : what is left to run
    companion : suffix of the file that is written with the drawing
    failure : why there is no figure, or empty
    """

    companion = "json"

    def __init__(self, spec: Figure, order: Order) -> None:
        from reports.harness.experiments.plan import figure_tasks

        self.spec, self._order = spec, order
        self.tasks: tuple[FigureTask, ...] = figure_tasks(
            spec, order.out, quick=order.quick, again=order.again, data=order.data
        )
        self.failure = ""

    @property
    def unread(self) -> tuple[str, ...]:
        """Why it could not be drawn."""
        return (self.failure,) if self.failure else ()

    def keep(self, outcome: TaskResult) -> None:
        """Write its files, or remember why there are none."""
        from reports.harness.experiments.absence import Missing
        from reports.harness.experiments.figure import publish

        if isinstance(outcome.figure, Missing):
            self.failure = str(outcome.figure)
        elif outcome.figure is not None:
            publish(self.spec, outcome.figure, self._order.out, profile=self._order.profile)

    @property
    def is_any(self) -> bool:
        """Whether it is drawn."""
        return self.data() is not None

    def close(self, *, interrupted: bool) -> Path:
        """The path of the drawing."""
        return self._order.out / f"{self.spec.name}.svg"

    def data(self) -> dict[str, Any] | None:
        """The document of its file."""
        from reports.harness.experiments.figure import read_figure

        return read_figure(self.spec, self._order.out)

    def show(self) -> None:
        """Print its caption."""
        if (kept := self.data()) is not None:
            for sentence in (kept["title"], kept["caption"], *kept["notes"]):
                typer.echo(sentence)

    def line(self) -> str:
        """A summary in one line."""
        return f"{self.spec.name}: {self.failure or ('drawn' if self.data() else 'not drawn')}"


Report = TableReport | FigureReport
