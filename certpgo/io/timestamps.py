"""Timestamps and node ids of TUM files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.graph.wording import counted
from certpgo.io.format import LabelledPoses
from certpgo.linalg.arrays import FloatArray, IntArray

# Larger integers are not exact in double precision.
_EXACT = 2**53
#: Seconds by which a pose's time may differ from its node's.
NEAR = 0.01
#: Timestamps this near to integers may be ids, rounded in the text.
_ROUNDED = 1e-6


def with_node_ids(
    poses: LabelledPoses, ids: IntArray | None, timestamps: str | Path
) -> LabelledPoses:
    """The poses with the ids of their nodes, or without ids if matched by order.

    Parameters
    ----------
    poses : as read; ids of their own take precedence
    ids : (n,) of the graph, if there is one
    timestamps : ``"ids"``, ``"index"``, or a file with one timestamp per node. Timestamps that are
        not ids act as an index if they ascend and there is one per node; with a file, each node
        gets the nearest pose, within `NEAR` and half the time between nodes.

    Raises
    ------
    InputError
        Timestamps are neither ids nor one per node, a node has no pose near its time, or a
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
        notice = "the timestamps are not node ids: poses and nodes matched in ascending order"
        return replace(poses, notices=(notice,))
    raise InputError(
        f"the timestamps are not node ids, and {counted(len(times), 'pose{s}')} cannot be matched "
        f"in order with {counted(len(ids), 'node{s}')}; provide a file of the nodes' times"
    )


def _nearest(
    poses: LabelledPoses, times: FloatArray, ids: IntArray | None, path: Path
) -> LabelledPoses:
    """The pose of each node nearest to its time in the file."""
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
    notices = []
    if off.any():
        notices.append(
            f"poses matched with the nearest timestamps, off by at most {off.max():.1g} s"
        )
    if len(times) > len(known):
        unused = counted(len(times) - len(known), "pose{s}")
        notices.append(f"{unused} at times without a node ignored")
    t = poses.translations
    return replace(
        poses,
        rotations=poses.rotations[place],
        translations=None if t is None else t[place],
        ids=np.asarray(nodes, dtype=np.intp),
        times=times[place],
        notices=tuple(notices),
    )


def node_times(ids: IntArray, timestamps: str | Path) -> FloatArray:
    """Timestamps (n,) in seconds of the nodes: their ids, their numbers, or from a file."""
    if timestamps == "index":
        return np.arange(len(ids), dtype=np.float64)
    if timestamps == "ids":
        if len(ids) and np.abs(ids).max() >= _EXACT:
            raise InputError("ids beyond 2^53 cannot be timestamps; use 'index'")
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
    """The first number of each line, without blank lines and comments."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        expected = "ids, index or a file of times expected for the timestamps"
        raise FormatError(path, None, f"no such file; {expected}") from None
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
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
