"""The package's own lossless format: NumPy arrays in a zip archive, no pickles.

A graph: edges, rotations, kappa (translations, tau, information matrices), ids, which nodes are
points, numbered apart from poses, or the world, which edges assume where that is or measure from
it, times, ranges, scales and which nodes' are free, initial values, truth, fixed nodes, reading
options. An estimate: rotations, translations, scales, ids, times, names, and which are points.

Of the information matrices each distinct one is stored once (``information``), with the number of
each edge's (``information_index``), the cost whose residuals they weigh
(``information_residual``), and what kappa takes rotational information to be about
(``information_about``). Measurements of a kind of one's own are stored by the name of its class
(``block.NAME.edges`` and its columns), which must be defined where they are read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import CertPGOError, FormatError, InputError, NoMeasurements
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph, SimilarityGraph
from certpgo.graph.information import Information, RotationAbout
from certpgo.graph.keys import Keys
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import in_utf8
from certpgo.graph.ranges import Ranges
from certpgo.io.archives import arrays_in
from certpgo.io.format import Format, LabelledPoses, ReadOptions

_VERSION = 1
#: What the names of arrays of other kinds of measurements begin with.
_BLOCK = "block."
_Arrays = Mapping[str, NDArray[Any]]

#: Kind (number or text) and shape of each array; equal letters are equal sizes.
_HEADER = {"kind": ("U", ""), "version": ("i", "")}
_GRAPH = {
    "num_nodes": ("i", ""),
    "edges": ("i", "m2"),
    "rotations": ("f", "mdd"),
    "kappa": ("f", "m"),
    "ids": ("i", "n"),
    "name": ("U", ""),
    "fixed": ("i", "k"),
    "options": ("U", ""),
    "notices": ("U", ""),
}
_GRAPH_OPTIONAL = {
    "translations": ("f", "md"),
    "tau": ("f", "m"),
    "points": ("b", "n"),
    "world": ("i", ""),
    "origin": ("f", "d"),
    "information": ("f", "cpp"),
    "information_index": ("i", "m"),
    "information_residual": ("U", ""),
    "information_about": ("U", ""),
    "names": ("U", "n"),
    "assumed": ("b", "m"),
    "absolute": ("b", "m"),
    "apart": ("b", "n"),
    "moved_by": ("i", ""),
    "range_edges": ("i", "r2"),
    "range_distances": ("f", "r"),
    "range_weights": ("f", "r"),
    "initial_rotations": ("f", "ndd"),
    "initial_translations": ("f", "nd"),
    "truth_rotations": ("f", "ndd"),
    "truth_translations": ("f", "nd"),
    "times_ns": ("i", "t"),
    "arms": ("f", "md"),
    "couplings": ("f", "mdd"),
    "stated": ("i", "m2"),
    "scales": ("f", "m"),
    "free": ("b", "n"),
    "initial_scales": ("f", "n"),
    "truth_scales": ("f", "n"),
    "camera": ("f", "4"),
    "outliers": ("b", "m"),
}
_ESTIMATE = {"rotations": ("f", "ndd"), "ids": ("i", "n")}
_ESTIMATE_OPTIONAL = {
    "translations": ("f", "nd"),
    "points": ("b", "n"),
    "times_ns": ("i", "n"),
    "names": ("U", "n"),
    "scales": ("f", "n"),
}
_KINDS = {"b": "flags", "i": "integers", "f": "floating-point numbers", "U": "text"}


def _recognises(path: Path, head: bytes) -> bool:
    return path.suffix == ".npz" and head.startswith(b"PK")


def _load(path: Path, kind: str) -> _Arrays:
    arrays = arrays_in(path)
    try:
        _require_layout(arrays, _HEADER, {})
        found, version = str(arrays["kind"]), int(arrays["version"])
    except InputError:
        found, version = "something else", 0
    if found != kind or version != _VERSION:
        other = (kind, found, version) == ("graph", "estimate", _VERSION)
        error = NoMeasurements if other else FormatError
        raise error(path, None, f"one {kind} (version {_VERSION}) expected, not {found}")
    return arrays


def _require_layout(
    arrays: _Arrays,
    required: Mapping[str, tuple[str, str]],
    optional: Mapping[str, tuple[str, str]],
) -> None:
    """Refuse missing arrays, and arrays of other kinds or shapes, by an InputError."""
    sizes: dict[str, int] = {}
    for name, (kind, dims) in {**required, **optional}.items():
        if name not in arrays:
            if name in required:
                raise InputError(f"the array {name!r} is missing")
            continue
        array = arrays[name]
        sizes_found = zip(dims, (*array.shape, *[0] * len(dims)), strict=False)
        expected = tuple(
            int(dim) if dim.isdigit() else sizes.setdefault(dim, size) for dim, size in sizes_found
        )
        if array.dtype.kind != kind or array.shape != expected:
            what = f"{_KINDS[kind]} of shape {expected}"
            raise InputError(f"the array {name!r} must be {what}, not {array.dtype} {array.shape}")


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    arrays = _load(path, "graph")
    try:
        _require_layout(arrays, _GRAPH, _GRAPH_OPTIONAL)
        return _instance(arrays, str(path))
    except CertPGOError as error:
        raise FormatError(path, None, str(error)) from None


def _instance(arrays: _Arrays, source: str) -> Instance:
    n = int(arrays["num_nodes"])
    if len(arrays["ids"]) != n:
        raise InputError(f"ids must be {n} distinct integers")
    edges, couplings = arrays["edges"], arrays.get("couplings")
    rotation = RotationGraph(n, edges, arrays["rotations"], arrays["kappa"], couplings)
    graph: Graph = rotation
    information, ranges = _information(arrays), _ranges(arrays, n)
    if "tau" in arrays:
        if "translations" not in arrays:
            raise InputError("the array 'translations' is missing")
        t, tau = arrays["translations"], arrays["tau"]
        optional = ("arms", "points", "assumed", "absolute")
        more: dict[str, Any] = {name: arrays.get(name) for name in optional}
        unscaled: dict[str, Any] = {
            name: arrays[name] for name in ("scales", "free") if name in arrays
        }
        if len(unscaled) == 1:
            raise InputError("the arrays 'scales' and 'free' belong together")
        if unscaled:
            if more.pop("arms") is not None:
                raise InputError("similarities have no arms")
            graph = SimilarityGraph(rotation, t, tau, **more, **unscaled)
        else:
            graph = PoseGraph(rotation, t, tau, **more)
        others = _others(arrays, n)
        graph = graph.with_information(information).with_blocks(ranges, *others)
    elif information is not None or ranges is not None:
        what = "distances" if information is None else "information matrices"
        raise InputError(f"{what} are of poses; this graph measures rotations")
    fixed = arrays["fixed"]
    if ((fixed < 0) | (fixed >= n)).any():
        raise InputError(f"fixed nodes are numbered 0 to {n - 1}")
    return Instance(
        name=str(arrays["name"]),
        graph=graph,
        ids=arrays["ids"],
        truth=_estimate(arrays, "truth"),
        initial=_estimate(arrays, "initial"),
        fixed=tuple(fixed.tolist()),
        source=source,
        options={"rotation_information": "tangent"} | _texts(arrays, "options", dict),
        notices=tuple(_texts(arrays, "notices", list)),
        names=tuple(arrays["names"].tolist()) if "names" in arrays else (),
        world=int(arrays["world"]) if "world" in arrays else None,
        origin=arrays.get("origin"),
        apart=arrays.get("apart"),
        moved_by=int(arrays.get("moved_by", 0)),
        times_ns=arrays.get("times_ns"),
        stated=arrays.get("stated"),
        outliers=arrays.get("outliers"),
        camera=tuple(arrays["camera"].tolist()) if "camera" in arrays else (),
    )


def _ranges(arrays: _Arrays, n: int) -> Ranges | None:
    names = ("range_edges", "range_distances", "range_weights")
    missing = [name for name in names if name not in arrays]
    if len(missing) == len(names):
        return None
    if missing:
        raise InputError(f"the array {missing[0]!r} is missing")
    return Ranges(n, *(arrays[name] for name in names))


def _others(arrays: _Arrays, n: int) -> list[Observations]:
    """Measurements of kinds of one's own."""
    columns: dict[str, dict[str, NDArray[Any]]] = {}
    for stored, values in arrays.items():
        if stored.startswith(_BLOCK):
            name, _, column = stored.removeprefix(_BLOCK).partition(".")
            columns.setdefault(name, {})[column] = values
    found: list[Observations] = []
    for name, given in columns.items():
        kind = Observations.named(name)
        wanted = {one.name for one in fields(kind)} - {"num_nodes"}
        if given.keys() != wanted:
            raise InputError(f"{name} have the arrays {', '.join(sorted(wanted))}")
        k = len(given["edges"]) if given["edges"].ndim else 0
        for column, values in given.items():
            kinds = "i" if column == "edges" else "bif"
            if values.dtype.kind not in kinds or values.shape[:1] != (k,):
                raise InputError(f"the array {column!r} of {name} must be {k} rows of numbers")
        found.append(kind(num_nodes=n, **given))
    return found


