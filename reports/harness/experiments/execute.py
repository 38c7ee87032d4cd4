"""Runs tasks: one by one here, or by joblib in processes of this machine or on a cluster.

Results are returned to this process as they are made. Tasks whose numbers are times run after
the others, one at a time.
"""

from __future__ import annotations

import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from certpgo import registry
from certpgo.errors import InputError, MissingDependency
from reports.harness.experiments.absence import DIED, Missing
from reports.harness.experiments.clusters import dask_client
from reports.harness.experiments.figure import Data
from reports.harness.experiments.plan import FigureTask, TableTask, Task, run_task
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import Announce

#: Schemes of a scheduler's address, and the packages that speak to it.
DASK, RAY = "tcp://", "ray://"
#: What joblib's backends raise for a worker that died: two of this machine's, Dask's, Ray's.
DEATHS = ("TerminatedWorkerError", "BrokenProcessPool", "KilledWorker", "ActorDiedError")
#: Seconds to wait for a cluster's first worker.
PATIENCE = 120


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
    jobs : how many at once; of a cluster, as many as it has threads
    scheduler : address of a running cluster's scheduler, ``tcp://`` of Dask's or ``ray://`` of
        Ray's; empty for this machine
    """

    jobs: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        if self.scheduler and not self.scheduler.startswith((DASK, RAY)):
            raise InputError(
                f"a scheduler's address begins with {DASK} (Dask) or {RAY} (Ray), "
                f"not {self.scheduler!r}"
            )

    @property
    def alone(self) -> str:
        """Whether each task has a core to itself: ``"yes"``, ``"no"`` or ``"unknown"``."""
        try:
            import joblib
        except ImportError:
            raise MissingDependency("joblib, which runs rows at once,", "reports") from None
        if self.scheduler:
            return "unknown"
        return "yes" if self.jobs <= joblib.cpu_count() else "no"


def execute(
    tasks: Iterable[Task], pool: Pool, *, announce: Announce, starting: Callable[[Task], None]
) -> Generator[TaskResult]:
    """Run all tasks and yield their results as they are ready.

    An interrupt or an error stops the workers.

    Parameters
    ----------
    announce : called with what runs, where that is known
    starting : called with each task before it runs, perhaps from another thread

    Raises
    ------
    InputError
        The scheduler does not respond.
    MissingDependency
        The package that speaks to it is not installed.
    """
    timed = [task for task in tasks if task.timed]
    others = [task for task in tasks if not task.timed]
    if pool.jobs == 1 and not pool.scheduler:
        for task in (*others, *timed):
            starting(task)
            yield from _here(task, announce)
        return
    with ExitStack() as stack:
        connect, jobs = _connection(pool, stack)
        for outcome in _all(others, connect, jobs, starting):
            yield _stating(outcome, pool.alone)
        for task in timed:
            for outcome in _all([task], connect, 1, starting):
                yield _stating(outcome, "unknown" if pool.scheduler else "yes")


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
    tasks: Sequence[Task], connect: Callable[[], Any], jobs: int, starting: Callable[[Task], None]
) -> Iterator[TaskResult]:
    """Run tasks in workers; one whose worker died, also when it ran alone, has failed."""
    left = dict(enumerate(tasks))
    suspects: list[int] = []
    while left:
        running: set[int] = set()
        # Any of those that ran when a worker died may have killed it: they run one by one.
        turn = suspects[:1] or list(left)
        dispatched = _dispatched({number: left[number] for number in turn}, running, starting)
        try:
            for number, result in _parallel(connect, jobs, dispatched):
                running.discard(number)
                yield _outcome(left.pop(number), result)
        except Exception as error:
            if not _is_death(error):
                raise
            if suspects:
                task = left.pop(suspects[0])
                yield _outcome(task, task.died() if isinstance(task, TableTask) else DIED)
            else:
                suspects = sorted(running)
                continue
        suspects = suspects[1:]


def _dispatched(
    tasks: dict[int, Task], running: set[int], starting: Callable[[Task], None]
) -> Iterator[Any]:
    from joblib import delayed

    for number, task in tasks.items():
        running.add(number)
        starting(task)
        yield delayed(registry.call_pickled)(pickle.dumps((_in_worker, number, task)))


def _parallel(connect: Callable[[], Any], jobs: int, calls: Iterator[Any]) -> Iterator[Any]:
    from joblib import Parallel
    from joblib.parallel import get_active_backend

    with connect():
        if not get_active_backend()[0].supports_return_generator:  # Ray's
            for batch in iter(lambda: list(islice(calls, jobs)), []):
                yield from Parallel(n_jobs=max(jobs, 2), batch_size=1)(batch)
            return
        # Only as many are dispatched as run, so that a death leaves few suspects.
        yield from Parallel(
            n_jobs=max(jobs, 2),  # one job would be this process
            return_as="generator_unordered",
            batch_size=1,
            pre_dispatch="n_jobs" if jobs > 1 else 1,
        )(calls)


def _in_worker(number: int, task: Task) -> tuple[int, list[Record] | Data | Missing]:
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    if isinstance(task, TableTask):
        task = replace(task, limit=replace(task.limit, expendable=True))
    return number, run_task(task)


def _outcome(task: Task, result: Any) -> TaskResult:
    return (
        TaskResult(task, result) if isinstance(task, TableTask) else TaskResult(task, figure=result)
    )


def _is_death(error: Exception) -> bool:
    return type(error).__name__ in DEATHS


def _connection(pool: Pool, stack: ExitStack) -> tuple[Callable[[], Any], int]:
    """What makes joblib's context for some tasks, and how many are run at once."""
    from joblib import parallel_config

    if not pool.scheduler:
        return lambda: parallel_config("loky", inner_max_num_threads=1), pool.jobs
    if pool.scheduler.startswith(RAY):
        cores = _connect_ray(pool.scheduler, stack)
        return lambda: parallel_config("ray"), cores
    client = stack.enter_context(dask_client(pool.scheduler))
    backend = _backend_reporting_deaths()
    waiting = {"wait_for_workers_timeout": PATIENCE}
    return lambda: parallel_config(backend(client=client, **waiting)), pool.jobs


