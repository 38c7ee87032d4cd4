"""g2o's other tags of poses, of cameras: VERTEX_SE3:EXPMAP and EDGE_SE3:EXPMAP.

    VERTEX_SE3:EXPMAP id x y z qx qy qz qw [numbers of the camera]
    EDGE_SE3:EXPMAP i j x y z qx qy qz qw [21 numbers]

g2o has these poses world to camera, and measures T_j T_i^-1, but writes and reads the inverse of
both (g2o/types/sba/types_six_dof_expmap.cpp): in a file they are camera to world, and T_i T_j^-1 is
our measurement. The information has rotation before translation, and weighs a residual in the
world's frame, which depends on where the world is: it is used for weights alone.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from certpgo.io.build_graph import instance_from_lines, poses_from_lines
from certpgo.io.dialect import Dialect, Tag, first_tags, quaternion_poses
from certpgo.io.exact.information import ROW_MAJOR_3D, InformationLayout
from certpgo.io.format import Chart, Format

_ROTATION_FIRST = InformationLayout(
    tuple(
        tuple(ROW_MAJOR_3D.positions[(i + 3) % 6][(j + 3) % 6] for j in range(6)) for i in range(6)
    )
)
_VERTEX, _EDGE = b"VERTEX_SE3:EXPMAP", b"EDGE_SE3:EXPMAP"
_READ = "measurement{s} whose information is about the world's frame: used for kappa and tau alone"

DIALECT = Dialect(
    name="g2o (EXPMAP)",
    tags={
        _VERTEX: Tag("pose", 3, 7, loose=True),
        _EDGE: Tag("edge", 3, 7, _READ),
        b"FIX": Tag("fix"),
    },
    poses=quaternion_poses,
    layouts={3: _ROTATION_FIRST},
    isotropic=True,
)


def _recognises(path: Path, head: bytes) -> bool:
    return bool(first_tags(head) & {_VERTEX, _EDGE})


def _pose_words(words: list[bytes]) -> list[bytes]:
    return words[2:9] if words[0] == _VERTEX else []


FORMAT = Format(
    name="expmap",
    suffixes=(),
    recognises=_recognises,
    holds="poses and measurements",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
    read_poses=partial(poses_from_lines, DIALECT),
    chart=Chart("quaternion", _pose_words),
)
