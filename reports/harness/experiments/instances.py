"""The graph of a table's row: a file, a dataset, or an instance of a synthetic family."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate, Instance
from certpgo.graph.components import restricted, rotations_alone
from certpgo.io import datasets
from certpgo.io.datasets.source import resolve
from certpgo.linalg.arrays import IntArray
from reports.harness.experiments.absence import Absence, NotRun
from reports.harness.experiments.spec import Row


def is_here(row: Row, data: Path | None) -> bool:
    """Whether the row needs no download."""
    return bool(row.generator) or resolve(row.dataset, data).found is not None


def load_row(row: Row, data: Path | None, seed: np.random.SeedSequence | None) -> Instance:
    """The instance of a row; nothing is downloaded.

    Raises
    ------
    InputError
        The file is not here, or cannot be read.
    SpecError
        The generator is unknown.
    """
    instance = _load(row, data, seed)
    if row.known:
        truth = known_truth(row, instance, data)
        if truth is None:
            raise NotRun(Absence.NOT_HERE, "no truth here")
        nodes = np.sort(truth[0])
        instance = restricted(
            instance, nodes, f"{instance.name} [{len(nodes)} nodes of known truth]"
        )
    return rotations_alone(instance) if row.rotations else instance


def _load(row: Row, data: Path | None, seed: np.random.SeedSequence | None) -> Instance:
    if row.generator:
        return _generate(row, data, seed or np.random.SeedSequence(0))
    source = resolve(row.dataset, data)
    if source.found is None:
        raise NotRun(Absence.NOT_HERE, "file not here")
    return source.graph(download=False, quiet=True, **row.reading)


def known_truth(
    row: Row, instance: Instance, data: Path | None
) -> tuple[IntArray, Estimate] | None:
    """The nodes of a row's instance, or of a part of it, whose truth is known, and theirs."""
    if instance.truth is not None:
        return np.arange(instance.graph.num_nodes), instance.truth
    return None if row.generator else resolve(row.dataset, data).truth(instance)


def seed_of(base: int, row: int, repetition: int) -> np.random.SeedSequence:
    """The seed of a synthetic row's instance: the table's, the row's place, the repetition."""
    return np.random.SeedSequence(base, spawn_key=(row, repetition))


def _generate(row: Row, data: Path | None, seed: np.random.SeedSequence) -> Instance:
    from certpgo.io.datasets import synthetic, thesis

    public = {**vars(synthetic), **vars(thesis)}
    families = {name: f for name, f in public.items() if _is_family(name, f)}
    if row.generator not in families:
        raise SpecError.unknown("generator", row.generator, families)
    family = families[row.generator]
    folder = {}
    if "data" in family.__annotations__:  # it reads a dataset's file
        if datasets.find(row.arguments["name"], data) is None:
            raise NotRun(Absence.NOT_HERE, "file not here")
        folder = {"data": data}
    instance: Instance = family(**row.arguments, **folder, rng=np.random.default_rng(seed))
    return instance


def _is_family(name: str, value: Any) -> bool:
    return (
        callable(value)
        and not name.startswith("_")
        and "rng" in (taken := getattr(value, "__annotations__", {}))
        and taken.get("return") == "Instance"
    )
