"""Many graphs or estimates, one after the other in their order, by threads.

The compiled kernel computes without Python's lock, so that threads share the work of factorizations
and of sums over edges; what is Python's own, in graphs of a hundred poses most of it, takes turns.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from certpgo.certify.certificate import Certificate
from certpgo.errors import CertPGOError, InputError, kind_of
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.accept_paths import AnyPath
from certpgo.io.writing import AnyAnswer
from certpgo.objective.choose_cost import Judged
from certpgo.objective.sum import Sum
from certpgo.optimize.monitor import Monitor
from certpgo.solve.judging import certify
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings, settings_from
from certpgo.solve.solving import solve

Item = TypeVar("Item")
Result = TypeVar("Result")
#: What is done with an item. The monitor stops it where its result is no longer wanted.
Work = Callable[[Item, Monitor], Result]

#: Items per thread that are taken before their results are asked for.
AHEAD = 2


def solve_many(
    graphs: Iterable[Graph | Instance | Sum | AnyPath],
    settings: SolveSettings | None = None,
    *,
    workers: int | None = None,
    cost: str | None = None,
    **options: Any,
) -> Iterator[CertifiedSolution | CertPGOError]:
    """The answers of `certpgo.solve` for many graphs, in their order, by threads.

    Where one fails, its error stands in its place, and the others go on. Graphs are taken as their
    answers are asked for, a few ahead, so that there may be any number of them. Ctrl-C, or an end
    of the loop over the answers, stops those that are in work after their current step.

    Parameters
    ----------
    graphs : each as for `certpgo.solve`
    workers : number of threads; by default that of the machine's processors
    settings, cost, options : of every graph, as for `certpgo.solve`

    Raises
    ------
    InputError
        There is to be no thread; or as `SolveSettings`.
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

    def solved(graph: Graph | Instance | Sum | AnyPath, ends: Monitor) -> CertifiedSolution:
        return solve(graph, chosen, cost=cost, monitor=ends)

    return by_threads(_or_its_error(solved), graphs, workers)


def certify_many(
    pairs: Iterable[tuple[Judged | Graph | Instance | AnyPath, Estimate | AnyAnswer | AnyPath]],
    *,
    workers: int | None = None,
    **options: Any,
) -> Iterator[Certificate | CertPGOError]:
    """The certificates of `certpgo.certify` for many estimates, in their order, by threads.

    As in `solve_many`, an error stands in the place of the certificate that could not be made.

    Parameters
    ----------
    pairs : graphs, each with an estimate of it, as for `certpgo.certify`
    workers : number of threads; by default that of the machine's processors
    options : as for `certpgo.certify`, but ``monitor``

    Raises
    ------
    InputError
        There is to be no thread.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> cycles = [winding_cycle(9, 0.3, k) for k in (0, 1)]
    >>> pairs = [(instance.graph, around) for instance, around in cycles]
    >>> [certificate.verdict.value for certificate in certpgo.certify_many(pairs)]
    ['CERTIFIED', 'REFUTED']
    """

    def certified(
        pair: tuple[Judged | Graph | Instance | AnyPath, Estimate | AnyAnswer | AnyPath],
        ends: Monitor,
    ) -> Certificate:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"a pair of a graph and an estimate expected, not {kind_of(pair)}")
        posed, estimate = pair
        return certify(posed, estimate, monitor=ends, **options)

    return by_threads(_or_its_error(certified), pairs, workers)


def by_threads(
    work: Work[Item, Result], items: Iterable[Item], workers: int | None = None
) -> Iterator[Result]:
    """The results of ``work`` for all items, in their order, by threads.

    An error of one ends them all.

    Raises
    ------
    InputError
        There is to be no thread.
    """
    if isinstance(items, str) or not isinstance(items, Iterable):
        raise InputError(f"a list or another iterable expected, not {kind_of(items)}")
    if workers is not None and workers < 1:
        raise InputError(f"the work is done by at least one thread, not {workers}")
    return _by_threads(work, items, workers or os.cpu_count() or 1)


def _by_threads(work: Work[Item, Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    unwanted = threading.Event()
    pool, begun = ThreadPoolExecutor(workers), deque[Future[Result]]()
    try:
        for item in items:
            begun.append(pool.submit(work, item, lambda _: unwanted.is_set()))
            if len(begun) > AHEAD * workers:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
    finally:
        unwanted.set()
        pool.shutdown(wait=False, cancel_futures=True)


def _or_its_error(work: Work[Item, Result]) -> Work[Item, Result | CertPGOError]:
    """The same work, whose errors are results."""

    def attempted(item: Item, ends: Monitor) -> Result | CertPGOError:
        try:
            return work(item, ends)
        except CertPGOError as error:
            return error

    return attempted
