"""Trajectories with named columns, or rows separated by commas: EuRoC, TUM-VI, Kimera, rtabmap.

The columns are those that a first line names, ``#`` and units in brackets aside:

    #timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], ...
    ns,pose_index,qx,qy,qz,qw,tx,ty,tz
    #sec,nsec,x,y,z,qx,qy,qz,qw
    #timestamp x y z qx qy qz qw id
    num,t,x,y,z,qx,qy,qz,qw
    timestamp [ns], position x [m], position y [m], position z [m], quaternion x, quaternion y, ...

The first is of the ground truth of EuRoC (state_groundtruth_estimate0/data.csv; Burri et al., The
EuRoC micro aerial vehicle datasets, IJRR 2016) and TUM-VI, the second of Kimera-Multi and DPGO, the
third of the Newer College dataset, then rtabmap's (corelib/src/Graph.cpp, format 11), MCD's and
maplab's. Without names, rows separated by commas have EuRoC's first eight columns, as evo reads
them (evo/tools/file_interface.py) and VINS-Mono writes them, with a comma at the end; or MulRan's
thirteen, a time and the matrix [R t] row by row. Columns x and y, perhaps z, without a quaternion
are positions alone, which are a truth and no estimate. Timestamps without a unit are seconds, or
whole nanoseconds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError, in_file
from certpgo.graph.keys import SECOND
from certpgo.io.chunks import floats_of_rows, is_number, lines_of_rows, parsed, text_lines
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses
from certpgo.io.formats.matrices import of_matrices
from certpgo.io.nodes import refuse_duplicates
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import FloatArray, IntArray

_UNIT = re.compile(r"[\[(]([^\])]*)[\])]")
_EUROC = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MULRAN = ("t", *(f"m{row}{column}" for row in "xyz" for column in "xyzt"))
_TURNED = {*_POSE[3:], *_MULRAN[1:]}
#: Times in two columns.
_PAIR = {"t s", "t ns"}
#: Billionths of a second in a unit of time.
_UNITS = {"s": SECOND, "sec": SECOND, "ms": 10**6, "us": 10**3, "ns": 1, "nsec": 1}
#: How names of components begin: of a vector in frames, or of a field of a message.
_FRAMES = ("", "_rs_r", "_rs", "_wb_w", "_wb", "_wi", "_ws", "_wc", "_gi")
_MESSAGES = ("", "pose.", "pose.pose.", "field.pose.", "field.pose.pose.")


def _meanings() -> dict[str, str]:
    """What a column holds, by its name in small letters: t, t in a unit, id, x, ..., qw."""
    found = dict.fromkeys(("t", "time", "stamp", "timestamp", "ts"), "t")
    found |= {f"{name}_{unit}": f"t {unit}" for name in found for unit in _UNITS}
    found |= dict.fromkeys(("sec", "secs", "seconds"), "t s")
    found |= dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), "t ns")
    found |= dict.fromkeys(("id", "num", "index", "pose_index", "pose_id", "node_id", "node"), "id")
    vectors = {"": ("position", "translation"), "q": ("orientation", "quaternion", "rotation")}
    short = {"": ("p", "t", "pos", "trans"), "q": ("q", "quat", "rot")}
    for turn, axes in (("", "xyz"), ("q", "wxyz")):
        begins = [f"{name}_" for name in (*vectors[turn], *short[turn])]
        begins += [f"{name}." for name in (*vectors[turn], *short[turn])]
        begins += [f"{short[turn][0]}{frames}_" for frames in _FRAMES]
        begins += [f"{message}{vectors[turn][0]}." for message in _MESSAGES]
        begins += ["", "p", "t"] if not turn else ["q"]
        found |= {f"{begin}{axis}": f"{turn}{axis}" for begin in begins for axis in axes}
    return found


_MEANINGS = _meanings()


@dataclass(frozen=True)
class _Layout:
    """The columns of a file.

    Attributes
    ----------
    names : of each column; those that are not used may be anything
    separator : of the words of a row; None for blanks
    header : the line that names them; empty if none does
    """

    names: tuple[str, ...]
    separator: bytes | None
    header: bytes = b""

    @classmethod
    def of(cls, head: bytes) -> _Layout | None:
        """The layout that the first line shows; None if it is another file's."""
        lines = [line.strip() for line in head.splitlines() if line.strip()]
        first = lines[0] if lines else b""
        separator = b"," if b"," in (lines[1] if len(lines) > 1 else first) else None
        text = first.decode("utf-8", "replace").lstrip("# ").lower()
        words = text.split(",") if "," in text else _UNIT.sub("", text).split()
        names = tuple(_named(word) for word in words)
        if set(_POSE if _TURNED & {*names} else "xy") <= {*names}:
            return cls(names, separator, first)
        rows = [line for line in lines if not line.startswith(b"#")]
        numbers = rows[0].removesuffix(b",").split(b",") if rows else []
        if len(numbers) < len(_EUROC) or not all(map(is_number, numbers)):
            return None
        if first is not rows[0] and len(words) == len(numbers):
            return None  # names that are not known
        if len(numbers) == len(_MULRAN) and _is_rotation(numbers[1:]):
            return cls(_MULRAN, b",")
        unnamed = ("",) * (len(numbers) - len(_EUROC))
        return cls((*_EUROC, *unnamed), b",")

    @property
    def expected(self) -> str:
        """What a row has, for messages."""
        said = ", ".join(name or "..." for name in self.names[:9])
        return f"{len(self.names)} columns, {said}{', ...' * (len(self.names) > 9)}"

    @property
    def times(self) -> set[str]:
        """The columns with times: none, one, or seconds and nanoseconds."""
        return {name for name in self.names if name.partition(" ")[0] == "t"}

    @property
    def is_turned(self) -> bool:
        """Whether there are rotations, not positions alone."""
        return bool(_TURNED & {*self.names})

    @property
    def unit(self) -> int:
        """Billionths of a second that a time is stated in; 0 if it is not said, or for a pair."""
        (name,) = self.times if len(self.times) == 1 else ("t",)
        return _UNITS[name.split()[1]] if name != "t" else 0

    @property
    def ambiguous(self) -> str:
        """That two columns have one meaning, in a sentence; else empty."""
        known = [name for name in self.names if name in (*_POSE, "id", *self.times)]
        twice = [name for name in known if known.count(name) > 1]
        if not twice and len(self.times) > 1 and self.times != _PAIR:
            twice = ["t"]
        if not twice:
            return ""
        called = {"t": "times", "id": "ids"}.get(twice[0].split()[0], twice[0])
        return f"two columns are {called}: which is meant is not known"

    def rows(self, text: bytes) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
        """Rotations, translations, times as `decimals` (k, 2), and ids (k, 2); 0 for none.

        Of positions alone the rotations are the identity.
        """
        rows = (line.strip() for line in text.split(b"\n"))
        words = [self._words(row) for row in rows if row and row != self.header]
        if not {len(row) for row in words} <= {len(self.names)}:
            found = next(len(row) for row in words if len(row) != len(self.names))
            raise InputError(f"{self.expected} expected; {found} found")
        chosen = _MULRAN[1:] if self.names == _MULRAN else _POSE
        place = [self.names.index(name) for name in chosen if name in self.names]
        used = [[row[k] for k in place] for row in words]
        poses = floats_of_rows(used, len(place), self.expected)
        if self.names == _MULRAN:
            R, poses = of_matrices(poses.reshape(-1, 3, 4))
        elif self.is_turned:
            R = quaternion.unit_rotations(poses, [k + 1 for k in place])
        else:
            R, poses = np.tile(np.eye(3), (len(poses), 1, 1)), np.pad(poses, ((0, 0), (0, 1)))
        return R, poses[:, :3], self._times(words), self._numbers(words, "id")

    def _words(self, line: bytes) -> list[bytes]:
        words = [word.strip() for word in line.split(self.separator)]
        return words[:-1] if len(words) == len(self.names) + 1 and not words[-1] else words

    def _numbers(self, rows: list[list[bytes]], name: str) -> IntArray:
        if name not in self.names:
            return np.zeros((len(rows), 2), dtype=np.int64)
        return decimals([row[self.names.index(name)] for row in rows])

    def _times(self, rows: list[list[bytes]]) -> IntArray:
        if self.times != _PAIR:
            return self._numbers(rows, next(iter(self.times), ""))
        seconds, rest = (self._numbers(rows, name) for name in ("t s", "t ns"))
        if seconds[:, 1].any() or rest[:, 1].any() or not ((rest >= 0) & (rest < SECOND)).all():
            raise InputError("whole seconds, and nanoseconds below a second, expected")
        return np.stack([seconds[:, 0], rest[:, 0]], axis=1)


