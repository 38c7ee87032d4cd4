"""Runs tasks: one by one here, in processes of this machine, or by any executor.

Results are returned to this process as they are made. Tasks whose numbers are times run after
the others, one at a time.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from certpgo import registry
from certpgo.solve.comparison import in_one_line
from certpgo.solve.processes import processes
from reports.harness.experiments.absence import DIED, Absence, Missing
from reports.harness.experiments.figure import Data
from reports.harness.experiments.plan import FigureTask, TableTask, Task, run_task
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import Announce


@dataclass(frozen=True)
class TaskResult:
    """What a task returned.

    Attributes
    ----------
    records : of a table's task: all, or those since its last outcome
    figure : of a figure's task: its record, or why there is none; None of a table's
    is_last : the task is done
    """

    task: Task
    records: Sequence[Record] = ()
    figure: Data | Missing | None = None
    is_last: bool = True


@dataclass(frozen=True)
class Pool:
    """Where tasks run.

    Attributes
    ----------
    workers : how many at once
    executor : what runs them: of `concurrent.futures`, or any of that kind; None for processes of
        this machine, or for this one if it is one worker. It is not shut down
    """

    workers: int = 1
    executor: Executor | None = None

    @property
    def alone(self) -> str:
        """Whether each task has a core to itself: ``"yes"``, ``"no"`` or ``"unknown"``."""
        if self.executor is not None:
            return "unknown"
        return "yes" if self.workers <= (os.cpu_count() or 1) else "no"

    def opened(self, at_once: int) -> AbstractContextManager[Executor]:
        """The executor, or new processes, within a block."""
        return processes(at_once) if self.executor is None else nullcontext(self.executor)


def execute(
    tasks: Iterable[Task], pool: Pool, *, announce: Announce, starting: Callable[[Task], None]
) -> Generator[TaskResult]:
    """Run all tasks and yield their results as they are ready.

    An interrupt or an error ends processes of ours, and begins no other task.

    Parameters
    ----------
    announce : called with what runs, where that is known
    starting : called with each task before it runs

    Raises
    ------
    BrokenExecutor
        An executor that was given takes no more tasks, as a process of it died.
    """
    timed = [task for task in tasks if task.timed]
    others = [task for task in tasks if not task.timed]
    if pool == Pool():
        for task in (*others, *timed):
            starting(task)
            yield from _here(task, announce)
        return
    for outcome in _all(others, pool, pool.workers, starting):
        yield _stating(outcome, pool.alone)
    for task in timed:
        for outcome in _all([task], pool, 1, starting):
            yield _stating(outcome, "yes" if pool.executor is None else "unknown")


def _here(task: Task, announce: Announce) -> Iterator[TaskResult]:
    if isinstance(task, FigureTask):
        yield TaskResult(task, figure=task.drawn())
        return
    for record in task.records(announce):
        yield _stating(TaskResult(task, [record], is_last=False), "yes")
    yield TaskResult(task)


def _stating(outcome: TaskResult, alone: str) -> TaskResult:
    records = [
        replace(record, provenance={**record.provenance, "alone": alone})
        for record in outcome.records
    ]
    return replace(outcome, records=records)


def _all(
    tasks: Sequence[Task], pool: Pool, at_once: int, starting: Callable[[Task], None]
) -> Iterator[TaskResult]:
    """Run tasks in workers; one whose worker died, also when it ran alone, has failed."""
    left = dict(enumerate(tasks))
    suspects: list[int] = []
    while left:
        # Any of those that ran when a process of ours died may have killed it: they run one by one.
        turn = {number: left[number] for number in suspects[:1] or left}
        begun: set[int] = set()
        try:
            with pool.opened(min(at_once, len(turn))) as executor:
                for number, future in _done(executor, turn, at_once, begun, starting):
                    yield _outcome(left[number], _result(left[number], future))
                    del left[number]
                    begun.discard(number)
        except BrokenExecutor:
            if pool.executor is not None:
                raise
            if suspects:
                task = left.pop(suspects[0])
                yield _outcome(task, _died(task, DIED))
            else:
                suspects = sorted(begun)
                continue
        suspects = suspects[1:]


def _done(
    executor: Executor,
    tasks: Mapping[int, Task],
    at_once: int,
    begun: set[int],
    starting: Callable[[Task], None],
) -> Iterator[tuple[int, Future[Any]]]:
    """The tasks as they are done; only as many as run are given to the executor."""
    queue, running = iter(tasks.items()), dict[Future[Any], int]()
    try:
        while True:
            for number, task in islice(queue, at_once - len(running)):
                begun.add(number)
                starting(task)
                call = pickle.dumps((_in_worker, task))
                running[executor.submit(registry.call_pickled, call)] = number
            if not running:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            # What broke the executor is raised after the results that are there.
            for future in sorted(done, key=lambda one: one.exception() is not None):
                yield running.pop(future), future
    finally:
        for future in running:
            future.cancel()


def _in_worker(task: Task) -> list[Record] | Data | Missing:
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    if isinstance(task, TableTask):
        task = replace(task, limit=replace(task.limit, expendable=True))
    return run_task(task)


def _result(task: Task, future: Future[Any]) -> Any:
    """What a worker returned; of one that died elsewhere, records that say so."""
    try:
        return future.result()
    except BrokenExecutor:
        raise
    except Exception as error:
        said = f"the executor has no result: {in_one_line(error)}"
        return _died(task, Missing(Absence.PROCESS_DIED, said))


def _died(task: Task, why: Missing) -> Any:
    return task.died(why) if isinstance(task, TableTask) else why


def _outcome(task: Task, result: Any) -> TaskResult:
    return (
        TaskResult(task, result) if isinstance(task, TableTask) else TaskResult(task, figure=result)
    )