def _backend_reporting_deaths() -> Any:
    """Joblib's backend for Dask; joblib's own waits forever for a task that killed its workers."""
    from joblib._dask import DaskDistributedBackend

    class Reporting(DaskDistributedBackend):  # type: ignore[misc]
        def effective_n_jobs(self, n_jobs: int) -> Any:
            return max(2, super().effective_n_jobs(n_jobs))  # one job would be this process

        def submit(self, func: Any, callback: Any = None) -> Any:
            future = super().submit(func, callback)
            future.add_done_callback(lambda done: done.exception() and callback(done))
            return future

        def retrieve_result_callback(self, out: Any) -> Any:
            return super().retrieve_result_callback(
                out.result() if isinstance(out, Future) else out
            )

    return Reporting


def _connect_ray(address: str, stack: ExitStack) -> int:
    """Connect joblib to a cluster; how many cores it has."""
    try:
        import ray.util.joblib
    except ImportError:
        raise MissingDependency("Ray", package="'ray[client]'") from None
    cluster: Any = ray
    try:
        cluster.init(address)
    except ValueError:
        raise MissingDependency("Ray's client", package="'ray[client]'") from None
    except (OSError, RuntimeError):
        raise InputError(f"{address}: no Ray scheduler responds there") from None
    stack.callback(cluster.shutdown)
    cluster.util.joblib.register_ray()
    cores = int(cluster.cluster_resources().get("CPU", 0))
    if cores < 2:
        raise InputError(
            f"{address}: a cluster of two cores or more is needed, this one has {cores}"
        )
    return cores
