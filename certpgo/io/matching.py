"""Which pose of a file is of which node: by name, time, id or order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance
from certpgo.graph.keys import NO_TIME, SECOND, Keys, in_seconds
from certpgo.graph.phrases import counted
from certpgo.io.format import LabelledPoses, estimate_at
from certpgo.io.names import named_ids
from certpgo.io.timestamps import IGNORED, refuse_repeats
from certpgo.linalg.arrays import IntArray

#: Seconds by which a pose's time may differ from its node's, as evo's default.
MAX_DIFFERENCE = 0.01


@dataclass(frozen=True)
class Matching:
    """How poses are matched with nodes.

    Attributes
    ----------
    timestamps : ``"ids"`` or ``"index"``: timestamps are node ids, or ignored; None: they are
        matched with the nodes' times where those are known, and otherwise are ids if they can be
    max_difference : largest difference of matched times, seconds
    offset : seconds added to the file's timestamps before they are matched

    Raises
    ------
    InputError
        A difference or an offset that is not finite, or a negative difference.
    """

    timestamps: str | None = None
    max_difference: float = MAX_DIFFERENCE
    offset: float = 0.0

    @classmethod
    def of(
        cls, timestamps: str | Path | None, max_difference: float, offset: float = 0.0
    ) -> Matching:
        """As chosen; a file of times is read by `timed`."""
        chosen = timestamps if timestamps in ("ids", "index") else None
        return cls(None if chosen is None else str(chosen), max_difference, offset)

    def of_truth(self, offset: float) -> Matching:
        """The same for ground truth."""
        return replace(self, offset=offset)

    def __post_init__(self) -> None:
        if not 0.0 <= self.max_difference < 1e9:
            raise InputError(f"a difference of times in seconds expected: {self.max_difference!r}")
        if not abs(self.offset) < 1e9:
            raise InputError(f"an offset of times in seconds expected: {self.offset!r}")


@dataclass(frozen=True, eq=False)
class Match:
    """The pose of each node.

    Attributes
    ----------
    place : (n,) its index among the poses, -1 for none; without the world
    expected : (k,) the nodes that the file may have poses of: no points if it has none
    unused : number of poses without a node
    by : what they were matched by: name, time, node id or order
    notices : what was assumed
    off : largest difference of times that were matched, seconds
    lacking : of the first node without a pose, what it lacks
    foreign : the first pose without a node; empty if such poses may be ignored
    """

    place: IntArray
    expected: IntArray
    unused: int
    by: str
    notices: tuple[str, ...] = ()
    off: float = 0.0
    lacking: str = ""
    foreign: str = ""

    @property
    def known(self) -> IntArray:
        """(k,) the nodes that have a pose, ascending."""
        return np.flatnonzero(self.place >= 0)

    @property
    def is_plain(self) -> bool:
        """Whether all poses were matched, by what they are called or their order."""
        return self.by != "time" and not self.notices and not self.unused

    @property
    def in_words(self) -> str:
        """What they were matched by, and how well."""
        off = f", off by at most {self.off:.1g} s" if self.off else ""
        return f"matched by {self.by}{off}"

    @property
    def missing(self) -> IntArray:
        """The nodes that are expected to have a pose, and have none."""
        return self.expected[self.place[self.expected] < 0]


def match(poses: LabelledPoses, instance: Instance, how: Matching) -> Match:
    """The pose of each node of an instance.

    Names are matched with the graph's own if it has names; times with the nodes' if they are known;
    otherwise ids, which may be whole timestamps or the numbers in names; without any, poses are in
    the order of nodes. Times that several nodes share are not used.

    Raises
    ------
    InputError
        Poses without keys and nodes differ in number, a time occurs twice, or timestamps are not
        ids where the nodes' times are not known.
    """
    names = instance.names[: instance.world]
    if poses.names and names:
        return _by_name(poses, instance)
    times = instance.times_ns if instance.keys.times_differ else None
    if poses.times_ns is not None and times is not None and how.timestamps is None:
        return _by_time(poses, poses.times_ns, instance, times, how)
    by, notices = "node id", tuple[str, ...]()
    if poses.names:
        found, notice = named_ids(poses, instance.ids[: instance.world])
        poses, notices = replace(poses, ids=found), (notice,) if notice else ()
    elif poses.times_ns is not None and (poses.ids is None or poses.keys.ids_are_times):
        if how.timestamps != "index":
            refuse_repeats(poses.times_ns, IGNORED)
        taken = poses.ids is not None and bool(np.isin(poses.ids, instance.ids).any())
        if how.timestamps == "index" or not taken:
            return _by_order(poses, instance, how)
        by = "timestamps taken for node ids"
    if poses.ids is None:
        return _by_order(poses, instance, how)
    place = places(instance.ids[: instance.world], poses.ids)
    lost = np.flatnonzero(~np.isin(poses.ids, instance.ids[: instance.world]))
    foreign = f"node {poses.ids[lost].min()}" if len(lost) else ""
    return _match(poses, instance, place, by, notices, foreign=foreign)


def known_poses(
    poses: LabelledPoses, instance: Instance, found: Match
) -> tuple[IntArray, Estimate]:
    """The nodes that have a pose, ascending, and these poses in that order.

    Raises
    ------
    InputError
        No node has one.
    """
    nodes = found.known
    if not len(nodes):
        raise InputError(f"truth of another graph: no {found.by} is in the graph")
    measured = instance.graph.has_positions and poses.translations is not None
    estimate = estimate_at(poses, found.place[nodes], measured)
    return nodes, estimate.keyed(keys_of(poses, instance, found, nodes))


def keys_of(poses: LabelledPoses, instance: Instance, found: Match, nodes: IntArray) -> Keys:
    """The keys of nodes of an instance with poses: its own, and the poses' times."""
    keys, times = instance.keys.subset(nodes), poses.times_ns
    if keys.times_ns is None and times is not None:
        place = found.place[nodes]
        keys = replace(keys, times_ns=np.where(place < 0, NO_TIME, times[place]))
    return keys


