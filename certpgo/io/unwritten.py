"""What a format holds of a graph or an estimate: what is refused, and what is lost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.graph import Instance
from certpgo.graph.keys import Keys
from certpgo.graph.kinds import NODES, Kind
from certpgo.graph.phrases import counted
from certpgo.graph.ranges import Ranges
from certpgo.io.format import Format
from certpgo.io.names import name_numbers
from certpgo.linalg.arrays import IntArray


def unheld(form: Format, whole: Instance) -> Iterator[str]:
    """Why such a file does not hold a graph, one sentence each; none if it does."""
    graph, are = whole.graph, whole.measurements.are
    for block in graph.blocks:
        if block.kind is Kind.INERTIAL:
            yield "no format holds preintegrated measurements"
        elif not isinstance(block, Ranges) and form.name != "npz":
            yield f"only .npz files hold {type(block).__name__}"
    for kind in np.unique(graph.nodes[graph.is_other]).tolist():
        yield f"no format holds {NODES[kind].format(s='s')}"
    if graph.has_couplings and form.name != "npz":
        yield "only .npz files hold matrix weights or couplings"
    if graph.has_scales and not form.holds_scales:
        yield "only .g2o and .npz files hold similarities"
    if form.name != "npz":
        if whole.stated is not None:
            yield "this graph holds fixed nodes as constraints, which only .npz files do"
        if graph.arms is not None:
            others = graph.arms.any(axis=1) & (graph.edges[:, 0] != whole.world)
            if form.name != "g2o" or graph.d == 2 or others.any():
                yield "only .npz files, and in space priors of g2o, hold arms"
        of_world = whole.world is None and are(Kind.POSITION, Kind.ATTITUDE).any()
        partial = form.name != "g2o" and are(Kind.ROTATION, Kind.TRANSLATION).any()
        if graph.has_positions and (of_world or partial):
            holding = "only .npz" if of_world else "only .g2o and .npz"
            measured = "edges that measure only a rotation or a translation"
            yield f"{holding} files hold {measured}, except for priors and points"
    if not form.holds_ranges:
        holding = "only .npz and .pyfg files hold"
        if graph.ranges is not None:
            yield f"{holding} ranges, and there are {graph.ranges.num_edges}"
        seen = np.unique(graph.edges[are(Kind.SIGHTING), 1])
        if unseen := int(graph.is_point.sum() - graph.is_point[seen].sum()):
            said = counted(unseen, "point{s}")
            yield f"{holding} points that no pose sees, and there are {said}"


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
