"""A graph from what a user calls it: a path, a dataset's name, or a synthetic family."""

from __future__ import annotations

import difflib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo import datasets
from certpgo.errors import InputError, SpecError
from certpgo.estimate import Estimate
from certpgo.graph import Instance, PoseGraph, require_connected
from certpgo.harness.spec import Components, Row
from certpgo.io import read
from certpgo.linalg.arrays import IntArray


def open_graph(
    name: str, *, data: Path | None = None, download: bool = True, **reading: Any
) -> Instance:
    """The graph of a path or a dataset name; a path that exists goes first.

    Raises
    ------
    InputError
        Neither a file nor a dataset is called so, or it cannot be read.
    """
    if Path(name).exists():
        return read(name, **reading)
    require_known(name)
    # The catalogue's own name is the better one where files of the same name differ.
    instance = datasets.load(name, data=data, download=download, **reading)
    return replace(instance, name=datasets.entry(name).name)


def require_known(name: str) -> None:
    """Refuse what is neither a file nor a dataset's name.

    Raises
    ------
    InputError
        With the nearest names of datasets, if there are any.
    """
    if Path(name).exists():
        return
    try:
        datasets.entry(name)
    except SpecError:
        near = difflib.get_close_matches(name, datasets.names("graph"), n=3, cutoff=0.6)
        hint = f"did you mean {' or '.join(near)}?" if near else "see certpgo list datasets"
        raise InputError(f"{name}: no such file or dataset; {hint}") from None


def is_here(row: Row, data: Path | None) -> bool:
    """Whether the row needs no download."""
    if row.generator or Path(row.dataset).exists():
        return True
    return datasets.find(row.dataset, data) is not None


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
            raise InputError("not run: no truth here")
        nodes = np.sort(truth[0])
        instance = restricted(
            instance, nodes, f"{instance.name} [{len(nodes)} nodes of known truth]"
        )
    return rotations_alone(instance) if row.rotations else instance


def rotations_alone(instance: Instance) -> Instance:
    """The instance without its translations, if it has any."""
    if not isinstance(instance.graph, PoseGraph):
        return instance
    truth = None if instance.truth is None else instance.truth.with_translations(None)
    return replace(instance, graph=instance.graph.rotation, truth=truth, initial=None)


def _load(row: Row, data: Path | None, seed: np.random.SeedSequence | None) -> Instance:
    if row.generator:
        return _generate(row, data, seed or np.random.SeedSequence(0))
    if not is_here(row, data):
        raise InputError("not run: file not here")
    return open_graph(row.dataset, data=data, download=False, quiet=True, **row.reading)


def known_truth(
    row: Row, instance: Instance, data: Path | None
) -> tuple[IntArray, Estimate] | None:
    """The nodes of a row's instance, or of a part of it, whose truth is known, and theirs."""
    if instance.truth is not None:
        return np.arange(instance.graph.num_nodes), instance.truth
    if row.generator or Path(row.dataset).exists():
        return None
    return datasets.truth(row.dataset, instance, data)


def connected_parts(instance: Instance, components: Components) -> list[Instance]:
    """The connected graphs to work on, largest first; nodes without measurements pose no problem.

    Raises
    ------
    GraphError
        The graph is not connected, and that is to be refused.
    """
    graph = instance.graph
    if graph.is_connected:
        return [instance]
    if components == "refuse":
        require_connected(graph)
    sizes = np.array(graph.component_sizes)
    by_size = [int(label) for label in np.argsort(-sizes, kind="stable") if sizes[label] > 1]
    return [
        component(instance, label) for label in by_size[: 1 if components == "largest" else None]
    ]


def component(instance: Instance, label: int) -> Instance:
    """One connected component of an instance."""
    nodes = np.flatnonzero(instance.graph.components == label)
    first = int(instance.ids[nodes].min())
    return restricted(instance, nodes, f"{instance.name} [{len(nodes)} nodes from id {first}]")


def restricted(instance: Instance, nodes: IntArray, name: str) -> Instance:
    """The instance of some nodes, ascending, and the edges between them."""
    graph = instance.graph
    inside = np.isin(graph.edges, nodes).all(axis=1)
    place = {int(node): k for k, node in enumerate(nodes)}
    return replace(
        instance,
        name=name,
        graph=graph.subgraph(nodes),
        ids=instance.ids[nodes],
        truth=None if instance.truth is None else instance.truth.subset(nodes),
        initial=None if instance.initial is None else instance.initial.subset(nodes),
        fixed=tuple(place[node] for node in instance.fixed if node in place),
        names=tuple(instance.names[node] for node in nodes) if instance.names else (),
        outliers=None if instance.outliers is None else instance.outliers[inside],
    )


def seed_of(base: int, row: int, repetition: int) -> np.random.SeedSequence:
    """The seed of a synthetic row's instance: the table's, the row's place, the repetition."""
    return np.random.SeedSequence(base, spawn_key=(row, repetition))


def _generate(row: Row, data: Path | None, seed: np.random.SeedSequence) -> Instance:
    from certpgo.datasets import synthetic, thesis

    public = {**vars(synthetic), **vars(thesis)}
    families = {name: f for name, f in public.items() if _is_family(name, f)}
    if row.generator not in families:
        raise SpecError.unknown("generator", row.generator, families)
    family = families[row.generator]
    # Of families that read a file, the folder to look in first.
    folder = {"data": data} if "data" in family.__annotations__ else {}
    instance: Instance = family(**row.arguments, **folder, rng=np.random.default_rng(seed))
    return instance


def _is_family(name: str, value: Any) -> bool:
    return (
        callable(value)
        and not name.startswith("_")
        and "rng" in (taken := getattr(value, "__annotations__", {}))
        and taken.get("return") == "Instance"
    )
