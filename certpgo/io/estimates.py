"""Reading estimates and ground truth, and matching them with the nodes of a graph."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.errors import CertPGOError, FormatError, InputError, InputNotice, in_file, require
from certpgo.graph import Estimate, Instance
from certpgo.graph.components import restricted
from certpgo.graph.graph import require_connected
from certpgo.graph.held import displaced
from certpgo.graph.keys import Keys, in_seconds
from certpgo.graph.phrases import counted
from certpgo.graph.points import with_points
from certpgo.graph.priors import with_world_placed
from certpgo.graph.trees import compose, spanning_tree
from certpgo.io.format import (
    LabelledPoses,
    ReadOptions,
    estimate_at,
    file_of,
    format_of,
    require_translations,
)
from certpgo.io.matching import (
    MAX_DIFFERENCE,
    Match,
    Matching,
    keys_of,
    known_poses,
    match,
    nearest,
)
from certpgo.io.names import name_numbers
from certpgo.io.timestamps import (
    IGNORED,
    file_of_times,
    node_times,
    refuse_repeats,
    timed,
)
from certpgo.linalg.arrays import IntArray


def read_estimate(
    path: str | Path,
    instance: Instance | None = None,
    *,
    timestamps: str | Path | None = None,
    max_difference: float = MAX_DIFFERENCE,
    format: str | None = None,
    topic: str | None = None,
) -> Estimate:
    """Read one pose or rotation per node, with the ids, names and times of its file.

    Parameters
    ----------
    path : a g2o or PyFG (its vertices), TUM, KITTI, EuRoC (CSV), .npz, 1DSfM rotations, Bundler,
        COLMAP (images.txt, images.bin or their folder), Open3D (JSON) or GLOMAP rotations file, a
        database of rtabmap, or a bag of ROS
    instance : the graph the estimate is for, which determines the order of nodes and whether
        translations are needed. Without it the order is by ascending id, or the file's, and
        translations that are all zero are dropped.
    timestamps : meaning of the timestamps of a TUM file or bag: by default they are matched with
        the nodes' times if these are known, and otherwise are node ids if they can be;
        ``"ids"``; none, as poses are in the order of nodes (``"index"``); or a file with the time
        of each node, one per line
    max_difference : largest difference between the times of a node and of its pose, seconds
    format : name of the format, if content and suffix do not determine it
    topic : of a bag, where several have poses

    Raises
    ------
    FormatError
        With path, line and what was expected there; or it is the estimate of another graph, or of
        a part of it.
    InputError
        No path, but an object such as GTSAM's Values, which is for `certpgo.certify_values`.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> instance = helix(3, np.random.default_rng(0))
    >>> certpgo.write("truth.tum", instance.truth, instance=instance, anchor="none")
    >>> estimate = certpgo.read_estimate("truth.tum", instance)
    >>> bool(abs(estimate.translations - instance.truth.translations).max() < 1e-12)
    True
    """
    path = file_of(path)
    if instance is not None:
        require(instance, Instance, "the instance that is estimated")
    poses = _poses(path, format, topic)
    how = Matching.of(timestamps, max_difference)
    with in_file(path):
        if instance is None:
            return _in_own_order(poses, file_of_times(timestamps), how)
        of = timed(instance, timestamps)
        poses, found = _matched(poses, of, how)
        estimate = _of_nodes(of, poses, found)
    warn_of(path, _said(found, of, estimate))
    return estimate


def read_part(
    path: Path, instance: Instance, how: Matching, *, topic: str | None = None
) -> tuple[IntArray, Estimate]:
    """Read an estimate that may have poses of some nodes only.

    Parameters
    ----------
    path, instance, topic : as for `read_estimate`
    how : how poses are matched with nodes

    Returns
    -------
    nodes : (k,) that are estimated, ascending, the world among them; points that have no pose are,
        if all poses are
    estimate : of these nodes, in that order

    Raises
    ------
    FormatError
        As `read_estimate`, but for missing nodes; no node has a pose.
    """
    poses = _poses(path, None, topic)
    with in_file(path):
        poses, found = _matched(poses, instance, how)
        nodes: IntArray = np.arange(instance.graph.num_nodes)
        if not len(found.missing):
            estimate = _of_nodes(instance, poses, found)
        else:
            if instance.graph.has_positions:
                require_translations(poses)
            nodes, estimate = known_poses(poses, instance, found)
            if instance.world is not None:
                nodes = np.append(nodes, instance.world)
                part = restricted(instance, nodes, instance.name)
                estimate = with_world_placed(part.graph, part.with_world(estimate))
    whole = () if len(found.missing) else (instance, estimate)
    warn_of(path, _said(found, *whole))
    return nodes, estimate


def posed_as(estimate: Estimate, instance: Instance) -> Estimate:
    """An estimate with keys in the order of an instance's nodes; without, as it is.

    Raises
    ------
    InputError
        It is keyed as the estimate of another graph.
    """
    keys = estimate.keys
    if not keys.identify or is_in_order(estimate, instance):
        return estimate
    poses, found = _matched(LabelledPoses.of(estimate), instance, Matching())
    placed = _of_nodes(instance, poses, found)
    for notice in _said(found, instance, placed):
        warnings.warn(notice, InputNotice, stacklevel=4)
    return placed


def is_in_order(estimate: Estimate, instance: Instance) -> bool:
    """Whether an estimate has the ids of an instance's nodes, in their order."""
    ids = estimate.keys.ids
    return ids is not None and np.array_equal(ids, instance.ids)


