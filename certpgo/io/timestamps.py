"""Timestamps and node ids: what the numbers in front of a TUM file's poses mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.io.format import LabelledPoses
from certpgo.io.plural import counted
from certpgo.linalg.arrays import FloatArray, IntArray

# Larger integers have no double of their own.
_EXACT = 2**53
#: Seconds by which a pose's time may differ from its node's.
NEAR = 0.01
#: Timestamps this near to integers may be ids, rounded by text.
_ROUNDED = 1e-6


def with_node_ids(
    poses: LabelledPoses, ids: IntArray | None, timestamps: str | Path
) -> LabelledPoses:
    """The poses under the ids of their nodes, or under none where order is what counts.

    Parameters
    ----------
    poses : as read; ids of their own win
    ids : (n,) of the graph, if there is one
    timestamps : ``"ids"``, ``"index"``, or a file with one timestamp a node. Timestamps that are
        no ids are as good as an index where they ascend and are as many as the nodes; of those in
        a file, each node takes the nearest pose, up to `NEAR` and half the time between nodes.

    Raises
    ------
    InputError
        Timestamps are neither ids nor as many as nodes, a node has no pose near its time, or a
        timestamp occurs twice.
    """
    times = poses.times
    if poses.ids is not None or times is None or timestamps == "index":
        return poses
    _refuse_repeats(times)
    if timestamps != "ids":
        return _nearest(poses, times, ids, Path(timestamps))
    near = np.rint(times)
    whole = bool((np.abs(times - near) <= _ROUNDED).all() and np.abs(near).max() < _EXACT)
    if whole and (ids is None or np.isin(near, ids).any()):
        return replace(poses, ids=near.astype(np.intp))
    if ids is None:
        return poses
    if len(times) == len(ids) and (np.diff(times) > 0.0).all():
        said = "the timestamps are no node ids: poses and nodes are matched in ascending order"
        return replace(poses, notices=(said,))
    raise InputError(
        f"the timestamps are no node ids, and {counted(len(times), 'pose{s}')} cannot be matched "
        f"in order with {counted(len(ids), 'node{s}')}; give the nodes' times in a file"
    )


def _nearest(
    poses: LabelledPoses, times: FloatArray, ids: IntArray | None, path: Path
) -> LabelledPoses:
    """For each node, the pose nearest to its time in the file."""
    known = _from_file(path)
    nodes = np.arange(len(known)) if ids is None else ids
    _check_length(known, len(nodes), path)
    _refuse_repeats(known)
    order = np.argsort(times)
    halfway = 0.5 * (times[order][1:] + times[order][:-1])
    place = order[np.searchsorted(halfway, known)]
    off = np.abs(times[place] - known)
    allowed = min(NEAR, 0.5 * float(np.diff(np.sort(known)).min(initial=np.inf)))
    if (off > allowed).any() or len(np.unique(place)) < len(place):
        node = int(np.argmax(off))
        raise InputError(
            f"node {nodes[node]}, at {float(known[node])!r} in {path}, has no pose of its own "
            f"within {allowed:.2g} s"
        )
    said = []
    if off.any():
        said.append(f"poses matched with the nearest timestamps, off by at most {off.max():.1g} s")
    if len(times) > len(known):
        left = counted(len(times) - len(known), "pose{s}")
        said.append(f"{left} at times of no node left out")
    t = poses.translations
    return replace(
        poses,
        rotations=poses.rotations[place],
        translations=None if t is None else t[place],
        ids=np.asarray(nodes, dtype=np.intp),
        times=times[place],
        notices=tuple(said),
    )


def node_times(ids: IntArray, timestamps: str | Path) -> FloatArray:
    """Timestamps (n,) in seconds of the nodes: their ids, their numbers, or from a file.

    Raises
    ------
    InputError
        An id is too large, or the file has not one line a node.
    """
    if timestamps == "index":
        return np.arange(len(ids), dtype=np.float64)
    if timestamps == "ids":
        if len(ids) and np.abs(ids).max() >= _EXACT:
            raise InputError("ids beyond 2^53 cannot be timestamps; take 'index'")
        return ids.astype(np.float64)
    times = _from_file(Path(timestamps))
    _check_length(times, len(ids), Path(timestamps))
    return times


def _refuse_repeats(times: FloatArray) -> None:
    ordered = np.sort(times)
    repeats = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(repeats):
        raise InputError(f"timestamp {float(repeats[0])!r} appears twice")


def _check_length(times: FloatArray, n: int, path: Path) -> None:
    if len(times) != n:
        raise InputError(
            f"{path}: {counted(len(times), 'timestamp{s}')} for {counted(n, 'node{s}')}"
        )


def _from_file(path: Path) -> FloatArray:
    """The first number of each line that is not blank or a comment."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FormatError(path, None, "a text file of timestamps expected") from None
    times = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        try:
            times += [float(words[0])] if words else []
        except ValueError:
            raise FormatError(path, number, "a timestamp in seconds expected") from None
    return np.array(times)
