"""Writing a proof, its check included, next to reading the file and solving."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from certpgo.io import datasets
from certpgo.objective.choose_cost import CHORDAL
from certpgo.solve.proving import write_proof
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.solving import solve
from reports.harness.speed.measuring import Comparison, Group, Timers, processor
from reports.harness.speed.solving import finished, solving

SECTION = "proofs"
SETS, SAMPLE = ("MIT", "intel", "smallGrid3D", "parking-garage", "sphere2500"), ("MIT",)
COSTS = (CHORDAL, "g2o")


def groups(quick: bool) -> Iterator[Group]:
    """One for each set, under each cost that proofs are about."""
    compared = tuple(Comparison(_proving(cost), _from_file(cost), 3.0) for cost in COSTS)
    for name in SAMPLE if quick else SETS:
        timers = functools.partial(_set, name)
        yield Group(SECTION, name, timers, compared, rounds=1 if quick else 3)


def _proving(cost: str) -> str:
    return f"write the proof, cost {cost}"


def _from_file(cost: str) -> str:
    return f"read and {solving(cost)}"


def _solved(source: Path, cost: str) -> CertifiedSolution:
    return finished(solve(source, cost=cost))


@contextmanager
def _set(name: str) -> Iterator[Timers]:
    instance = datasets.load(name, download=False, quiet=True)
    source = datasets.fetch(name, download=False)
    timers = {}
    with tempfile.TemporaryDirectory() as folder:
        proof = Path(folder) / "proof.cert"
        for cost in COSTS:
            answer = solve(instance, cost=cost)
            found = answer.estimate, answer.certificate
            timers[_proving(cost)] = processor(
                functools.partial(write_proof, proof, source, instance, *found),
                lambda proven: f"gap {proven.relative_gap:.1e}",
            )
            timers[_from_file(cost)] = processor(functools.partial(_solved, source, cost))
        yield timers