def _named(word: str) -> str:
    """What a column holds by its name and unit: t, t ns, id, x, ..., qw; or the name itself."""
    unit = _UNIT.search(word)
    name = _UNIT.sub("", word).strip().replace(" ", "_")
    found = _MEANINGS.get(name, name)
    if found == "t" and unit is not None and unit[1].strip() in _UNITS:
        return f"t {unit[1].strip()}"
    return found


def _is_rotation(numbers: list[bytes]) -> bool:
    """Whether twelve numbers are [R t] row by row, of a rotation to the digits of files."""
    R = np.array([float(number) for number in numbers]).reshape(3, 4)[:, :3]
    return bool(np.abs(R @ R.T - np.eye(3)).max() < 1e-2) and np.linalg.det(R) > 0.0


def _recognises(path: Path, head: bytes) -> bool:
    return b"\0" not in head and _Layout.of(head) is not None


def _read_poses(path: Path) -> LabelledPoses:
    first = islice((line for _, line in text_lines(path) if line.strip()), 2)
    layout = _Layout.of(b"\n".join(first))
    if layout is None:
        raise FormatError(path, None, f"columns expected: {', '.join(('timestamp', *_POSE))}")
    if layout.ambiguous:
        raise FormatError(path, 1, layout.ambiguous)
    parts = list(parsed(path, layout.rows))
    R, t, stamps, numbers = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if not len(R):
        raise FormatError(path, None, f"no rows of {layout.expected}")
    times, ids = None, None
    if layout.times:
        with in_file(path):
            times, ids = times_and_ids(stamps, layout.unit)
    if "id" in layout.names:
        if numbers[:, 1].any():
            raise FormatError(path, None, "whole numbers expected as ids")
        ids = numbers[:, 0]
        lines = lines_of_rows(path)
        refuse_duplicates(path, ids, lines[len(lines) - len(ids) :])
    if not layout.is_turned:
        return LabelledPoses.positions(t, ids, times)
    return LabelledPoses(R, t, ids=ids, times_ns=times)


FORMAT = Format(
    name="columns",
    suffixes=(".csv",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
)
