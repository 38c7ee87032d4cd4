"""The package's own lossless format: NumPy arrays in a zip archive, no pickles.

A graph: edges, rotations, kappa (translations, tau), ids, initial values, truth, fixed nodes,
reading options. An estimate: rotations, translations, ids.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import CertPGOError, FormatError
from certpgo.estimate import Estimate
from certpgo.graph import Graph, Instance, PoseGraph, RotationGraph
from certpgo.io.format import Format, LabelledPoses, ReadOptions
from certpgo.linalg.arrays import FloatArray, IntArray

_VERSION = 1
_Arrays = Mapping[str, NDArray[Any]]


def _recognises(path: Path, head: bytes) -> bool:
    return path.suffix == ".npz" and head.startswith(b"PK")


def _load(path: Path, kind: str) -> _Arrays:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception:  # zipfile, zlib and NumPy each have their own errors for broken archives
        raise FormatError(path, None, "an archive of plain NumPy arrays expected") from None
    found = str(arrays.get("kind", "something else"))
    if found != kind or int(arrays.get("version", 0)) != _VERSION:
        raise FormatError(path, None, f"one {kind} (version {_VERSION}) expected, not {found}")
    return arrays


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    arrays = _load(path, "graph")
    try:
        return _instance(arrays, str(path))
    except KeyError as error:
        raise FormatError(path, None, f"the array {error} is missing") from None
    except (CertPGOError, ValueError, TypeError) as error:
        raise FormatError(path, None, str(error)) from None


def _instance(arrays: _Arrays, source: str) -> Instance:
    rotation = RotationGraph(
        int(arrays["num_nodes"]), arrays["edges"], arrays["rotations"], arrays["kappa"]
    )
    graph: Graph = rotation
    if "tau" in arrays:
        graph = PoseGraph(rotation, arrays["translations"], arrays["tau"])
    return Instance(
        name=str(arrays["name"]),
        graph=graph,
        ids=arrays["ids"],
        truth=_estimate(arrays, "truth"),
        initial=_estimate(arrays, "initial"),
        fixed=tuple(arrays["fixed"].tolist()),
        source=source,
        options=json.loads(str(arrays["options"])),
        notices=tuple(json.loads(str(arrays["notices"]))),
        names=tuple(arrays["names"].tolist()) if "names" in arrays else (),
    )


def _estimate(arrays: _Arrays, name: str) -> Estimate | None:
    if f"{name}_rotations" not in arrays:
        return None
    return Estimate(arrays[f"{name}_rotations"], arrays.get(f"{name}_translations"))


def _read_poses(path: Path) -> LabelledPoses:
    arrays = _load(path, "estimate")
    try:
        R, t, ids = arrays["rotations"], arrays.get("translations"), arrays["ids"]
        estimate = Estimate(R, t)
    except KeyError as error:
        raise FormatError(path, None, f"the array {error} is missing") from None
    except CertPGOError as error:
        raise FormatError(path, None, str(error)) from None
    if ids.dtype.kind != "i" or len(np.unique(ids)) != estimate.num_nodes or ids.ndim != 1:
        raise FormatError(path, None, f"{estimate.num_nodes} distinct integer ids expected")
    return LabelledPoses(estimate.rotations, estimate.translations, ids=ids)


def _write_graph(path: Path, instance: Instance) -> None:
    graph = instance.graph
    rotation = graph.rotation if isinstance(graph, PoseGraph) else graph
    arrays: dict[str, Any] = {
        "num_nodes": graph.num_nodes,
        "edges": graph.edges,
        "rotations": rotation.rotations,
        "kappa": rotation.kappa,
        "ids": instance.ids,
        "name": instance.name,
        "fixed": np.array(instance.fixed, dtype=np.intp),
        "options": json.dumps(dict(instance.options)),
        "notices": json.dumps(instance.notices),
    }
    if isinstance(graph, PoseGraph):
        arrays |= {"translations": graph.translations, "tau": graph.tau}
    if instance.names:
        arrays["names"] = np.array(instance.names)
    arrays |= _named("initial_", instance.initial) | _named("truth_", instance.truth)
    _save(path, "graph", arrays)


def _write_poses(path: Path, estimate: Estimate, ids: IntArray, times: FloatArray) -> None:
    _save(path, "estimate", {"ids": ids, **_named("", estimate)})


def _named(prefix: str, estimate: Estimate | None) -> dict[str, Any]:
    if estimate is None:
        return {}
    arrays = {f"{prefix}rotations": estimate.rotations}
    if estimate.translations is not None:
        arrays[f"{prefix}translations"] = estimate.translations
    return arrays


def _save(path: Path, kind: str, arrays: dict[str, Any]) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, kind=kind, version=_VERSION, **arrays)


FORMAT = Format(
    name="npz",
    suffixes=(".npz",),
    recognises=_recognises,
    holds="a graph or an estimate",
    read_graph=_read_graph,
    read_poses=_read_poses,
    write_graph=_write_graph,
    write_poses=_write_poses,
)
