"""Timestamps and node ids: what the numbers in front of a TUM file's poses mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.io.format import LabelledPoses
from certpgo.io.wording import counted
from certpgo.linalg.arrays import FloatArray, IntArray

# Larger integers have no double of their own.
_EXACT = 2**53


def node_ids(poses: LabelledPoses, ids: IntArray | None, timestamps: str | Path) -> IntArray | None:
    """The id of each pose, or None where the order of poses is that of nodes.

    Parameters
    ----------
    poses : as read; ids of their own win
    ids : (n,) of the graph, if there is one
    timestamps : ``"ids"``, ``"index"``, or a file with one timestamp a node

    Raises
    ------
    InputError
        A timestamp is no id, is not in the file, or occurs twice.
    """
    times = poses.times
    if poses.ids is not None or times is None or timestamps == "index":
        return poses.ids
    _refuse_repeats(times)
    if timestamps == "ids":
        if (times == np.rint(times)).all() and np.abs(times).max() < _EXACT:
            return times.astype(np.intp)
        if ids is None:
            return None
        raise InputError("the timestamps are no node ids; take them as 'index' or from a file")
    known = _from_file(Path(timestamps))
    nodes = np.arange(len(known)) if ids is None else ids
    _check_length(known, len(nodes), Path(timestamps))
    _refuse_repeats(known)
    order = np.argsort(known)
    place = np.minimum(np.searchsorted(known[order], times), len(known) - 1)
    absent = known[order][place] != times
    if absent.any():
        raise InputError(f"timestamp {float(times[np.argmax(absent)])!r} is not in {timestamps}")
    return np.asarray(nodes[order][place], dtype=np.intp)


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
    except (OSError, UnicodeDecodeError):
        raise FormatError(path, None, "a text file of timestamps expected") from None
    times = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        try:
            times += [float(words[0])] if words else []
        except ValueError:
            raise FormatError(path, number, "a timestamp in seconds expected") from None
    return np.array(times)
