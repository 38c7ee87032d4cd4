"""Where tasks run: on threads of this machine, or on a cluster of Dask."""

from __future__ import annotations

import os
import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol

from certpgo import linalg
from certpgo.errors import CertPGOError, InputError, MissingDependency
from certpgo.linalg import compiled
from certpgo.linalg.compiled import COMPILED
from certpgo.linalg.distributed.tasks import Key, TaskGraph
from certpgo.linalg.distributed.tiles import NotDefinite
from certpgo.linalg.multifrontal import one_thread

#: The name of the scheduler that runs tasks on threads.
THREADS = "threads"
#: Seconds that a scheduler may take to respond, or be without workers.
PATIENCE = 10.0
#: Seconds between looks at the workers.
POLL = 1.0
#: Of schedulers.
ADDRESS = re.compile(r"((tcp|ws)://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+):\d{1,5}")


class Scheduler(Protocol):
    """Runs tasks.

    Attributes
    ----------
    factorizations : how many it has run
    """

    factorizations: int

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls."""
        ...

    def keep(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """What stands for the results in other graphs; they stay where they were computed."""
        ...


class Threads:
    """The threads of this process."""

    def __init__(self, workers: int | None = None) -> None:
        self._workers, self.factorizations = workers or os.cpu_count(), 0

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
        self._client, self.factorizations = client, 0

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls."""
        with _failures():
            return list(self._client.gather(self._done(graph, keys)))

    def keep(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """Futures of the results, which stay with the workers."""
        with _failures():
            return self._done(graph, keys)

    def _done(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        import distributed

        wait: Any = distributed.wait
        with _large_graphs():
            futures = list(self._client.get(graph.calls, list(keys), sync=False))
        alone = 0.0  # seconds without workers
        with self._client.as_current():
            while alone < PATIENCE:
                try:
                    wait(futures, timeout=POLL)
                except TimeoutError:
                    workers = self._client.scheduler_info(n_workers=-1)["workers"]
                    alone = 0.0 if workers else alone + POLL
                else:
                    break
            else:
                raise CertPGOError("the cluster has lost all its workers")
        for future in futures:
            if future.status != "finished":
                future.result()
        return futures


@contextmanager
def _failures() -> Iterator[None]:
    """What goes wrong on a cluster, in one line."""
    try:
        yield
    except (NotDefinite, MemoryError, CertPGOError):
        raise
    except Exception as error:
        raise CertPGOError(
            f"the cluster failed ({type(error).__name__}: {str(error)[:200]}); its workers' logs "
            "say more"
        ) from error


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
        No scheduler with workers of the same versions answers at that address.
    MissingDependency
        Dask is not installed, or certpgo was installed without a C compiler.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
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
        _require_workers(client, address)
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
    if not ADDRESS.fullmatch(address):
        raise InputError(f"{address!r}: a Dask scheduler's address is expected, tcp://host:port")
    return _connected(address)


def _require_workers(client: Any, address: str) -> None:
    """Refuse a scheduler without workers, or with workers of other versions, by an InputError."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
        found = client.run(versions)
    except TimeoutError:
        raise InputError(f"{address}: the scheduler there has no workers") from None
    except Exception as error:
        raise InputError(f"{address}: a worker there cannot run certpgo: {error}") from None
    own = versions()
    for worker, theirs in found.items():
        for name, version in own.items():
            if theirs.get(name) != version:
                has = f"worker {worker} has {name} {theirs.get(name)}"
                raise InputError(f"{address}: {has}, this process {version}")


def _connected(address: str) -> Any:
    import distributed

    connect: Any = distributed.Client
    found: list[Any] = []

    def attempt() -> None:
        with suppress(OSError, ValueError):
            found.append(connect(address, timeout=PATIENCE, set_as_default=False))

    # What listens there may be something else, and say nothing.
    attempts = threading.Thread(target=attempt, daemon=True)
    attempts.start()
    attempts.join(2.0 * PATIENCE)
    if not found:
        raise InputError(f"{address}: no Dask scheduler responds there")
    return found[0]


def versions() -> dict[str, str]:
    """Versions that a worker and its client share, as bounds on rounding depend on them."""
    home = Path(linalg.__file__).parent
    code = sha256()
    for path in sorted(home.rglob("*.py")):
        code.update(path.read_bytes())
    found = {name: metadata.version(name) for name in ("numpy", "scipy")}
    return {**found, "certpgo.linalg": code.hexdigest()[:12]}


def _require_dask() -> None:
    if not compiled.AVAILABLE:
        raise MissingDependency("the compiled engine", package=COMPILED)
    if os.environ.get("CERTPGO_ENGINE") == "superlu":
        raise InputError("SuperLU's factorizations cannot be tasks: unset CERTPGO_ENGINE")
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise MissingDependency("Dask", "cluster") from None
