"""Trajectories with named columns, or rows separated by commas: EuRoC, TUM-VI, rtabmap.

The columns are those that a first line names, ``#`` and units in brackets aside:

    #timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], ...
    #timestamp x y z qx qy qz qw id
    num,t,x,y,z,qx,qy,qz,qw

The first is of the ground truth of EuRoC (state_groundtruth_estimate0/data.csv; Burri et al., The
EuRoC micro aerial vehicle datasets, IJRR 2016) and TUM-VI, the second of rtabmap
(corelib/src/Graph.cpp, format 11), the third of MCD. Without names, rows separated by commas have
EuRoC's first eight columns, as evo reads them (evo/tools/file_interface.py). Timestamps are
seconds, or whole nanoseconds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.io.chunks import floats_of_rows, is_number, lines_of_rows, parsed, text_lines
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses
from certpgo.io.nodes import refuse_duplicates
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import FloatArray, IntArray

_UNIT = re.compile(r"\[[^\]]*\]|\([^)]*\)")
_EUROC = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_NAMES = {"timestamp": "t", "time": "t", "stamp": "t", "num": "id", "index": "id"}
#: Such as q_RS_w, p_RS_R_x, q.w, tx and pos_x.
_COORDINATE = re.compile(
    r"(?:q|quat|rot)[\w.]*?[_.]?(?P<turn>[wxyz])|(?:p|t|pos|position)[\w.]*?[_.]?(?P<step>[xyz])"
)


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
        text = _UNIT.sub("", first.decode("utf-8", "replace")).lstrip("# ").lower()
        words = text.split(",") if "," in text else text.split()
        names = tuple(_named(word.strip()) for word in words)
        if set(_POSE) <= set(names):
            return cls(names, separator, first)
        rows = [line for line in lines if not line.startswith(b"#")]
        numbers = rows[0].split(b",") if rows else []
        if len(numbers) < len(_EUROC) or not all(map(is_number, numbers)):
            return None
        unnamed = ("",) * (len(numbers) - len(_EUROC))
        return cls((*_EUROC, *unnamed), b",")

    @property
    def expected(self) -> str:
        """What a row has, for messages."""
        said = ", ".join(name or "..." for name in self.names[:9])
        return f"{len(self.names)} columns, {said}{', ...' * (len(self.names) > 9)}"

    def rows(self, text: bytes) -> tuple[FloatArray, IntArray, IntArray]:
        """Poses (k, 7), times as `decimals` (k, 2), and ids (k,); 0 where there are none."""
        rows = (line.strip() for line in text.split(b"\n"))
        words = [self._words(row) for row in rows if row and row != self.header]
        if not {len(row) for row in words} <= {len(self.names)}:
            found = next(len(row) for row in words if len(row) != len(self.names))
            raise InputError(f"{self.expected} expected; {found} found")
        place = [self.names.index(name) for name in _POSE]
        poses = floats_of_rows([[row[k] for k in place] for row in words], 7, self.expected)
        quaternion.rotations(poses[:, 3:])  # which refuses zeros
        return poses, self._numbers(words, "t"), self._numbers(words, "id")

    def _words(self, line: bytes) -> list[bytes]:
        words = [word.strip() for word in line.split(self.separator)]
        return words[:-1] if len(words) == len(self.names) + 1 and not words[-1] else words

    def _numbers(self, rows: list[list[bytes]], name: str) -> IntArray:
        if name not in self.names:
            return np.zeros((len(rows), 2), dtype=np.int64)
        return decimals([row[self.names.index(name)] for row in rows])


def _named(word: str) -> str:
    """What a column holds by its name: t, id, x, ..., qw; or the name itself."""
    if found := _COORDINATE.fullmatch(word):
        return f"q{found['turn']}" if found["turn"] else str(found["step"])
    return _NAMES.get(word, word)


def _recognises(path: Path, head: bytes) -> bool:
    return b"\0" not in head and _Layout.of(head) is not None


def _read_poses(path: Path) -> LabelledPoses:
    first = islice((line for _, line in text_lines(path) if line.strip()), 2)
    layout = _Layout.of(b"\n".join(first))
    if layout is None:
        raise FormatError(path, None, f"columns expected: {', '.join(('timestamp', *_POSE))}")
    parts = list(parsed(path, layout.rows))
    poses, stamps, numbers = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if not len(poses):
        raise FormatError(path, None, f"no rows of {layout.expected}")
    R, t = quaternion.rotations(poses[:, 3:]), poses[:, :3]
    times, ids = None, None
    try:
        if "t" in layout.names:
            times, ids = times_and_ids(stamps)
    except InputError as error:
        raise FormatError(path, None, str(error)) from None
    if "id" in layout.names:
        if numbers[:, 1].any():
            raise FormatError(path, None, "whole numbers expected as ids")
        ids = numbers[:, 0]
        lines = lines_of_rows(path)
        refuse_duplicates(path, ids, lines[len(lines) - len(ids) :])
    return LabelledPoses(R, t, ids=ids, times_ns=times)


FORMAT = Format(
    name="columns",
    suffixes=(".csv",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
)
