"""iSAM text files.

    EDGE2 i j x y theta [6 numbers], or ODOMETRY
    LANDMARK i point x y [3 numbers]
    POINT3 i point x y z [6 numbers]
    EDGE3 i j x y z roll pitch yaw [21 numbers]

R = Rz(yaw) Ry(pitch) Rx(roll). The information is the upper triangle, row by row, in the order of
the pose's numbers; its rotational part refers to roll, pitch and yaw
(``rotation_information="rpy"``), for small angles the tangent space. In 2D g2o's order. Points are
numbered apart from poses. Some programs write square roots or covariances in place of information,
which nothing in a file tells.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from certpgo.io.build_graph import instance_from_lines
from certpgo.io.dialect import Dialect, Tag, first_tags, rpy_poses
from certpgo.io.format import Format

_VARIANT = "EDGE2, EDGE3 or ODOMETRY expected; iSAM's older {} lines are not supported"

DIALECT = Dialect(
    name="iSAM",
    tags={
        b"EDGE2": Tag("edge", 2, 3),
        b"EDGE3": Tag("edge", 3, 6),
        b"ODOMETRY": Tag("edge", 2, 3),
        b"LANDMARK": Tag("sighting", 2, 2, "landmarks", apart=True),
        b"POINT3": Tag("sighting", 3, 3, "landmarks", apart=True),
    },
    poses=rpy_poses,
    refused={b"EDGE": _VARIANT.format("EDGE")},
    rotation_information="rpy",
)


def _recognises(path: Path, head: bytes) -> bool:
    tags = first_tags(head)
    known = bool(tags & (DIALECT.tags.keys() | DIALECT.refused.keys()))
    # TORO's edges have the same tags, but its files have vertices or the suffix .graph.
    return known and path.suffix != ".graph" and not tags & {b"VERTEX2", b"VERTEX3"}


FORMAT = Format(
    name="isam",
    suffixes=(),
    recognises=_recognises,
    holds="measurements",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
)
