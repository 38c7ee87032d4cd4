"""Sessions: a stream of measurements, next to solving its prefixes anew, and to GTSAM's iSAM2."""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import fmean
from typing import Any

import numpy as np

from certpgo import registry
from certpgo.graph import Graph, Instance
from certpgo.graph.streaming import arrivals, streamed
from certpgo.io import datasets
from certpgo.solve.session import Session
from certpgo.solve.solving import solve
from reports.harness.speed.measuring import Comparison, Group, Lap, Timer, Timers
from reports.harness.speed.solving import finished

SECTION = "sessions"
GRAPHS = ("manhattan", "sphere2500", "city10000", "kitti_00")
#: Measurements after which a session refreshes its certificate.
EVERY = 100
#: After how many measurements refreshes are compared with updates of iSAM2, and how many of them:
#: enough for loop closures, whose refreshes take the most time, to be among them as in the whole.
PLACES = {"sphere2500": (300, 800), "manhattan": (500, 1500), "MIT": (200,)}
REFRESHES = 100
STREAM, BATCHES = "whole stream, refreshed at each 100th", "solving each 100th prefix anew"
REFRESHED, UPDATED = "refreshed after each, from {} on", "update of iSAM2, from {} on"


def groups(quick: bool) -> Iterator[Group]:
    """Whole streams, and single measurements."""
    for name in ("MIT",) if quick else GRAPHS:
        compared = (
            Comparison(STREAM, BATCHES, 0.5),
            *(
                Comparison(REFRESHED.format(place), UPDATED.format(place), 3.0)
                for place in PLACES.get(name, ())
            ),
        )
        timers = functools.partial(_stream, name)
        yield Group(SECTION, name, timers, compared, rounds=1 if quick else 2)


@contextmanager
def _stream(name: str) -> Iterator[Timers]:
    instance = datasets.load(name, download=False, quiet=True)

    def stream() -> Lap:
        session, latencies = fed(instance.graph)
        return Lap(sum(latencies), session.standing.verdict.value)

    timers: dict[str, Timer] = {
        STREAM: stream,
        BATCHES: lambda: Lap(sum(map(_solved, prefixes(instance.graph)))),
    }
    for place in PLACES.get(name, ()):
        timers[REFRESHED.format(place)] = functools.partial(_refreshed, instance.graph, place)
        timers[UPDATED.format(place)] = functools.partial(_updated, instance, place)
    yield timers


def _refreshed(graph: Graph, place: int) -> Lap:
    """Adding a measurement and refreshing the answer and its bound, after so many; the mean."""
    session = Session(every=graph.num_edges + 1, cost="chordal")
    stream = streamed(graph)
    for one, nodes in itertools.islice(stream, place):
        session.add(one, nodes)
    session.refresh()

    def refreshed(one: Graph | Instance, nodes: Any) -> None:
        session.add(one, nodes)
        session.refresh()

    following = itertools.islice(stream, REFRESHES)
    return Lap(fmean(timed(functools.partial(refreshed, *arrived)) for arrived in following))


def _solved(graph: Graph) -> float:
    return timed(lambda: finished(solve(graph, cost="chordal")))


def _updated(instance: Instance, place: int) -> Lap:
    updates = registry.load_file("baselines", "_isam2").updates
    seconds, factorization = updates(instance, place + REFRESHES)
    return Lap(fmean(seconds[place:]), "" if factorization == "CHOLESKY" else f"by {factorization}")


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
