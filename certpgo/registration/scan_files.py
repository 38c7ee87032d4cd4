"""Scans in files of other programs: CSV, VTK's legacy format, and KITTI's binary ones."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import FloatArray

#: How a file of VTK's legacy format begins.
VTK = b"# vtk DataFile"
_AXES = ("x", "y", "z")
_POINTS = re.compile(rb"^POINTS\s+(\d{1,30})\s+(float|double)[ \t\r]*$", re.MULTILINE)
#: A point of KITTI's Velodyne scans: x, y, z and what is reflected.
_KITTI = np.dtype("<f4"), 4


def read_csv(path: Path) -> FloatArray:
    """Columns x, y and z by the names in the first line, or the first three columns.

    Raises
    ------
    FormatError
        With the line, and what was expected there.
    """
    lines = readable(path).read_text("utf-8-sig", "replace").splitlines()
    rows = [(number, line.split(",")) for number, line in enumerate(lines, 1) if line.strip()]
    if not rows:
        raise FormatError(path, None, "no points")
    columns = [0, 1, 2]
    if not _are_numbers(rows[0][1]):
        names = [word.strip().strip('"/#').strip().lower() for word in rows[0][1]]
        if not set(_AXES) <= set(names):
            raise FormatError(path, rows[0][0], "columns called x, y and z expected, or numbers")
        columns, rows = [names.index(axis) for axis in _AXES], rows[1:]
    points = np.empty((len(rows), 3))
    for row, (number, words) in enumerate(rows):
        try:
            points[row] = [float(words[k]) for k in columns]
        except (ValueError, IndexError):
            raise FormatError(path, number, "x, y, z expected, separated by commas") from None
    return points


def _are_numbers(words: list[str]) -> bool:
    try:
        return bool([float(word) for word in words])
    except ValueError:
        return False


def read_vtk(path: Path) -> FloatArray:
    """The points of a legacy VTK file, text or binary, whatever connects them.

    Raises
    ------
    FormatError
        There is no section POINTS of floats or doubles, or it is cut off.
    """
    content = readable(path).read_bytes()
    kind = content.split(b"\n", 3)[2].strip() if content.count(b"\n") > 2 else b""
    found = _POINTS.search(content)
    if found is None or kind not in (b"ASCII", b"BINARY"):
        raise FormatError(path, None, "ASCII or BINARY, and POINTS n float or double expected")
    count, size = int(found[1]), 8 if found[2] == b"double" else 4
    rest = content[found.end() :].split(b"\n", 1)[-1]
    line = content.count(b"\n", 0, found.end()) + 1
    if kind == b"BINARY":
        data = np.frombuffer(rest[: min(3 * count, len(rest) // size) * size], f">f{size}")
    else:
        words = rest.split()[: 3 * count]
        try:
            data = np.array(list(map(float, words)))
        except ValueError:
            raise FormatError(path, line, f"{count} points expected after this line") from None
    if len(data) < 3 * count:
        raise FormatError(path, line, f"{count} points announced, {len(data) // 3} found")
    return np.asarray(data, dtype=np.float64).reshape(-1, 3)


def read_kitti(path: Path) -> FloatArray:
    """The points of a KITTI Velodyne scan: four floats each, the last is intensity.

    Raises
    ------
    FormatError
        Its size is not a whole number of points.
    """
    content = readable(path).read_bytes()
    kind, columns = _KITTI
    if len(content) % (columns * kind.itemsize):
        said = "x y z and intensity expected, four floats a point (KITTI)"
        raise FormatError(path, None, f"{said}: {len(content)} bytes are no whole number of these")
    return np.frombuffer(content, kind).reshape(-1, columns)[:, :3].astype(np.float64)
