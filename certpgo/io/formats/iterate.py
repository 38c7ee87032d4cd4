"""Lifted iterates of Burer-Monteiro solvers, as written by DPGO; rounded to poses when read.

The first line has the rank r and the number of columns (d + 1) n; r rows follow, with d rotation
columns and a translation column for each pose.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph.relaxed_point import Lift, rounded
from certpgo.io.chunks import text_lines
from certpgo.io.format import Format, LabelledPoses
from certpgo.linalg.arrays import FloatArray

#: Largest entry of Y_i^T Y_i - I of an iterate with few digits.
FEW_DIGITS = 1e-2


def _recognises(path: Path, head: bytes) -> bool:
    lines = head.split(b"\n", 2)
    first = lines[0].split()
    if len(lines) < 2 or len(first) != 2 or not all(word.isdigit() for word in first):
        return False
    # The head may end within the second line.
    return len(lines[1].split()) > 12 or int(first[1]) <= 12


def _read_poses(path: Path) -> LabelledPoses:
    Y = _matrix(path)
    for d in (3, 2):
        if Y.size and Y.shape[1] % (d + 1) == 0 and len(Y) >= d:
            poses = np.moveaxis(Y.reshape(len(Y), -1, d + 1), 1, 0)
            lifted, moved = poses[:, :, :d], poses[:, :, d]
            with np.errstate(over="ignore", invalid="ignore"):  # if not rotations
                defect = np.abs(np.swapaxes(lifted, 1, 2) @ lifted - np.eye(d)).max()
            if defect <= FEW_DIGITS:
                estimate = rounded(Lift(lifted, moved))
                return LabelledPoses(estimate.rotations, estimate.translations)
    raise FormatError(path, None, "expected columns of 2D or 3D poses, with orthonormal rotations")


def _matrix(path: Path) -> FloatArray:
    """The (r, (d + 1) n) numbers."""
    lines = text_lines(path)
    rank, columns = (int(number) for number in _numbers(path, *next(lines), 2))
    rows = [(number, line) for number, line in lines if line.strip()]
    if len(rows) != rank:
        what = f"expected {rank} rows after the first line, not {len(rows)}"
        raise FormatError(path, None, what)
    return np.array([_numbers(path, *row, columns) for row in rows])


def _numbers(path: Path, number: int, line: bytes, count: int) -> list[float]:
    words = line.split()
    if len(words) != count:
        raise FormatError(path, number, f"expected {count} numbers, not {len(words)}")
    try:
        row = [float(word) for word in words]
    except ValueError:
        raise FormatError(path, number, "expected numbers") from None
    if not np.isfinite(row).all():
        raise FormatError(path, number, "numbers must be finite")
    return row


FORMAT = Format(
    name="iterate",
    suffixes=(".iterate",),
    recognises=_recognises,
    holds="a lifted iterate",
    read_poses=_read_poses,
)
