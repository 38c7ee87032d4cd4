"""PLY point clouds, for viewers: positions of poses and points, in colours; ASCII, metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.keys import Keys
from certpgo.io.exact import quaternion
from certpgo.io.format import Format

#: Red, green and blue of poses, and of points.
COLOURS = np.array([[0, 114, 178], [213, 94, 0]])

_HEADER = """\
ply
format ascii 1.0
comment certpgo: {poses} poses in blue, {points} points in orange, metres
element vertex {count}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
end_header
"""


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith((b"ply\n", b"ply\r\n"))


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    t = quaternion.embedded_translations(estimate.translations)
    if t is None:
        raise InputError("PLY needs translations; the estimate has rotations only")
    points = keys.is_point(len(t))
    count = int(points.sum())
    colours = COLOURS[points.astype(np.intp)]
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(_HEADER.format(poses=len(t) - count, points=count, count=len(t)))
        for place, colour in zip(t.tolist(), colours.tolist(), strict=True):
            file.write(" ".join(map(repr, [*place, *colour])) + "\n")


FORMAT = Format(
    name="ply",
    suffixes=(".ply",),
    recognises=_recognises,
    holds="a point cloud",
    write_poses=_write_poses,
    holds_points=True,
)
