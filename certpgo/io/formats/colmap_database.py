"""COLMAP's database.db: relative rotations of pairs of images, from their verified matches.

    images               image_id, name
    two_view_geometries  pair_id, rows (inliers), config, qvec, tvec (from COLMAP 3.10 on)

A pair_id is 2147483647 i + j for images i < j. qvec (w x y z) and tvec, doubles, map the camera of
i to that of j: x_j = R x_i + t. Our R_ij and R_i are the transposes. kappa is the number of
inliers. COLMAP stores the pose only if it is told to; otherwise it is missing, or the identity.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance, RotationGraph
from certpgo.graph.phrases import counted
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, ReadOptions
from certpgo.io.nodes import distinct
from certpgo.io.sqlite import MAGIC, Kind, columns_of, found_rows, kinds_of, numbers_of
from certpgo.linalg.arrays import numbered

_PROGRAM = "COLMAP"
_IMAGES: dict[str, Kind] = {"image_id": "integers", "name": "texts"}
_GEOMETRIES: dict[str, Kind] = {
    "pair_id": "integers",
    "rows": "integers",
    "config": "integers",
    "qvec": "anything",
    "tvec": "anything",
}
_MAX_IMAGES = 2**31 - 1
#: Configurations without a geometry: undefined, degenerate, a watermark, several at once.
_NO_GEOMETRY = (0, 1, 7, 8)
_IDENTITY = (1.0, 0.0, 0.0, 0.0)
_NOT_STORED = "pair{s} without a stored relative pose left out"
_HOW = (
    "no pair of images has a relative pose; COLMAP stores them if it matches, or verifies, with "
    "--TwoViewGeometry.compute_relative_pose 1"
)


def _recognises(path: Path, head: bytes) -> bool:
    if not head.startswith(MAGIC):
        return False
    try:
        return "two_view_geometries" in kinds_of(path, _PROGRAM)
    except FormatError:
        return path.suffix == ".db"


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    names = dict(found_rows(path, "images", _IMAGES, _PROGRAM))
    columns = columns_of(path, "two_view_geometries", _PROGRAM)
    if "rows" in columns and "qvec" not in columns:
        raise FormatError(path, None, f"two_view_geometries: no column qvec: {_HOW}")
    geometries = found_rows(path, "two_view_geometries", _GEOMETRIES, _PROGRAM)
    pairs, inliers, q = [], [], []
    left_out: Counter[str] = Counter()
    for pair, count, config, qvec, tvec in sorted(geometries, key=lambda row: row[0]):
        i, j = divmod(pair, _MAX_IMAGES)
        place = f"two_view_geometries: images {i} and {j}"
        if i not in names or j not in names:
            raise FormatError(path, None, f"{place}: images of the database expected")
        if count < 0:
            raise FormatError(path, None, f"{place}: rows: a number of inliers, not {count}")
        if config in _NO_GEOMETRY or not count:
            left_out["pair{s} without a verified geometry left out"] += 1
            continue
        turn = numbers_of(path, f"{place}: qvec", qvec, 4, "<f8")
        step = numbers_of(path, f"{place}: tvec", tvec, 3, "<f8")
        if turn is None or step is None or (tuple(turn) == _IDENTITY and not step.any()):
            left_out[_NOT_STORED] += 1
            continue
        if not turn.any():
            raise FormatError(path, None, f"{place}: qvec: a quaternion expected, not zero")
        pairs.append((i, j))
        inliers.append(count)
        q.append(turn[[1, 2, 3, 0]])
    if not pairs:
        raise FormatError(path, None, _HOW)
    edges = np.array(pairs, dtype=np.intp)
    ids = distinct(edges.ravel())
    R = np.swapaxes(quaternion.rotations(np.array(q)), 1, 2)
    notices = [counted(count, what) for what, count in left_out.items()]
    if len(names) > len(ids):
        notices.append(counted(len(names) - len(ids), "image{s} in no pair left out"))
    return Instance(
        name=path.stem,
        graph=RotationGraph(len(ids), numbered(ids, edges), R, np.array(inliers, dtype=np.float64)),
        ids=ids,
        source=str(path),
        options={"weights": "are numbers of inliers", "information": "none"},
        notices=("translation directions are ignored", *notices),
        names=tuple(names[k] for k in ids.tolist()),
    )


FORMAT = Format(
    name="colmap-database",
    suffixes=(".db",),
    recognises=_recognises,
    holds="relative rotations",
    read_graph=_read_graph,
)
