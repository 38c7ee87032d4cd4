"""OpenMVG's sfm_data.json: the poses of a reconstruction.

    {"sfm_data_version": "0.3",
     "views": [{"value": {"ptr_wrapper": {"data": {"filename", "id_pose"}}}}, ...],
     "extrinsics": [{"key": id_pose, "value": {"rotation": [[3] * 3], "center": [3]}}, ...]}

The rotation maps world to camera, so that our R_i is its transpose; the centre is in the world. A
pose has the name of the first view that has it. Intrinsics and points are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses
from certpgo.io.json_files import as_id, read_json

_VERSION = b'"sfm_data_version"'


def _recognises(path: Path, head: bytes) -> bool:
    return head.lstrip().startswith(b"{") and _VERSION in head


def _read_poses(path: Path) -> LabelledPoses:
    content = read_json(path)
    try:
        extrinsics = content["extrinsics"]
        poses = {as_id(entry["key"]): entry["value"] for entry in extrinsics}
        named = _names(content["views"])
        parts = [[*pose["rotation"], pose["center"]] for pose in poses.values()]
        table = np.array(parts, dtype=np.float64).reshape(len(poses), 12)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        expected = "extrinsics with key, and rotation (3 x 3) and center (3), and views expected"
        raise FormatError(path, None, f"{expected} ({error!r})") from None
    if not len(table) or len(table) < len(extrinsics) or not np.isfinite(table).all():
        raise FormatError(path, None, "extrinsics: at least one expected, finite, a key each")
    try:
        q = quaternion.from_matrices(table[:, :9].reshape(-1, 3, 3))
    except InputError as error:
        raise FormatError(path, None, f"extrinsics: {error} expected as rotation") from None
    R = np.swapaxes(quaternion.rotations(q), 1, 2)
    names = tuple(named.get(key, "") for key in poses)
    known = "" not in names and len(set(names)) == len(names)
    ids = np.array(list(poses), dtype=np.intp)
    return LabelledPoses(R, table[:, 9:], ids=ids, names=names if known else ())


def _names(views: list[Any]) -> dict[int, str]:
    """The file names of views by the number of their pose."""
    found: dict[int, str] = {}
    for view in views:
        data = view["value"]["ptr_wrapper"]["data"]
        found.setdefault(as_id(data["id_pose"]), str(data["filename"]))
    return found


FORMAT = Format(
    name="openmvg",
    suffixes=(),
    recognises=_recognises,
    holds="a reconstruction",
    read_poses=_read_poses,
)