def read_truth(
    path: str | Path,
    instance: Instance,
    *,
    timestamps: str | Path | None = None,
    max_difference: float = MAX_DIFFERENCE,
    offset: float = 0.0,
    format: str | None = None,
    topic: str | None = None,
) -> tuple[IntArray, Estimate]:
    """Read ground truth, possibly of some nodes only, and of more than the graph has.

    Parameters
    ----------
    path : a file of poses as for `read_estimate`, a Bundler file, or an iSAM file of noise-free
        relative poses, which are integrated along a spanning tree from the smallest id; or
        positions alone, ``timestamp x y z`` or such columns, which then are points in the keys
    instance : the graph it is for; other poses are ignored
    timestamps, max_difference : as for `read_estimate`
    offset : seconds added to the truth's timestamps
    format : name of the format, if content and suffix do not determine it
    topic : of a bag, where several have poses

    Returns
    -------
    nodes : (k,) nodes with truth, ascending
    truth : their k poses, in that order

    Raises
    ------
    FormatError
        With path, line and what was expected there.
    """
    how, path = Matching.of(timestamps, max_difference, offset), Path(path)
    of = timed(instance, timestamps)
    nodes, estimate, found = matched_truth(path, of, how, format=format, topic=topic)
    if not found.is_plain:
        warn_of(path, [truth_in_words(found, instance)])
    return nodes, estimate


def truth_in_words(found: Match, instance: Instance) -> str:
    """How many of an instance's poses have truth, and how they were matched with it."""
    known = np.intersect1d(found.known, instance.poses)
    said = f"truth of {len(known)} of {counted(len(instance.poses), 'pose{s}')}, {found.in_words}"
    if found.unused:
        said += f"; {counted(found.unused, 'other pose{s}')} not used"
    return "; ".join([said, *found.notices])


def matched_truth(
    path: Path, of: Instance, how: Matching, *, format: str | None = None, topic: str | None = None
) -> tuple[IntArray, Estimate, Match]:
    """As `read_truth`, with the match instead of a warning."""
    poses = true_poses(path, format=format, topic=topic)
    with in_file(path):
        return truth_among(poses, of, how)


def true_poses(path: Path, *, format: str | None = None, topic: str | None = None) -> LabelledPoses:
    """The poses of a file of ground truth, of whatever nodes."""
    form = format_of(path, format, topic)
    if form.read_poses is not None:
        return form.read_poses(path)
    if form.read_graph is not None:
        bare = ReadOptions(ignore_information=True, ignore_variances=True)
        return _integrated(form.read_graph(path, bare))
    raise FormatError(path, None, f"{form.name} files hold {form.holds}, no truth")


def _integrated(instance: Instance) -> LabelledPoses:
    """Poses relative to the node of smallest id, from noise-free relative poses.

    A breadth-first tree has short chains, hence little accumulated rounding.
    """
    graph = instance.graph
    require_connected(graph)
    poses = compose(graph, spanning_tree(graph))
    R, t, times = poses.rotations, poses.translations, instance.times_ns
    return LabelledPoses(R, t, ids=instance.ids, times_ns=times)


def truth_among(
    poses: LabelledPoses, instance: Instance, how: Matching
) -> tuple[IntArray, Estimate, Match]:
    """The nodes of an instance that have one of these poses, ascending, their poses, and how."""
    if poses.in_space is not None and instance.graph.d == 3:
        poses = poses.in_space
    poses = _fitting(poses, instance)
    if poses.unturned and not instance.graph.has_positions:
        raise InputError("positions alone, but the graph measures rotations alone")
    found = match(poses, instance, how)
    nodes, estimate = known_poses(poses, instance, found)
    if poses.unturned:
        keys = replace(estimate.keys, points=np.ones(len(nodes), dtype=bool))
        estimate = estimate.keyed(keys)
    return nodes, estimate, found


def warn_of(path: Path, notices: Iterable[str]) -> None:
    """Give notices about a file to the caller of who reads it."""
    for notice in notices:
        warnings.warn(f"{path}: {notice}", InputNotice, stacklevel=3)


