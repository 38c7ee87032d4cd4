"""Many graphs or estimates, one after the other in their order, by threads or any executor.

The compiled kernel computes without Python's lock, so that threads share the work of factorizations
and of sums over edges; what is Python's own, in graphs of a hundred poses most of it, takes turns,
and is shared by processes.
"""

from __future__ import annotations

import os
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

from certpgo.certify.certificate import Certificate
from certpgo.checker import Answer
from certpgo.errors import CertPGOError, InputError, InputNotice, kind_of, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.accept_paths import AnyPath
from certpgo.io.writing import AnyAnswer
from certpgo.objective.choose_cost import Judged
from certpgo.objective.sum import Sum
from certpgo.optimize.monitor import Monitor, silent
from certpgo.solve.judging import certify
from certpgo.solve.prove_files import Attempt, attempt
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings, settings_from
from certpgo.solve.solving import solve

Item = TypeVar("Item")
Result = TypeVar("Result")
#: What is done with an item. The monitor stops it where its result is no longer wanted.
Work = Callable[[Item, Monitor], Result]

#: Items per worker that are taken before their results are asked for.
AHEAD = 2
_Posed = Graph | Instance | Sum | AnyPath
_Pair = tuple[Judged | Graph | Instance | AnyPath, Estimate | AnyAnswer | AnyPath]


def solve_many(
    graphs: Iterable[_Posed],
    settings: SolveSettings | None = None,
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    cost: str | None = None,
    **options: Any,
) -> Iterator[CertifiedSolution | CertPGOError]:
    """The answers of `certpgo.solve` for many graphs, in their order.

    Where one fails, its error stands in its place with a note that names the graph, and the others
    go on. Graphs are taken as their answers are asked for, a few ahead, so that there may be any
    number of them. Ctrl-C, or an end of the loop over the answers, leaves those that are there and
    begins no others; threads of ours stop after their current step.

    Parameters
    ----------
    graphs : each as for `certpgo.solve`
    workers : how many are in work at once; by default the number of this machine's processors
    executor : what does the work: of `concurrent.futures`, or any of that kind, such as
        ``client.get_executor()`` of Dask; by default threads. It is not shut down
    settings, cost, options : of every graph, as for `certpgo.solve`

    Raises
    ------
    InputError
        There is to be no worker, or the executor is none; or as `SolveSettings`.
    SpecError
        As `SolveSettings`.

    Examples
    --------
    A disconnected graph between two others:

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> graph = winding_cycle(6, 0.3, 0)[0].graph
    >>> for answer in certpgo.solve_many([graph, graph.with_edges([0, 3]), graph]):
    ...     failed = isinstance(answer, certpgo.CertPGOError)
    ...     print(answer if failed else answer.verdict)
    CERTIFIED
    the graph has 4 components of 2, 2, 1, 1 nodes; it must be connected
    CERTIFIED
    """
    chosen = settings_from(settings, options)
    return results_of(partial(_solved, settings=chosen, cost=cost), graphs, workers, executor)


def _solved(
    graph: _Posed, ends: Monitor, *, settings: SolveSettings, cost: str | None
) -> CertifiedSolution | CertPGOError:
    try:
        return solve(graph, settings, cost=cost, monitor=ends)
    except CertPGOError as error:
        return error


def certify_many(
    pairs: Iterable[_Pair],
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    **options: Any,
) -> Iterator[Certificate | CertPGOError]:
    """The certificates of `certpgo.certify` for many estimates, in their order.

    As in `solve_many`, an error stands in the place of the certificate that could not be made.

    Parameters
    ----------
    pairs : graphs, each with an estimate of it, as for `certpgo.certify`
    workers, executor : as for `solve_many`
    options : as for `certpgo.certify`, but ``monitor``

    Raises
    ------
    InputError
        There is to be no worker, or the executor is none.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> cycles = [winding_cycle(9, 0.3, k) for k in (0, 1)]
    >>> pairs = [(instance.graph, around) for instance, around in cycles]
    >>> [certificate.verdict.value for certificate in certpgo.certify_many(pairs)]
    ['CERTIFIED', 'REFUTED']
    """
    return results_of(partial(_certified, options=options), pairs, workers, executor)