def _information(arrays: _Arrays) -> Information | None:
    names = ("information", "information_index")
    missing = [name for name in names if name not in arrays]
    if len(missing) == 1:
        raise InputError(f"the array {missing[0]!r} is missing")
    if missing:
        return None
    residual = str(arrays.get("information_residual", "")) or None
    about = str(arrays.get("information_about", "tangent"))
    if about not in get_args(RotationAbout):
        said = " or ".join(map(repr, get_args(RotationAbout)))
        raise InputError(f"the array 'information_about' must be {said}, not {about!r}")
    kind = cast("RotationAbout", about)
    return Information(arrays["information"], arrays["information_index"], residual, kind)


def _texts(arrays: _Arrays, name: str, container: type[Any]) -> Any:
    """A list or dict of strings, from JSON."""
    try:
        found = json.loads(str(arrays[name]))
    except (ValueError, RecursionError):
        found = None
    values = found.values() if isinstance(found, dict) else found
    if type(found) is not container or not all(isinstance(value, str) for value in values):
        raise InputError(f"the array {name!r} must hold strings")
    return found


def _estimate(arrays: _Arrays, name: str) -> Estimate | None:
    if f"{name}_rotations" not in arrays:
        return None
    t, scales = (arrays.get(f"{name}_{what}") for what in ("translations", "scales"))
    return Estimate(arrays[f"{name}_rotations"], t, scales=scales)


