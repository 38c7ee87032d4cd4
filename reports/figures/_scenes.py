"""Measurements the figures share: files that are here, and Langevin noise on exact rotations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo import Instance, Quadratic
from certpgo.graph import Estimate, RotationGraph
from certpgo.io import datasets
from certpgo.io.datasets import thesis
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import IntArray
from certpgo.solve.consistency import consistency
from reports.harness.experiments.absence import Absence, NotRun

#: The viewing graph of 553 nodes and 103932 edges that the thesis' synthetic scenes have.
NOTRE_DAME = "Notre_Dame_viewing_graph"


def load(name: str, data: Path | None, **reading: bool | str) -> Instance:
    """A dataset whose file is here; nothing is downloaded.

    Raises
    ------
    InputError
        It is not.
    """
    if datasets.find(name, data) is None:
        raise not_here(name)
    return datasets.load(name, data, download=False, quiet=True, **reading)


def with_truth(name: str, data: Path | None) -> tuple[Instance, IntArray, Estimate]:
    """A dataset, the nodes of which the truth is known, and theirs.

    Raises
    ------
    InputError
        Its file or the truth's is not here.
    """
    instance = load(name, data)
    known = datasets.truth(name, instance, data)
    if known is None:
        raise not_here(f"{name}_truth")
    return instance, *known


def here(names: tuple[str, ...], data: Path | None) -> tuple[str, ...]:
    """Those of the datasets whose files are here.

    Raises
    ------
    InputError
        None is.
    """
    found = tuple(name for name in names if datasets.find(name, data) is not None)
    if not found:
        raise not_here(*names)
    return found


def not_here(*names: str) -> NotRun:
    """The error for files that a figure cannot do without."""
    reason = f"file not here ({', '.join(names)}); certpgo fetch or --data"
    return NotRun(Absence.NOT_HERE, reason)


def generator(*key: int) -> np.random.Generator:
    """The random numbers of one sample, by its place in the figure."""
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=key))


def exact_notre_dame(data: Path | None) -> Instance:
    """Random rotations, measured without noise along the edges of Notre Dame's viewing graph."""
    graph = load(NOTRE_DAME, data).graph
    R = so.random(generator(0), graph.num_nodes, 3)
    i, j = graph.edges.T
    measured = np.swapaxes(R[i], 1, 2) @ R[j]
    exact = RotationGraph(graph.num_nodes, graph.edges, measured, np.ones(len(i)))
    return Instance("notre_dame-exact", exact, np.arange(len(R)), truth=Estimate(R))


def exact_random(n: int, fiedler: float) -> Instance:
    """A random graph of a wished Fiedler value, measured without noise."""
    return thesis.langevin_graph(n, fiedler, 0.0, generator(0))


def fiedler(exact: Instance) -> float:
    """The second eigenvalue of the graph Laplacian."""
    return float(consistency(Quadratic(exact.graph)).graph[1])


def noisy(
    exact: Instance, sigma_deg: float, rng: np.random.Generator, *, outliers: float = 0.0
) -> Quadratic:
    """The measurements with noise of Lang(I, 1/sigma_R^2), thesis eq. 2.5, and outliers."""
    graph = exact.graph
    concentration = np.inf if sigma_deg == 0.0 else float(np.radians(sigma_deg) ** -2.0)
    measured = so.langevin(rng, concentration, graph.num_edges, 3) @ graph.rotations
    wrong = rng.random(graph.num_edges) < outliers
    measured[wrong] = so.random(rng, int(wrong.sum()), 3)
    return Quadratic(replace(graph, rotations=measured))
