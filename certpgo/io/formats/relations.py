"""Relations of the SLAM benchmark of Freiburg: ``time1 time2 x y z roll pitch yaw`` on each line.

True poses of the second time in the frame of the first, Unix seconds, metres and radians, of the
data sets of the Radish repository (Kümmerle et al., On measuring the accuracy of SLAM algorithms,
Autonomous Robots 27, 2009; read so by Cartographer's ground_truth/relations_text_file.cc). They
state no noise. In the plane where z, roll and pitch are all zero.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import in_file
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.io.chunks import first_row, floats_of_rows, parsed, refuse_loops, rows_of
from certpgo.io.dialect import rpy_poses
from certpgo.io.format import Format, ReadOptions
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import FloatArray, IntArray

_EXPECTED = "time1 time2 x y z roll pitch yaw"
#: Times are Unix seconds, which no coordinate is.
_EPOCH = 1e8


def _recognises(path: Path, head: bytes) -> bool:
    row = first_row(head)
    return len(row) == 8 and min(row[:2]) > _EPOCH


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    parts = zip(*parsed(path, _rows, options.progress), strict=True)
    stamps, poses = (np.concatenate(part) for part in parts)
    with in_file(path):
        times, _ = times_and_ids(stamps.reshape(-1, 2))
        at, edges = np.unique(times, return_inverse=True)
        edges = edges.reshape(-1, 2)
        refuse_loops(edges)
    d = 3 if poses[:, 2:5].any() else 2
    R, t, _ = rpy_poses(d, poses if d == 3 else poses[:, [0, 1, 5]])
    ones = np.ones(len(edges))
    return Instance(
        name=path.stem,
        graph=PoseGraph(RotationGraph(len(at), edges, R, ones), t, ones),
        ids=np.arange(len(at)),
        times_ns=at,
        source=str(path),
        options={"information": "none"},
        notices=("the file has relations without noise: all weights are 1",),
    )


def _rows(text: bytes) -> tuple[IntArray, FloatArray]:
    """Both times (k, 2, 2) as `decimals`, and six numbers (k, 6)."""
    rows = rows_of(text)
    numbers = floats_of_rows(rows, 8, _EXPECTED)
    return decimals([word for row in rows for word in row[:2]]).reshape(-1, 2, 2), numbers[:, 2:]


FORMAT = Format(
    name="relations",
    suffixes=(".relations",),
    recognises=_recognises,
    holds="relations between times",
    read_graph=_read_graph,
)