def _said(
    found: Match, instance: Instance | None = None, estimate: Estimate | None = None
) -> Iterator[str]:
    """Notices about an estimate, and about one of all of an instance's nodes."""
    yield from found.notices
    if found.off:
        yield f"{counted(len(found.known), 'pose{s}')} {found.in_words}"
    if found.by == "time" and found.unused:
        yield f"{counted(found.unused, 'pose{s}')} at times without a node ignored"
    if instance is not None and estimate is not None and (moved := displaced(instance, estimate)):
        yield moved


def _poses(path: Path, name: str | None, topic: str | None) -> LabelledPoses:
    form = format_of(path, name, topic)
    if form.read_poses is None:
        raise FormatError(path, None, f"{form.name} files hold {form.holds}, no estimate")
    poses = form.read_poses(path)
    if poses.unturned:
        said = "positions alone are no estimate: they are read as ground truth (--truth)"
        raise FormatError(path, None, said)
    return poses


def _of_nodes(instance: Instance, poses: LabelledPoses, found: Match) -> Estimate:
    """The poses of all of an instance's nodes; points without a pose are placed."""
    if len(found.missing):
        raise InputError(_incomplete(instance, found))
    graph, nodes = instance.graph, found.expected
    estimate = estimate_at(poses, found.place[nodes], graph.has_positions)
    n = len(found.place)
    if len(nodes) < n and graph.has_positions:
        estimate = with_points(graph, estimate, nodes).subset(np.arange(n))
    keys = keys_of(poses, instance, found, np.arange(n))
    return with_world_placed(graph, instance.with_world(estimate.keyed(keys)))


def _matched(
    poses: LabelledPoses, instance: Instance, how: Matching
) -> tuple[LabelledPoses, Match]:
    """Poses that fit a graph, and which are of its nodes: all must be of some node."""
    poses = _fitting(poses, instance)
    found = match(poses, instance, how)
    if found.foreign:
        raise InputError(
            f"estimate of another graph: {found.foreign} is not in the graph "
            f"({found.unused} of {len(poses.rotations)} are not)"
        )
    return poses, found


def _incomplete(instance: Instance, found: Match) -> str:
    count = f"{len(found.missing)} of the graph's {len(found.expected)} nodes"
    if found.lacking:
        return f"{found.lacking} ({count} have none)"
    return f"the estimate lacks {instance.named(int(found.missing[0]))} ({count})"


def _in_own_order(poses: LabelledPoses, times: Path | None, how: Matching) -> Estimate:
    """The poses by ascending id, or in the file's order; with a file of times, those alone."""
    keys = poses.keys
    if poses.names:
        keys = replace(keys, ids=name_numbers(poses.names) if poses.ids is None else poses.ids)
    elif how.timestamps == "index" and poses.times_ns is not None:
        keys = replace(keys, ids=None, times_ns=None)
    elif how.timestamps == "ids" and keys.ids_are_times:
        keys = replace(keys, times_ns=None)
    elif poses.times_ns is not None:
        refuse_repeats(poses.times_ns, IGNORED)
    t = poses.translations
    if t is not None and not t.any():
        t = None
    try:
        estimate = Estimate(poses.rotations, t, keys, poses.scales)
    except CertPGOError as error:
        raise InputError(str(error)) from None
    if keys.ids is not None:
        estimate = estimate.subset(np.argsort(keys.ids))
    return estimate if times is None else _at_times(estimate, times, how)


def _at_times(estimate: Estimate, path: Path, how: Matching) -> Estimate:
    """The poses nearest to the times in a file; where poses have no times, these are theirs."""
    times = estimate.keys.times_ns
    known = node_times(path, *([estimate.num_nodes] if times is None else []))
    if times is None:
        return estimate.keyed(replace(estimate.keys, times_ns=known))
    place = nearest(known, times, how.max_difference)
    if (place < 0).any():
        time = in_seconds(int(known[np.argmin(place)]))
        said = f"no pose of its own within {how.max_difference:g} s of {time} s in {path}"
        raise InputError(said)
    return estimate.subset(place).keyed(Keys(times_ns=known))


def _fitting(poses: LabelledPoses, instance: Instance) -> LabelledPoses:
    """Poses for a graph: in its dimension, and without points if it has none.

    Planar poses embedded at z = 0 become 2D.
    """
    d, graph = instance.graph.d, instance.graph
    if not graph.is_point.any():
        poses = poses.without_points()
    R, t = poses.rotations, poses.translations
    if R.shape[-1] == d:
        return poses
    planar = d == 2 and not R[:, 2, :2].any() and not R[:, :2, 2].any() and (R[:, 2, 2] > 0.0).all()
    if not planar or (t is not None and t[:, 2].any()):
        said = "" if poses.in_space is None else ": four numbers a line are id x y yaw"
        raise InputError(f"{R.shape[-1]}D poses, but the graph is {d}D{said}")
    return replace(poses, rotations=R[:, :2, :2], translations=None if t is None else t[:, :2])
