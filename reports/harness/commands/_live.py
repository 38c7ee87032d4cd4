"""How far a run is, on stderr: a live view on a terminal, one line per finished row elsewhere."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

    from reports.harness.experiments.absence import Absence
    from reports.harness.experiments.execute import TaskResult


class Runnable(Protocol):
    """What is run, whatever it is."""

    @property
    def label(self) -> str:
        """What it is called while it runs."""
        ...

    @property
    def steps(self) -> int:
        """How much it is of the whole."""
        ...


class RunView:
    """Counts what is done, running and failed, and shows nothing.

    Parameters
    ----------
    tasks : all that will run
    """

    def __init__(self, tasks: Sequence[Runnable]) -> None:
        self.total = sum(task.steps for task in tasks)
        self.done = 0
        self._began: dict[str, float] = {}
        self._results: Counter[str] = Counter()
        self._failures: Counter[str] = Counter()
        self._left_out: Counter[str] = Counter()

    @property
    def failed(self) -> int:
        """How many results are failures."""
        return self._failures.total()

    def announce(self, message: str) -> None:
        """Say what runs."""

    def starting(self, task: Runnable) -> None:
        """Count a task that was handed out."""
        self._began[task.label] = time.perf_counter()
        self.refresh()

    def show(self, outcome: TaskResult) -> None:
        """Count what a task returned."""
        from reports.harness.experiments.absence import Missing

        absences = [record.absence for record in outcome.records if record.absence]
        if isinstance(outcome.figure, Missing):
            absences.append(outcome.figure.absence)
        self.count(outcome.task, len(outcome.records), absences, is_last=outcome.is_last)

    def count(
        self, task: Runnable, results: int, absences: Sequence[Absence], *, is_last: bool = True
    ) -> None:
        """Count results of a task, and why others are not there."""
        label = task.label
        failures = sum(absence.is_failure for absence in absences)
        self._failures[label] += failures
        self._left_out[label] += len(absences) - failures
        self._results[label] += results
        if is_last:
            self.done += task.steps
            began = self._began.pop(label)
            self.finished(label, time.perf_counter() - began)
        self.refresh()

    def finished(self, label: str, seconds: float) -> None:
        """Say that a task is done."""

    def refresh(self) -> None:
        """Update the numbers."""


class LineView(RunView):
    """One line per finished task."""

    def finished(self, label: str, seconds: float) -> None:
        """Say that a task is done."""
        counts = {"failed": self._failures[label], "not run": self._left_out[label]}
        said = "".join(f", {count} {what}" for what, count in counts.items() if count)
        typer.echo(f"{self.done} of {self.total}: {label}{said} ({seconds:.1f} s)", err=True)


class BarView(RunView):
    """A bar with what is planned, done, running and failed, and the time left."""

    def __init__(self, tasks: Sequence[Runnable], progress: Progress) -> None:
        super().__init__(tasks)
        self._progress = progress
        self._bar = progress.add_task("", total=self.total, running="", failed=0)

    def announce(self, message: str) -> None:
        """Say what runs."""
        self._progress.update(self._bar, running=message)

    def refresh(self) -> None:
        """Update the numbers."""
        running = list(self._began)
        first = f"{len(running)} running: {running[0]}" if running else ""
        part = sum(self._results[label] for label in running)
        done = min(self.done + part, self.total)
        self._progress.update(self._bar, completed=done, running=first, failed=self.failed)


@contextmanager
def watching(tasks: Sequence[Runnable], *, lines: bool) -> Iterator[RunView]:
    """The view of a run of these tasks.

    Parameters
    ----------
    lines : where stderr is no terminal, print one line per finished task
    """
    if not tasks or not sys.stderr.isatty():
        yield LineView(tasks) if lines else RunView(tasks)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[failed]} failed"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[running]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield BarView(tasks, progress)