def places(ids: IntArray, given: IntArray) -> IntArray:
    """The position of each of ``ids`` in ``given`` (distinct); -1 if absent."""
    if not len(given):
        return np.full(len(ids), -1)
    order = np.argsort(given)
    found = order[np.minimum(np.searchsorted(given, ids, sorter=order), len(given) - 1)]
    return np.asarray(np.where(given[found] == ids, found, -1))


def nearest(known: IntArray, times: IntArray, allowed: float) -> IntArray:
    """The index of the time nearest to each known one, within seconds; -1 if there is none.

    A time serves the known one nearest to it alone.
    """
    order = np.argsort(times, kind="stable")
    after = np.minimum(np.searchsorted(times, known, sorter=order), len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(times[order[before]] - known) <= np.abs(times[order[after]] - known)
    place = order[np.where(nearer, before, after)]
    off = np.abs(times[place] - known)
    place = np.where(off <= round(allowed * SECOND), place, -1)
    by_distance = np.argsort(off, kind="stable")
    _, first = np.unique(place[by_distance], return_index=True)
    alone = np.zeros(len(known), dtype=bool)
    alone[by_distance[first]] = True
    return np.asarray(np.where(alone, place, -1))


def _match(
    poses: LabelledPoses,
    instance: Instance,
    place: IntArray,
    by: str,
    notices: tuple[str, ...] = (),
    **more: Any,
) -> Match:
    unused = len(poses.rotations) - int(np.sum(place >= 0))
    return Match(place, _expected(poses, instance), unused, by, notices, **more)


def _expected(poses: LabelledPoses, instance: Instance) -> IntArray:
    """The nodes that such poses are of: all but the world, and points only if the file has some."""
    n = len(instance.ids[: instance.world])
    if poses.points is not None:
        return np.arange(n)
    return np.flatnonzero(~instance.graph.is_point[:n])


def _by_name(poses: LabelledPoses, instance: Instance) -> Match:
    number = {name: k for k, name in enumerate(poses.names)}
    names = instance.names[: instance.world]
    place = np.array([number.get(name, -1) for name in names], dtype=np.intp)
    known = set(names)
    foreign = next((name for name in poses.names if name not in known), "")
    return _match(poses, instance, place, "name", foreign=foreign)


def _by_order(poses: LabelledPoses, instance: Instance, how: Matching) -> Match:
    """The poses in the order of the nodes, which they must be as many as."""
    nodes, count = _expected(poses, instance), len(poses.rotations)
    notices: tuple[str, ...] = ()
    sizes = f"{counted(count, 'pose{s}')} for the graph's {counted(len(nodes), 'node{s}')}"
    if poses.times_ns is not None and how.timestamps != "index":
        if len(nodes) != count or not (np.diff(poses.times_ns) > 0).all():
            raise InputError(
                f"the timestamps are not node ids, and {counted(count, 'pose{s}')} cannot be "
                f"matched in order with {counted(len(nodes), 'node{s}')}; provide a file of the "
                "nodes' times"
            )
        notices = ("the timestamps are not node ids: poses and nodes matched in ascending order",)
    if len(nodes) != count:
        raise InputError(sizes)
    place = np.full(len(instance.ids[: instance.world]), -1)
    place[nodes] = np.arange(count)
    return _match(poses, instance, place, "order", notices)


def _by_time(
    poses: LabelledPoses, stamps: IntArray, instance: Instance, times: IntArray, how: Matching
) -> Match:
    """The pose nearest to the time of each node."""
    nodes = np.flatnonzero(times != NO_TIME)
    given = np.flatnonzero(stamps != NO_TIME)
    shifted, known = stamps[given] + round(how.offset * SECOND), times[nodes]
    refuse_repeats(shifted, IGNORED)
    if not len(given):
        raise InputError("no poses with times")
    found = nearest(known, shifted, how.max_difference)
    matched = found >= 0
    if not matched.any():
        raise InputError(
            f"no pose is within {how.max_difference:g} s of a node: the nodes' times are "
            f"{_span(known)}, the poses' {_span(shifted)} (timestamps that are node ids: "
            "--timestamps ids)"
        )
    place = np.full(len(times), -1)
    place[nodes[matched]] = given[found[matched]]
    off = float(np.abs(shifted[found[matched]] - known[matched]).max() / SECOND)
    lacking = ""
    if not matched.all():
        node = nodes[np.argmin(matched)]
        lacking = (
            f"{instance.named(int(node))}, at {in_seconds(int(times[node]))} s, has no pose of its "
            f"own within {how.max_difference:g} s"
        )
    notices = ("the timestamps are read as nanoseconds",) if poses.keys.in_nanoseconds else ()
    return _match(poses, instance, place, "time", notices, off=off, lacking=lacking)


def _span(times: IntArray) -> str:
    return f"{in_seconds(int(times.min()))} to {in_seconds(int(times.max()))} s"
