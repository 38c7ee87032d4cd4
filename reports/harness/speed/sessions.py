"""Sessions: a stream of measurements, next to solving its prefixes anew, and to GTSAM's iSAM2."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median

import numpy as np

from certpgo import registry
from certpgo.graph import Graph, Instance
from certpgo.graph.streaming import arrivals, streamed
from certpgo.io import datasets
from certpgo.solve.session import Session
from certpgo.solve.solving import solve
from reports.harness.speed.measuring import Comparison, Group, Lap, Timers
from reports.harness.speed.solving import finished

SECTION = "sessions"
GRAPHS = ("manhattan", "sphere2500", "city10000", "kitti_00")
#: Measurements after which a session refreshes its certificate.
EVERY = 100
#: First measurements whose additions are compared with updates of iSAM2, which slow down later.
COMPARED = 1000
STREAM, BATCHES = "whole stream, refreshed at each 100th", "solving each 100th prefix anew"
ADDED, UPDATED = "one measurement added, median", "one update of iSAM2, median"


def groups(quick: bool) -> Iterator[Group]:
    """Whole streams, and single measurements."""
    compared = (Comparison(STREAM, BATCHES, 0.5), Comparison(ADDED, UPDATED))
    for name in ("MIT",) if quick else GRAPHS:
        timers = functools.partial(_stream, name)
        yield Group(SECTION, name, timers, compared, rounds=1 if quick else 2)


@contextmanager
def _stream(name: str) -> Iterator[Timers]:
    instance = datasets.load(name, download=False, quiet=True)
    latencies: list[float] = []

    def stream() -> Lap:
        session, latencies[:] = fed(instance.graph)
        return Lap(sum(latencies), session.standing.verdict.value)

    yield {
        STREAM: stream,
        ADDED: lambda: Lap(median(latencies[:COMPARED])),  # of the stream before
        BATCHES: lambda: Lap(sum(map(_solved, prefixes(instance.graph)))),
        UPDATED: lambda: _updated(instance),
    }


def _solved(graph: Graph) -> float:
    return timed(lambda: finished(solve(graph, cost="chordal")))


def _updated(instance: Instance) -> Lap:
    seconds, factorization = registry.load_file("baselines", "_isam2").updates(instance, COMPARED)
    return Lap(median(seconds), "" if factorization == "CHOLESKY" else f"by {factorization}")


def fed(
    graph: Graph, after: Callable[[int, Session], object] = lambda count, session: None
) -> tuple[Session, list[float]]:
    """A session that was given all measurements, and the processor seconds of each addition.

    Parameters
    ----------
    after : is called with the count of measurements and the session whenever it was refreshed,
        each `EVERY` measurements and at the end
    """
    session, latencies, m = Session(every=EVERY, cost="chordal"), [], graph.num_edges
    for count, (one, nodes) in enumerate(streamed(graph), 1):
        latencies.append(timed(functools.partial(session.add, one, nodes)))
        if count == m:
            latencies[-1] += timed(session.refresh)
        if count % EVERY == 0 or count == m:
            after(count, session)
    return session, latencies


def prefixes(graph: Graph) -> Iterator[Graph]:
    """The graph when the session is refreshed: of each `EVERY` measurements, and the whole."""
    m = graph.num_edges
    for count in [*range(EVERY, m, EVERY), m]:
        yield prefix(graph, count)


def prefix(graph: Graph, count: int) -> Graph:
    """The graph of the first measurements to arrive."""
    edges = arrivals(graph)[:count]
    return graph.with_edges(edges).subgraph(np.arange(graph.edges[edges].max() + 1))


def timed(step: Callable[[], object]) -> float:
    """Processor seconds of a step."""
    begin = time.process_time()
    step()
    return time.process_time() - begin
