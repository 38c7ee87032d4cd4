"""How the certified pipeline grows: synthetic families of known truth, one process per size.

A separate process shows how much memory a size takes.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace

import numpy as np

from certpgo.errors import CertPGOError, SpecError
from certpgo.graph import Instance
from certpgo.graph.components import rotations_alone
from certpgo.io.datasets import synthetic
from certpgo.linalg.factor import default_engine
from certpgo.solve.provenance import peak_memory, provenance
from certpgo.solve.solving import solve
from reports.harness.experiments.absence import DIED, missing
from reports.harness.experiments.keys import content_key
from reports.harness.experiments.records import Record, of_certificate, of_solution

#: Of a solution.
PHASES = ("start", "newton", "certify")


@dataclass(frozen=True)
class Family:
    """Graphs of one kind in growing sizes.

    Attributes
    ----------
    build : size and generator -> instance
    rotations : take the rotations alone
    sizes, quick : sizes of the whole and of the quick profile
    """

    build: Callable[[int, np.random.Generator], Instance]
    rotations: bool
    sizes: tuple[int, ...]
    quick: tuple[int, ...]


def _uneven_helix(turns: int, rng: np.random.Generator) -> Instance:
    return synthetic.helix(turns, rng, uneven=True)


FAMILIES = {
    "helix": Family(synthetic.helix, False, (50, 100, 200, 316, 1000), (10, 20)),
    "uneven_helix": Family(_uneven_helix, False, (50, 100, 200), (10, 20)),
    "grid": Family(synthetic.grid3d, False, (10, 15, 20, 30), (4, 6)),
    "helix_rotations": Family(synthetic.helix, True, (50, 100, 200, 500, 1000), (10, 20)),
    "grid_rotations": Family(synthetic.grid3d, True, (10, 20, 30, 46), (4, 6)),
}


def family(name: str) -> Family:
    """The family called ``name``.

    Raises
    ------
    SpecError
        There is none, with the nearest names.
    """
    if name not in FAMILIES:
        raise SpecError.unknown("family", name, FAMILIES)
    return FAMILIES[name]


def file_name(name: str) -> str:
    """What the file of a family's records is called."""
    return f"scale_{name}"


def graph_key(name: str, size: int, seed: int) -> str:
    """The key of a graph's record, with the factorization engine in use."""
    engine = default_engine()
    return content_key({"family": name, "size": size, "seed": seed, "engine": engine})


def measure(name: str, size: int, seed: int = 0) -> Record:
    """The record of one graph, solved in a fresh process.

    Raises
    ------
    SpecError
        The family is unknown.
    """
    family(name)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        try:
            return pool.submit(measured, name, size, seed).result()
        except BrokenProcessPool:
            return replace(_blank(name, size, seed), **DIED._asdict())


def measured(name: str, size: int, seed: int) -> Record:
    """One graph solved in this process: time, memory, verdict, and counts of the work."""
    chosen = family(name)
    record = replace(_blank(name, size, seed), provenance=provenance(default_engine(), None))
    try:
        instance = chosen.build(size, np.random.default_rng(np.random.SeedSequence((seed, size))))
        graph = (rotations_alone(instance) if chosen.rotations else instance).graph
        del instance
        start = time.perf_counter()
        found = solve(graph)
        elapsed = time.perf_counter() - start
    except (CertPGOError, MemoryError, np.linalg.LinAlgError) as error:
        return replace(record, **missing(error)._asdict())
    metrics = {
        "cost": found.cost,
        "relative_gap": found.certificate.relative_gap,
        "median_seconds": elapsed,
        "memory_gb": peak_memory(),
    }
    return replace(
        record,
        d=graph.d,
        n=graph.num_nodes,
        m=graph.num_edges,
        metrics={key: value for key, value in metrics.items() if math.isfinite(value)},
        note=found.solution.note,
        **of_solution(found.solution),
        **of_certificate(found.certificate),
    )


def slope(records: Iterable[Record], metric: str = "median_seconds") -> float:
    """Exponent p of metric ~ n^p, fitted to the records that have it; NaN for fewer than two."""
    return exponent([(r.n, r.metrics[metric]) for r in records if r.n and metric in r.metrics])


def phase_slopes(records: Iterable[Record]) -> dict[str, float]:
    """The same of the seconds of each phase that all records have."""
    measured = [record for record in records if record.n and record.seconds]
    shared = [name for name in PHASES if measured and all(name in r.seconds for r in measured)]
    return {name: exponent([(r.n or 0, r.seconds[name]) for r in measured]) for name in shared}


def exponent(points: Sequence[tuple[int, float]]) -> float:
    """The p of value ~ n^p, fitted to pairs (n, value); NaN for fewer than two different n."""
    if len({n for n, _ in points}) < 2 or not all(value > 0.0 for _, value in points):
        return math.nan
    n, value = np.log(np.array(points)).T
    return float(np.polyfit(n, value, 1)[0])


def _blank(name: str, size: int, seed: int) -> Record:
    return Record(
        file_name(name),
        f"{name} {size}",
        "certified",
        solver="certified",
        seed=seed,
        key=graph_key(name, size, seed),
    )
