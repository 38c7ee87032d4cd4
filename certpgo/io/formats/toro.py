"""TORO and hog-man ``.graph`` files.

    VERTEX2 id x y theta                    VERTEX3 id x y z roll pitch yaw
    EDGE2 i j x y theta [Ixx Ixy Iyy Itt Ixt Iyt]
    EDGE3 i j x y z roll pitch yaw [21 numbers, upper triangle row by row]

VERTEX and EDGE are older names of VERTEX2 and EDGE2. R = Rz(yaw) Ry(pitch) Rx(roll).
EQUIV (known correspondences) and BR (laser) lines are skipped.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from certpgo.io.build_graph import instance_from_lines, poses_from_lines
from certpgo.io.dialect import Dialect, Tag, first_tags, rpy_poses
from certpgo.io.exact.information import ROW_MAJOR_3D, TORO_2D
from certpgo.io.format import Format

DIALECT = Dialect(
    name="TORO",
    tags={
        b"VERTEX2": Tag("pose", 2, 3),
        b"EDGE2": Tag("edge", 2, 3),
        b"VERTEX": Tag("pose", 2, 3),
        b"EDGE": Tag("edge", 2, 3),
        b"VERTEX3": Tag("pose", 3, 6),
        b"EDGE3": Tag("edge", 3, 6),
        b"EQUIV": Tag("skip", what="equivalences of nodes"),
        b"EQUIV2": Tag("skip", what="equivalences of nodes"),
        b"EQUIV3": Tag("skip", what="equivalences of nodes"),
        b"BR": Tag("skip", what="laser observations"),
    },
    layouts={2: TORO_2D, 3: ROW_MAJOR_3D},
    poses=rpy_poses,
    residual="g2o",  # as of the same data in a g2o file
)


def _recognises(path: Path, head: bytes) -> bool:
    tags = first_tags(head)
    # iSAM has EDGE2 and EDGE3 too; vertices or the suffix distinguish TORO.
    shared = {b"EDGE2", b"EDGE3"}
    return bool(tags & (DIALECT.tags.keys() - shared)) or (
        path.suffix == ".graph" and bool(tags & shared)
    )


FORMAT = Format(
    name="toro",
    suffixes=(".graph",),
    recognises=_recognises,
    holds="poses and measurements",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
    read_poses=partial(poses_from_lines, DIALECT),
)