def _certified(
    pair: _Pair, ends: Monitor, *, options: Mapping[str, Any]
) -> Certificate | CertPGOError:
    try:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"a pair of a graph and an estimate expected, not {kind_of(pair)}")
        posed, estimate = pair
        return certify(posed, estimate, monitor=ends, **options)
    except CertPGOError as error:
        return error


def prove_many(
    proofs: Mapping[AnyPath, AnyPath],
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    cost: str | None = None,
    time_limit: float | None = None,
) -> Iterator[Answer | CertPGOError]:
    """Graph files solved, proofs of the answers written and checked, in their order.

    As in `solve_many`, an error stands in the place of what could not be proven: a NumericalError
    where the answer is not CERTIFIED. Notices about files are `certpgo.InputNotice` warnings.

    Parameters
    ----------
    proofs : the path of each proof by that of its graph; as other processes or machines see them
    workers, executor : as for `solve_many`
    cost, time_limit : of each graph, as for `certpgo.solve`

    Raises
    ------
    InputError
        There is to be no worker, or the executor is none.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> certpgo.write("helix.g2o", helix(3, np.random.default_rng(0)))
    >>> [proven] = certpgo.prove_many({"helix.g2o": "helix.cert"}, cost="chordal")
    >>> proven.lower <= proven.upper
    True
    """
    require(proofs, Mapping, "a mapping from paths of graphs to those of their proofs")
    work = partial(attempt, cost=cost, time_limit=time_limit)
    attempts = results_of(work, tuple(proofs.items()), workers, executor)
    return _told(proofs, attempts)


def _told(
    graphs: Iterable[AnyPath],
    attempts: Iterator[Attempt],
) -> Iterator[Answer | CertPGOError]:
    for graph, (found, notices) in zip(graphs, attempts, strict=True):
        for sentence in notices:
            warnings.warn(f"{graph}: {sentence}", InputNotice, stacklevel=2)
        yield found


def results_of(
    work: Work[Item, Result],
    items: Iterable[Item],
    workers: int | None = None,
    executor: Executor | None = None,
) -> Iterator[Result]:
    """The results of ``work`` for all items, in their order, by threads or an executor.

    An error of one ends them all, with a note that names its item.

    Raises
    ------
    InputError
        There is to be no worker, or the executor is none.
    """
    if isinstance(items, str) or not isinstance(items, Iterable):
        raise InputError(f"a list or another iterable expected, not {kind_of(items)}")
    if workers is not None and workers < 1:
        raise InputError(f"the work is done by at least one worker, not {workers}")
    workers = workers or os.cpu_count() or 1
    if executor is None:
        return _by_threads(work, items, workers)
    require(executor, Executor, "an executor, as of concurrent.futures,")
    return _by_executor(work, items, silent, workers, executor)


def _by_threads(work: Work[Item, Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    unwanted, pool = threading.Event(), ThreadPoolExecutor(workers)
    try:
        yield from _by_executor(work, items, lambda _: unwanted.is_set(), workers, pool)
    finally:
        unwanted.set()
        pool.shutdown(wait=False, cancel_futures=True)


def _by_executor(
    work: Work[Item, Result],
    items: Iterable[Item],
    monitor: Monitor,
    workers: int,
    executor: Executor,
) -> Iterator[Result]:
    begun = deque[tuple[str, Future[Result]]]()
    try:
        for place, item in enumerate(items):
            try:
                future = executor.submit(work, item, monitor)
            except BrokenExecutor:
                while begun:  # one of these broke it
                    yield _result(*begun.popleft())
                raise
            begun.append((_named(place, item), future))
            if len(begun) > AHEAD * workers:
                yield _result(*begun.popleft())
        while begun:
            yield _result(*begun.popleft())
    finally:
        for _, future in begun:
            future.cancel()


def _result(name: str, future: Future[Result]) -> Result:
    try:
        result = future.result()
    except Exception as error:
        error.add_note(f"of {name}")
        raise
    failed = result[0] if isinstance(result, tuple) else result
    if isinstance(failed, CertPGOError):
        failed.add_note(f"of {name}")
    return result


def _named(place: int, item: object) -> str:
    """An item by its place, counted from 0, and its name or path."""
    graph = item[0] if isinstance(item, tuple) and item else item
    name = graph.name if isinstance(graph, Instance) else graph
    return f"item {place}" + (f", {name}" if isinstance(name, str | os.PathLike) else "")
