"""Inside certpgo: its initialization next to GTSAM's, its eigensolver next to ARPACK, assembly."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from certpgo.io import datasets
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from reports.harness.experiments.reference import step_of
from reports.harness.experiments.spec import Method
from reports.harness.speed.measuring import Comparison, Group, Timers, processor
from reports.harness.speed.reading import random_graph

SECTION = "parts"
SETS = ("intel", "manhattan", "parking-garage", "sphere2500", "torus3D", "cubicle")
EIGENMA, CHORDAL = "EigenMA", "GTSAM's chordal initialization"
KRYLOV_SCHUR, ARPACK = "eigenvectors by block Krylov-Schur", "ARPACK"
ASSEMBLED, LOOP = "connection Laplacian", "a loop over the edges"


def groups(quick: bool) -> Iterator[Group]:
    """Public sets, and a random graph."""
    compared = (Comparison(EIGENMA, CHORDAL), Comparison(KRYLOV_SCHUR, ARPACK))
    for name in SETS[: 1 if quick else len(SETS)]:
        timers = functools.partial(_set, name)
        yield Group(SECTION, name, timers, compared, rounds=2 if quick else 5)
    n, m = (400, 1_000) if quick else (40_000, 100_000)
    timers = functools.partial(_assembly, n, m)
    yield Group(SECTION, f"{m:,} random edges", timers, (Comparison(ASSEMBLED, LOOP),), rounds=2)


@contextmanager
def _set(name: str) -> Iterator[Timers]:
    graph = datasets.load(name, download=False, quiet=True).graph
    rotations = Quadratic(graph).rotation
    vectors = functools.partial(spectral.smallest_eigenpairs, rotations)
    yield {
        EIGENMA: processor(step_of(Method("eigen_ma"), lambda: Quadratic(graph))),
        CHORDAL: processor(step_of(Method("gtsam_chordal"), lambda: Quadratic(graph))),
        KRYLOV_SCHUR: processor(vectors),
        ARPACK: processor(functools.partial(vectors, method="arpack")),
    }


@contextmanager
def _assembly(n: int, m: int) -> Iterator[Timers]:
    graph = random_graph(n, m).rotations_alone

    def loop() -> None:
        blocks: dict[tuple[int, int], np.ndarray] = {}
        for (i, j), R, kappa in zip(
            graph.edges.tolist(), graph.rotations, graph.kappa, strict=True
        ):
            for key, block in (
                ((i, i), kappa * np.eye(3)),
                ((j, j), kappa * np.eye(3)),
                ((i, j), -kappa * R),
                ((j, i), -kappa * R.T),
            ):
                blocks[key] = blocks[key] + block if key in blocks else block

    yield {
        ASSEMBLED: processor(
            lambda: operators.connection_laplacian(operators.pattern(graph), graph)
        ),
        LOOP: processor(loop),
    }