def _read_poses(path: Path) -> LabelledPoses:
    arrays = _load(path, "estimate")
    try:
        _require_layout(arrays, _ESTIMATE, _ESTIMATE_OPTIONAL)
        t, scales = arrays.get("translations"), arrays.get("scales")
        estimate = Estimate(arrays["rotations"], t, scales=scales)
    except CertPGOError as error:
        raise FormatError(path, None, str(error)) from None
    ids = arrays["ids"]
    if len(np.unique(ids)) != estimate.num_nodes:
        raise FormatError(path, None, f"{estimate.num_nodes} distinct integer ids expected")
    names = tuple(arrays["names"].tolist()) if "names" in arrays else ()
    more = arrays.get("times_ns"), names, arrays.get("points")
    return LabelledPoses(estimate.rotations, t, ids, *more, scales)


def _write_graph(path: Path, instance: Instance) -> None:
    graph = instance.graph
    arrays: dict[str, Any] = {
        "num_nodes": graph.num_nodes,
        "edges": graph.edges,
        "rotations": graph.rotations,
        "kappa": graph.kappa,
        "ids": instance.ids,
        "name": in_utf8(instance.name),
        "fixed": np.array(instance.fixed, dtype=np.intp),
        "options": json.dumps(dict(instance.options)),
        "notices": json.dumps(instance.notices),
    }
    if graph.has_positions:
        arrays |= {"translations": graph.translations, "tau": graph.tau}
        for name in ("arms", "assumed", "absolute"):
            if (given := getattr(graph, name)) is not None:
                arrays[name] = given
        if graph.is_point.any():
            arrays["points"] = graph.is_point
    if (couplings := graph.couplings) is not None:
        arrays["couplings"] = couplings
    if graph.has_scales:
        arrays |= {"scales": graph.scales, "free": graph.free}
    if instance.world is not None:
        arrays["world"] = instance.world
    if instance.camera:
        arrays["camera"] = np.array(instance.camera, dtype=np.float64)
    if instance.origin is not None:
        arrays["origin"] = instance.origin
    if instance.apart is not None:
        arrays |= {"apart": instance.apart, "moved_by": instance.moved_by}
    if instance.names:
        arrays["names"] = np.array(instance.names)
    for name in ("times_ns", "stated", "outliers"):
        if (given := getattr(instance, name)) is not None:
            arrays[name] = given
    if (information := graph.information) is not None:
        arrays["information"] = information.distinct
        arrays["information_index"] = information.index
        arrays["information_residual"] = information.residual or ""
        arrays["information_about"] = information.about
    if (ranges := graph.ranges) is not None:
        arrays["range_edges"] = ranges.edges
        arrays["range_distances"] = ranges.distances
        arrays["range_weights"] = ranges.weights
    for block in graph.blocks:
        if block is not ranges:
            columns = {"edges": block.edges, **block.columns}
            prefix = f"{_BLOCK}{type(block).__name__}"
            arrays |= {f"{prefix}.{name}": values for name, values in columns.items()}
    arrays |= _named("initial_", instance.initial) | _named("truth_", instance.truth)
    _save(path, "graph", arrays)


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    arrays = {"ids": keys.ids_of(estimate.num_nodes), **_named("", estimate)}
    if keys.points is not None and keys.points.any():
        arrays["points"] = keys.points
    if keys.times_ns is not None:
        arrays["times_ns"] = keys.times_ns
    if keys.names:
        arrays["names"] = np.array(keys.names)
    _save(path, "estimate", arrays)


def _named(prefix: str, estimate: Estimate | None) -> dict[str, Any]:
    if estimate is None:
        return {}
    arrays = {f"{prefix}rotations": estimate.rotations}
    if estimate.translations is not None:
        arrays[f"{prefix}translations"] = estimate.translations
    if estimate.scales is not None:
        arrays[f"{prefix}scales"] = estimate.scales
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
    holds_points=True,
    holds_ranges=True,
    holds_scales=True,
    write_graph=_write_graph,
    write_poses=_write_poses,
    holds_ids=True,
    holds_times=True,
    holds_name=lambda name: True,
)
