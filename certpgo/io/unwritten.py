"""What a format holds of a graph or an estimate: what is refused, and what is lost."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Instance
from certpgo.graph.keys import Keys
from certpgo.graph.kinds import Kind
from certpgo.graph.phrases import counted
from certpgo.graph.ranges import Ranges
from certpgo.io.format import Format
from certpgo.io.names import name_numbers
from certpgo.linalg.arrays import IntArray


def lost_of_graph(form: Format, whole: Instance) -> Iterator[str]:
    """What such a file does not hold of a graph that it holds, one sentence each."""
    if form.name != "npz":
        if whole.fixed and form.name != "g2o":
            yield f"{form.name} files hold no fixed nodes: they are not written"
        # Who makes a graph has its truth at hand; that of a file would be lost unseen.
        read = whole.options.get("weights", "synthetic") != "synthetic"
        if whole.truth is not None and read:
            yield f"{form.name} files hold no ground truth: it is not written"
        if whole.outliers is not None and read:
            yield f"{form.name} files do not say which measurements are outliers"
    yield from lost_of_keys(form, whole.keys.subset(np.arange(len(whole.ids[: whole.world]))))


def lost_of_keys(form: Format, keys: Keys) -> Iterator[str]:
    """What such a file does not hold of the keys, one sentence each."""
    ids, times, names = keys.ids, keys.times_ns, keys.names
    numbered = ids is not None and not np.array_equal(ids, np.arange(len(ids)))
    named = bool(names) and all(map(form.holds_name, names))
    if numbered and not keys.ids_are_times and not named:
        if not form.holds_ids:
            yield f"{form.name} files hold no node ids: they are not written"
        elif form.name == "tum" and times is not None:
            yield "a tum file holds timestamps or node ids: the ids are not written"
    if times is not None and not form.holds_times and not (form.holds_ids and keys.ids_are_times):
        yield f"{form.name} files hold no timestamps: they are not written"
    if names and not named and not _says(names, ids):
        yield f"{form.name} files hold no such names as {names[0]!r}: they are not written"


def _says(names: tuple[str, ...], ids: IntArray | None) -> bool:
    """Whether the ids are the numbers in the names."""
    numbers = name_numbers(names)
    return numbers is not None and ids is not None and np.array_equal(numbers, ids)


def refuse_unwritable(path: Path, whole: Instance, form: Format) -> None:
    """Refuse a graph that a format does not hold, by an InputError."""
    graph = whole.graph
    for block in graph.blocks:
        if not isinstance(block, Ranges):
            raise InputError(f"{path}: no format holds {type(block).__name__}")
    if graph.has_couplings:
        raise InputError(f"{path}: no format holds matrix weights or couplings")
    if graph.has_scales and not form.holds_scales:
        raise InputError(f"{path}: only .g2o and .npz files hold similarities")
    if form.name != "npz":
        _refuse_arms(path, whole, form)
        _refuse_partial(path, whole, form)
    if not form.holds_ranges:
        _refuse_ranges(path, whole)


def _refuse_partial(path: Path, whole: Instance, form: Format) -> None:
    """Refuse edges that measure a part, and are neither priors from the world nor sightings."""
    if not whole.graph.has_positions:
        return
    found = whole.measurements.are
    of_world = whole.world is None and found(Kind.POSITION, Kind.ATTITUDE).any()
    holding = ".npz" if of_world else ".g2o and .npz"
    if of_world or (form.name != "g2o" and found(Kind.ROTATION, Kind.TRANSLATION).any()):
        raise InputError(
            f"{path}: only {holding} files hold edges that measure only a rotation or a "
            "translation, except for priors and points"
        )


def _refuse_arms(path: Path, whole: Instance, form: Format) -> None:
    """Refuse what only .npz files hold: measurements from and to points on poses."""
    graph = whole.graph
    if whole.stated is not None:
        raise InputError(
            f"{path}: this graph holds fixed nodes as constraints, which only .npz files do"
        )
    if graph.arms is None:
        return
    mounted = graph.arms.any(axis=1)
    from_world = graph.edges[:, 0] == whole.world
    if form.name != "g2o" or graph.d == 2 or (mounted & ~from_world).any():
        raise InputError(f"{path}: only .npz files, and in space priors of g2o, hold arms")


def _refuse_ranges(path: Path, whole: Instance) -> None:
    """Refuse what only formats with ranges hold."""
    graph, holding = whole.graph, "only .npz and .pyfg files hold"
    if (ranges := whole.graph.ranges) is not None:
        raise InputError(f"{path}: {holding} ranges, and there are {ranges.num_edges}")
    seen = np.unique(graph.edges[whole.measurements.are(Kind.SIGHTING), 1])
    unseen = int(graph.is_point.sum() - graph.is_point[seen].sum())
    if unseen:
        said = counted(unseen, "point{s}")
        raise InputError(f"{path}: {holding} points that no pose sees, and there are {said}")
