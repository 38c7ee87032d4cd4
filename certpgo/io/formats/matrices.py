"""Poses of GTSAM's examples: ``id`` and the 4x4 matrix [R t; 0 1] row by row on each line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.io.chunks import first_row, read_rows, whole
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    return len(first_row(head)) == 17


def _read_poses(path: Path) -> LabelledPoses:
    ids, R, t = read_rows(path, 17, "an id and 16 numbers [R t; 0 1] row by row", _convert)
    return LabelledPoses(R, t, ids=ids.astype(np.intp))


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    M = rows[:, 1:].reshape(-1, 4, 4)
    if (M[:, 3] != np.array([0.0, 0.0, 0.0, 1.0])).any():
        raise InputError("the last four numbers of a pose must be 0 0 0 1")
    R = quaternion.rotations(quaternion.from_matrices(M[:, :3, :3]))
    return whole(rows[:, :1])[:, 0], R, M[:, :3, 3]


FORMAT = Format(
    name="matrices",
    suffixes=(),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    chart=Chart("matrix", lambda words: words[1:13]),
)
