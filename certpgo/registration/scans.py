"""Scans, which are point clouds in the frames of their sensors, and where they were taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError
from certpgo.graph import Estimate
from certpgo.io import read_estimate
from certpgo.io.exact import quaternion
from certpgo.io.pipes import readable
from certpgo.io.surfaces import is_ply, read_surface
from certpgo.linalg.arrays import FloatArray, frozen_floats
from certpgo.registration.scan_files import VTK, read_csv, read_kitti, read_vtk

#: NumPy's type for PCD's letter and size.
PCD_TYPES = {(k, s): f"<{k.lower()}{s}" for k in "IUF" for s in (1, 2, 4, 8)}


@dataclass(frozen=True, eq=False)
class Scan:
    """A point cloud as it was read.

    Attributes
    ----------
    name : of its file, by which a ``.conf`` file finds it
    points : (n, 3), metres, in the sensor's frame
    colours : (n, 3) of 8 bits, or None
    """

    name: str
    points: FloatArray
    colours: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_floats(self.points))
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise InputError(f"{self.name}: points must be (n, 3), not {self.points.shape}")
        if not np.isfinite(self.points).all():
            raise InputError(f"{self.name}: points must be finite")


def read_scan(path: str | Path) -> Scan:
    """Read a PLY, PCD, VTK, CSV, KITTI (``.bin``) or XYZ file; most are known by their content.

    An XYZ file has a point on each line, before any other numbers. Points that are not finite, with
    which scanners mark what they did not see, are left out.

    Raises
    ------
    FormatError
        The file does not follow its format, with the line; or it has no points.
    InputError
        The file cannot be read.
    """
    path = Path(path)
    try:
        if is_ply(path):
            surface = read_surface(path)
            return Scan(path.name, surface.points, surface.colours)
        with readable(path).open("rb") as file:
            head = file.read(4096)
        points = _reader_of(path, head)(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    seen = np.isfinite(points).all(axis=1)
    if not seen.any():
        raise FormatError(path, None, "no points")
    return Scan(path.name, points[seen])


def _reader_of(path: Path, head: bytes) -> Callable[[Path], FloatArray]:
    """What reads the points of a file that begins like this."""
    if head.startswith(VTK):
        return read_vtk
    if any(line.startswith(b"VERSION") for line in head.split(b"\n")[:3]):
        return _read_pcd
    if path.suffix == ".bin":
        return read_kitti
    first = next((line for line in head.splitlines() if line.strip()), b"")
    by_blanks = b"," not in first and len(first.split()) >= 3
    is_csv = first.count(b",") >= 2 or (path.suffix == ".csv" and not by_blanks)
    return read_csv if is_csv else _read_xyz


def _read_xyz(path: Path) -> FloatArray:
    """The first three numbers of each line that is not blank or a comment."""
    raw = readable(path).read_bytes().split(b"\n")
    kept = [k for k, line in enumerate(raw) if line.strip() and not line.lstrip().startswith(b"#")]
    if not kept:
        raise FormatError(path, None, "no points")
    lines = [raw[k] for k in kept]
    columns = len(lines[0].split())
    if columns < 3:
        raise FormatError(path, kept[0] + 1, "x y z expected")
    try:
        return _numbers(path, lines, columns, "x y z", 1)[:, :3]
    except FormatError as error:
        line = kept[(error.line or 1) - 1] + 1
        model = "" if line == kept[0] + 1 else f", as on line {kept[0] + 1}"
        expected = f"{columns} numbers expected, x y z first{model}"
        raise FormatError(path, line, expected) from None


def _read_pcd(path: Path) -> FloatArray:
    """The points of a PCD file: text, or binary without compression."""
    with readable(path).open("rb") as file:
        said: dict[str, list[str]] = {}
        line = 0
        while "DATA" not in said:
            raw, line = file.readline(), line + 1
            if not raw:
                raise FormatError(path, None, "the PCD header has no DATA")
            words = raw.decode("ascii", "replace").partition("#")[0].split()
            if words:
                said[words[0]] = words[1:]
        try:
            names, count = said["FIELDS"], int(said["POINTS"][0])
            times = list(map(int, said.get("COUNT", ["1"] * len(names))))
            kinds = zip(said["TYPE"], map(int, said["SIZE"]), strict=True)
            types = [PCD_TYPES[kind] for kind in kinds]
            record = np.dtype([(n, t, (c,)) for n, t, c in zip(names, types, times, strict=True)])
            axes = [sum(times[: names.index(axis)]) for axis in "xyz"]
            if count < 0 or min(times) < 1:
                raise ValueError("counts of at least 1")
        except (KeyError, ValueError, IndexError, TypeError) as error:
            what = "FIELDS with x y z, SIZE, TYPE, COUNT and POINTS expected"
            raise FormatError(path, line, f"a PCD header: {what} ({error})") from None
        if said["DATA"] == ["ascii"]:
            lines = file.read().split(b"\n")[:count]
            rows = _numbers(path, lines, sum(times), " ".join(names), line + 1)
            if len(rows) < count:
                raise FormatError(path, line + len(rows), f"{count} points announced")
            return rows[:, axes]
        if said["DATA"] != ["binary"]:
            shown = " ".join(said["DATA"])
            raise FormatError(path, line, f"DATA ascii or binary expected, not {shown}")
        content = file.read()[: count * record.itemsize]
    if (found := len(content) // record.itemsize) < count:
        raise FormatError(path, None, f"{count} points announced, {found} found")
    table = np.frombuffer(content, record)
    return np.stack([table[axis][:, 0].astype(np.float64) for axis in "xyz"], axis=1)


def _numbers(path: Path, lines: list[bytes], columns: int, expected: str, first: int) -> FloatArray:
    """A table (n, columns) of lines, the first of which has that number in the file."""
    words = [line.split() for line in lines]
    try:
        table = np.array(words, dtype=np.float64)
        if table.shape == (len(lines), columns):
            return table
    except ValueError:
        pass
    for number, row in enumerate(words, first):
        try:
            if len(list(map(float, row))) == columns:
                continue
        except ValueError:
            pass
        raise FormatError(path, number, f"{expected} expected")
    return np.empty((0, columns))


def read_initial(path: str | Path, names: list[str]) -> Estimate:
    """Where scans were taken: from Stanford's ``.conf``, or a trajectory with a pose for each.

    Parameters
    ----------
    names : of the scans; a ``.conf`` file is searched for them, a trajectory is in their order

    Raises
    ------
    FormatError
        The file does not follow its format, with the line.
    InputError
        It has no pose for a scan, or another number of poses.
    """
    path = Path(path)
    if path.suffix == ".conf":
        return _read_conf(path, names)
    estimate = read_estimate(path)
    if estimate.num_nodes != len(names) or estimate.translations is None or estimate.d != 3:
        raise InputError(
            f"{path}: {len(names)} poses expected, one for each scan, not {estimate.num_nodes}"
        )
    return estimate


def _read_conf(path: Path, names: list[str]) -> Estimate:
    """Lines ``bmesh name tx ty tz qx qy qz qw``: p_world = R(q)^-1 p + t."""
    found: dict[str, FloatArray] = {}
    try:
        text = readable(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        if words[:1] == [b"bmesh"]:
            expected = "bmesh NAME tx ty tz qx qy qz qw"
            row = _numbers(path, [b" ".join(words[2:])], 7, expected, number)[0]
            if not (np.isfinite(row).all() and row[3:].any()):
                raise FormatError(path, number, f"{expected} expected")
            found[words[1].decode("ascii", "replace")] = row
    for name in names:
        if name not in found:
            raise InputError(f"{path}: no line bmesh {name}")
    rows = np.array([found[name] for name in names])
    return Estimate(np.swapaxes(quaternion.rotations(rows[:, 3:]), 1, 2), rows[:, :3])
