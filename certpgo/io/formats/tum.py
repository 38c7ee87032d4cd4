"""TUM trajectories: lines ``timestamp tx ty tz qx qy qz qw``, seconds and metres."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certpgo.errors import InputError, in_file
from certpgo.graph import Estimate
from certpgo.graph.keys import NO_TIME, Keys, in_seconds
from certpgo.io.chunks import first_row, read_rows
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    return len(first_row(head)) == 8


def _read_poses(path: Path) -> LabelledPoses:
    expected = "timestamp tx ty tz qx qy qz qw"
    stamps, t, R = read_rows(path, 8, expected, _convert, first=decimals)
    with in_file(path):
        times, ids = times_and_ids(stamps)
    return LabelledPoses(R, t, ids=ids, times_ns=times)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return rows[:, 1:4], quaternion.unit_rotations(rows[:, 1:], range(2, 9))


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    t = quaternion.embedded_translations(estimate.translations)
    if t is None:
        raise InputError("TUM needs translations; the estimate has rotations only")
    numbers = np.hstack([t, quaternion.to_write(estimate.rotations)]).tolist()
    with path.open("w", encoding="ascii") as file:
        for stamp, row in zip(_stamps(keys, len(numbers)), numbers, strict=True):
            file.write(f"{stamp} {' '.join(map(repr, row))}\n")


def _stamps(keys: Keys, n: int) -> Iterator[str]:
    """The times in seconds; without any, the ids."""
    if keys.times_ns is None:
        yield from map(str, keys.ids_of(n).tolist())
        return
    for time in keys.times_ns.tolist():
        if time == NO_TIME:
            raise InputError("TUM needs a timestamp for each pose, and some have none")
        yield in_seconds(time)


FORMAT = Format(
    name="tum",
    suffixes=(".tum",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    write_poses=_write_poses,
    holds_ids=True,
    holds_times=True,
    chart=Chart("quaternion", lambda words: words[1:]),
)
