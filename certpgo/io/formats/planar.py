"""Planar trajectories: lines ``id x y yaw`` or ``timestamp x y yaw``, metres and radians.

Ceres Solver's example examples/slam/pose_graph_2d writes them (poses_optimized.txt). As the truth
of a graph in space such lines are positions alone, ``timestamp x y z``.
"""

from __future__ import annotations

from pathlib import Path

from certpgo.errors import in_file
from certpgo.io.chunks import first_row, lines_of_rows, read_rows
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.io.nodes import refuse_duplicates
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import FloatArray, IntArray


def _recognises(path: Path, head: bytes) -> bool:
    return len(first_row(head)) == 4


def _read_poses(path: Path) -> LabelledPoses:
    stamps, at = read_rows(path, 4, "id x y yaw", _convert, first=decimals)
    times: IntArray | None
    with in_file(path):
        times, ids = times_and_ids(stamps)
        R = quaternion.planar_rotations(at[:, 2])
    in_space = LabelledPoses.positions(at, ids, times)
    if not stamps[:, 1].any():
        times, ids = None, stamps[:, 0]
        refuse_duplicates(path, ids, lines_of_rows(path))
    return LabelledPoses(R, at[:, :2], ids=ids, times_ns=times, in_space=in_space)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return (rows[:, 1:],)


FORMAT = Format(
    name="planar",
    suffixes=(),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    chart=Chart("quaternion", lambda words: words[1:], planar_angle=True),
)
