"""Poses as 4x4 matrices [R t; 0 1], row by row on each line, after an id in GTSAM's examples.

Also NumPy's arrays of such matrices, as KISS-ICP writes them: (n, 4, 4), or (n, 3, 4) of [R t].
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError, in_file
from certpgo.io.chunks import first_row, read_rows, whole
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.linalg.arrays import FloatArray

#: How NumPy's arrays begin.
_MAGIC = b"\x93NUMPY"


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith(_MAGIC) or len(first_row(head)) in (16, 17)


def _read_poses(path: Path) -> LabelledPoses:
    with path.open("rb") as file:
        head = file.read(1 << 12)
    if head.startswith(_MAGIC):
        return _of_array(path)
    if len(first_row(head)) == 16:
        R, t = read_rows(path, 16, "16 numbers [R t; 0 1] row by row", _poses)
        return LabelledPoses(R, t)
    ids, R, t = read_rows(path, 17, "an id and 16 numbers [R t; 0 1] row by row", _convert)
    return LabelledPoses(R, t, ids=ids.astype(np.intp))


def _of_array(path: Path) -> LabelledPoses:
    try:
        M = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise FormatError(path, None, f"no array of numbers: {error}") from None
    if M.dtype.kind != "f" or M.ndim != 3 or M.shape[1:] not in ((4, 4), (3, 4)) or not len(M):
        found = f"{M.shape} of {M.dtype}"
        raise FormatError(path, None, f"poses (n, 4, 4) or (n, 3, 4) expected, not {found}")
    with in_file(path):
        if not np.isfinite(M).all():
            raise InputError("poses of finite numbers expected")
        return LabelledPoses(*(_poses(M) if M.shape[1] == 4 else of_matrices(M)))


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return whole(rows[:, :1])[:, 0], *_poses(rows[:, 1:])


def _poses(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    M = rows.reshape(-1, 4, 4)
    if (M[:, 3] != np.array([0.0, 0.0, 0.0, 1.0])).any():
        raise InputError("the last four numbers of a pose must be 0 0 0 1")
    return of_matrices(M[:, :3])


def of_matrices(M: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations and translations of matrices [R t], (n, 3, 4)."""
    return quaternion.rotations(quaternion.from_matrices(M[:, :, :3])), M[:, :, 3].astype(float)


FORMAT = Format(
    name="matrices",
    suffixes=(".npy",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    chart=Chart("matrix", lambda words: words[-16:-4]),
)
