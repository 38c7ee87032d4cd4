"""Planar trajectories: lines ``id x y yaw``, metres and radians.

Ceres Solver's example examples/slam/pose_graph_2d writes them (poses_optimized.txt).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.io.chunks import first_row, lines_of_rows, read_rows, whole
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.io.nodes import refuse_duplicates
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    row = first_row(head)
    return len(row) == 4 and row[0].is_integer()


def _read_poses(path: Path) -> LabelledPoses:
    numbers, t, R = read_rows(path, 4, "id x y yaw", _convert)
    ids = numbers.astype(np.intp)
    refuse_duplicates(path, ids, lines_of_rows(path))
    return LabelledPoses(R, t, ids=ids)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return whole(rows[:, 0]), rows[:, 1:3], quaternion.planar_rotations(rows[:, 3])


FORMAT = Format(
    name="planar",
    suffixes=(),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    chart=Chart("quaternion", lambda words: words[1:], planar_angle=True),
)
