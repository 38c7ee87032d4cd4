"""Where tasks run: on threads of this machine, or on a cluster of Dask."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

from certpgo.errors import InputError, MissingDependency
from certpgo.linalg import compiled
from certpgo.linalg.compiled import COMPILED
from certpgo.linalg.distributed.tasks import Key, TaskGraph
from certpgo.linalg.multifrontal import one_thread

#: The name of the scheduler that runs tasks on threads.
THREADS = "threads"
#: How long a scheduler may take to respond.
PATIENCE = "10s"


class Scheduler(Protocol):
    """Runs tasks."""

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls."""
        ...

    def keep(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """What stands for the results in other graphs; they stay where they were computed."""
        ...


class Threads:
    """The threads of this process."""

    def __init__(self, workers: int | None = None) -> None:
        self._workers = workers or os.cpu_count()

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls."""
        from dask import threaded

        run: Any = threaded.get
        with one_thread:  # of BLAS, for each of Python
            return list(run(graph.calls, list(keys), num_workers=self._workers))

    keep = compute


class Cluster:
    """Workers of a cluster. What a lost worker had is computed again by the others."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls."""
        with _large_graphs():
            return list(self._client.get(graph.calls, list(keys)))

    def keep(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """Futures of the results, which stay with the workers."""
        import distributed

        wait: Any = distributed.wait
        with _large_graphs():
            futures = list(self._client.get(graph.calls, list(keys), sync=False))
        with self._client.as_current():
            wait(futures)
        for future in futures:
            if future.status == "error":
                future.result()
        return futures


@contextmanager
def _large_graphs() -> Iterator[None]:
    """The entries of a matrix travel with the tasks, so that nothing is lost with a worker."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        yield


_current: ContextVar[Scheduler | None] = ContextVar("scheduler", default=None)


def current() -> Scheduler | None:
    """The scheduler in use, if any."""
    return _current.get()


@contextmanager
def scheduler(address: str) -> Iterator[None]:
    """Run large factorizations as tasks.

    Parameters
    ----------
    address : of a Dask scheduler, such as ``tcp://host:8786``, or ``threads`` for those
        of this machine

    Raises
    ------
    InputError
        No scheduler answers at that address.
    MissingDependency
        Dask is not installed, or certpgo was installed without a C compiler.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import helix
    >>> with certpgo.scheduler("threads"):
    ...     answer = certpgo.solve(helix(3, np.random.default_rng(0)).graph)
    >>> print(answer.verdict.value)
    CERTIFIED
    """
    with _opened(address) as found:
        token = _current.set(found)
        try:
            yield
        finally:
            _current.reset(token)


@contextmanager
def _opened(address: str) -> Iterator[Scheduler]:
    if address == THREADS:
        _require_dask()
        yield Threads()
        return
    with dask_client(address) as client:
        yield Cluster(client)


def dask_client(address: str) -> Any:
    """A client of the scheduler at an address such as ``tcp://host:8786``.

    Raises
    ------
    InputError
        None responds there.
    MissingDependency
        Dask is not installed.
    """
    _require_dask()
    import distributed

    connect: Any = distributed.Client
    try:
        return connect(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError):
        raise InputError(f"{address}: no Dask scheduler responds there") from None


def _require_dask() -> None:
    if not compiled.AVAILABLE:
        raise MissingDependency("the compiled engine", package=COMPILED)
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise MissingDependency("Dask", "cluster") from None
