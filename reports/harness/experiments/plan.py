"""What is left to run: independent tasks, for what has no record yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from certpgo.errors import InputError
from reports.harness.experiments import scan
from reports.harness.experiments.absence import Absence, Missing, missing
from reports.harness.experiments.figure import Data, Figure, computed, figure_key, read_figure
from reports.harness.experiments.instances import is_here
from reports.harness.experiments.keys import Profile
from reports.harness.experiments.limits import NO_LIMIT, Limit
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import Announce, run_trial, suits
from reports.harness.experiments.spec import Row, Table
from reports.harness.experiments.timing import single_threaded
from reports.harness.experiments.trials import Trial, trials_of

#: The records of a key in the file of a table.
Find = Callable[[str], Sequence[Record]]


@dataclass(frozen=True)
class TableTask:
    """Methods on one row and repetition of a table.

    Attributes
    ----------
    trial : the row; its table holds only what a run needs
    methods : labels of the methods that have no record yet
    data : folder to look for files in first
    limit : on the time of each method
    """

    trial: Trial
    methods: tuple[str, ...]
    data: Path | None = None
    limit: Limit = NO_LIMIT

    @property
    def report(self) -> str:
        """The table's name."""
        return self.trial.table.name

    @property
    def label(self) -> str:
        """What it is called while it runs."""
        seed = f", seed {self.trial.repetition}" if self.trial.row.generator else ""
        return f"{self.report}: {self.trial.row.label}{seed}"

    @property
    def timed(self) -> bool:
        """Whether its numbers are times, so that nothing else may run."""
        return self.trial.table.reference is not None

    @property
    def steps(self) -> int:
        """How many methods are run."""
        return len(self.methods)

    def records(self, announce: Announce) -> Iterator[Record]:
        """Run it, with thread pools at one thread; records as they are made."""
        with ExitStack() as stack:
            single_threaded(stack)
            for record in run_trial(
                self.trial,
                data=self.data,
                methods=self.methods,
                limit=self.limit,
                announce=announce,
            ):
                yield replace(record, provenance={**record.provenance, "threads": "1"})

    def died(self, why: Missing) -> tuple[Record, ...]:
        """The records of methods whose process died."""
        methods = (m for m in self.trial.table.methods if m.label in self.methods)
        return tuple(replace(self.trial.blank(m), **why._asdict()) for m in methods)


@dataclass(frozen=True)
class FigureTask:
    """A figure, given by its name.

    Attributes
    ----------
    report : the figure's name
    timed : whether it shows times
    """

    report: str
    profile: Profile
    timed: bool = False
    data: Path | None = None

    steps = 1

    @property
    def label(self) -> str:
        """What it is called while it runs."""
        return self.report

    def drawn(self) -> Data | Missing:
        """The figure's record, or why there is none."""
        figure: Figure = scan.get_figure(self.report)
        try:
            with ExitStack() as stack:
                single_threaded(stack)
                return computed(figure, quick=self.profile == "quick", data=self.data)
        except Exception as error:  # the other figures are drawn whatever this one raises
            return missing(error)


Task = TableTask | FigureTask


def run_task(task: Task) -> list[Record] | Data | Missing:
    """Run a task to its end: a table's records, or a figure's record or why there is none."""
    return task.drawn() if isinstance(task, FigureTask) else list(task.records(lambda _: None))


def table_tasks(
    table: Table,
    find: Find,
    *,
    quick: bool = False,
    seeds: int | None = None,
    data: Path | None = None,
    limit: Limit = NO_LIMIT,
) -> tuple[TableTask, ...]:
    """The tasks of a table, one for each row and repetition that lacks a record.

    Parameters
    ----------
    find : the existing records of a key; none to recompute everything
    quick, seeds, data : see `reports.harness.experiments.runner.run_table`
    limit : on the time of each method

    Raises
    ------
    InputError
        Rows are optional, and the files of none of them are here.
    """
    tasks = []
    for trial in trials_of(table, data=data, seeds=seeds, quick=quick):
        methods = _lacking(trial, find, data)
        if methods:
            tasks.append(TableTask(_lean(trial), methods, data, limit))
    return tuple(tasks)


def figure_tasks(
    figure: Figure, folder: Path, *, quick: bool, again: bool = False, data: Path | None = None
) -> tuple[FigureTask, ...]:
    """The task of a figure, or none where the folder has the drawing of this version."""
    profile: Profile = "quick" if quick else "full"
    kept = read_figure(figure, folder)
    if not again and kept is not None and kept.get("key") == figure_key(figure, profile):
        return ()
    return (FigureTask(figure.name, profile, figure.timed, data),)


def keys(
    table: Table, *, quick: bool = False, seeds: int | None = None, data: Path | None = None
) -> Iterator[str]:
    """The keys of all records of the table, row by row and method by method."""
    for trial in trials_of(table, data=data, seeds=seeds, quick=quick):
        yield from (trial.key(method) for method in table.methods if trial.row.runs(method))


def _lacking(trial: Trial, find: Find, data: Path | None) -> tuple[str, ...]:
    found = [(m, find(trial.key(m))) for m in trial.table.methods if trial.row.runs(m)]
    # Once one record says what the graph measures, methods for other graphs are known to have none.
    kinds = {record.kind for _, records in found for record in records} - {""}
    return tuple(
        method.label
        for method, records in found
        if not _is_final(trial, records, data)
        and (not kinds or any(suits(trial.row, method, kind) for kind in kinds))
    )


def _is_final(trial: Trial, records: Sequence[Record], data: Path | None) -> bool:
    """Whether all components have a record that another run would not improve.

    A graph that was not read or a package that was not installed may be available by now, and
    trying costs nothing.
    """
    if not records or len(records) < records[-1].parts:
        return False
    if any(record.absence is Absence.MISSING_PACKAGE for record in records):
        return False
    unread = [r for r in records if r.n is None and r.absence is not Absence.PROCESS_DIED]
    return not unread or bool(trial.row.absent) or not _is_here(trial.row, data)


def _is_here(row: Row, data: Path | None) -> bool:
    try:
        return is_here(row, data)
    except InputError:
        return False  # neither a file nor a dataset's name


def _lean(trial: Trial) -> Trial:
    """The trial with only what a run needs of its table."""
    table = trial.table
    lean = Table(
        table.name,
        table.title,
        (trial.row,),
        tuple(method for method in table.methods if trial.row.runs(method)),
        table.columns,
        certify=table.certify,
        reference=table.reference,
        seed=table.seed,
    )
    return replace(trial, table=lean)


def in_order(keys: Iterable[str], find: Find) -> list[Record]:
    """The records of the keys, in their order."""
    return [record for key in keys for record in find(key)]
