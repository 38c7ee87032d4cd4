"""TUM trajectories: lines ``timestamp tx ty tz qx qy qz qw``, seconds and metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.io.chunks import first_row, read_rows
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses, Labels
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    return len(first_row(head)) == 8


def _read_poses(path: Path) -> LabelledPoses:
    times, t, R = read_rows(path, 8, "timestamp tx ty tz qx qy qz qw", _convert)
    return LabelledPoses(R, t, times=times)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return rows[:, 0], rows[:, 1:4], quaternion.rotations(rows[:, 4:])


def _write_poses(path: Path, estimate: Estimate, labels: Labels) -> None:
    t = quaternion.embedded_translations(estimate.translations)
    if t is None:
        raise InputError("TUM needs translations; the estimate has rotations only")
    numbers = np.hstack([t, quaternion.to_write(estimate.rotations)])
    with path.open("w", encoding="ascii") as file:
        for time, row in zip(labels.times.tolist(), numbers.tolist(), strict=True):
            stamp = f"{time:.0f}" if time.is_integer() else repr(time)
            file.write(f"{stamp} {' '.join(map(repr, row))}\n")


FORMAT = Format(
    name="tum",
    suffixes=(".tum",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    write_poses=_write_poses,
    chart=Chart("quaternion", lambda words: words[1:]),
)
