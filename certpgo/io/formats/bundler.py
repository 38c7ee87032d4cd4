"""Bundler's ``bundle.out``: only the cameras, as used for 1DSfM's ground truth.

A camera maps world to camera with the axes x right, y up, z backward; with D = diag(1, -1, -1),
D R and D t have 1DSfM's axes (x right, y down, z forward). A camera's number is its id; one whose
focal length is zero was not reconstructed.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, in_file
from certpgo.io.chunks import text_lines
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses

_HEADER = b"# Bundle file"
_CAMERA_LINES = (
    "the focal length and two distortion coefficients",
    *(["three numbers of R"] * 3),
    "three numbers of t",
)
_D = np.diag([1.0, -1.0, -1.0])


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith(_HEADER)


def _read_poses(path: Path) -> LabelledPoses:
    lines = islice(text_lines(path), 1, None)
    cameras = int(_numbers(path, lines, 2, "numbers of cameras and points")[0])
    rows = [
        _numbers(path, lines, 3, expected) for _ in range(cameras) for expected in _CAMERA_LINES
    ]
    table = np.array(rows).reshape(-1, 5, 3)
    ids = np.flatnonzero(table[:, 0, 0] != 0.0)
    if not len(ids):
        raise FormatError(path, None, "no reconstructed camera")
    with in_file(path):
        R = _D @ quaternion.rotations(quaternion.from_matrices(table[ids, 1:4]))
    t = table[ids, 4] @ _D
    return LabelledPoses(
        np.swapaxes(R, -1, -2), -np.einsum("nji,nj->ni", R, t), ids=ids.astype(np.intp)
    )


def _numbers(
    path: Path, lines: Iterator[tuple[int, bytes]], count: int, expected: str
) -> list[float]:
    line, text = next(lines, (None, b""))
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise FormatError(path, line, f"{expected} expected")
    return numbers


FORMAT = Format(
    name="bundler",
    suffixes=(".out",),
    recognises=_recognises,
    holds="a reconstruction",
    read_poses=_read_poses,
)
