"""The commands in this process, and what they wrote, read without the package."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from certpgo.cli import main
from reports.studies.bookkeeping.drawing import Array, Measurements, rotations
from reports.studies.bookkeeping.oracle import Poses


class Told(NamedTuple):
    """What a command said: its exit code, standard output and standard error."""

    code: int
    out: str
    complaint: str

    @property
    def json(self) -> dict[str, Any]:
        """The document on standard output."""
        found: dict[str, Any] = json.loads(self.out)
        return found

    @property
    def refusal(self) -> str | None:
        """The one line by which the command refused; None if it did not refuse."""
        lines = [line for line in self.complaint.splitlines() if not line.startswith("note: ")]
        if self.code not in (1, 2):
            return None
        return lines[-1] if lines else ""


def told(arguments: Sequence[str | Path]) -> Told:
    """Run a command."""
    out, complaint = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(complaint):
        code = main([str(argument) for argument in arguments])
    return Told(code, out.getvalue(), complaint.getvalue())


def read_poses(path: Path, of: Measurements) -> Poses | None:
    """An estimate of all nodes of a graph, in the world's frame; None if nodes are missing."""
    known = of.n - of.world
    rows = {".npz": _arrays, ".tum": _stamped}.get(path.suffix, _vertices)(path)
    R, t = np.tile(np.eye(of.d), (of.n, 1, 1)), np.zeros((of.n, of.d))
    for k, name in enumerate(of.ids[:known].tolist()):
        if name not in rows:
            return None
        turn, t[k] = rows[name]
        R[k] = np.eye(of.d) if of.points[k] else turn
    return R, t


def _vertices(path: Path) -> dict[int, tuple[Array, Array]]:
    """Of g2o and PyFG."""
    found = {}
    for line in path.read_text().splitlines():
        tag, *words = line.split()
        if not tag.startswith("VERTEX") or tag.endswith("PRIOR"):
            continue
        is_named = path.suffix == ".pyfg"
        is_point = "XY" in tag
        name = words[int(is_named and not is_point)]
        numbers = np.array(words[1 + (is_named and not is_point) :], dtype=float)
        d = 2 if tag in ("VERTEX_SE2", "VERTEX_XY") else 3
        turn = np.eye(d)
        if not is_point:
            turn = rotations(numbers[2:], 2) if d == 2 else _of_quaternion(numbers[3:])
        found[int(name.lstrip("AL"))] = turn, numbers[:d]
    return found


def _of_quaternion(q: Array) -> Array:
    return Rotation.from_quat(q).as_matrix()


def _arrays(path: Path) -> dict[int, tuple[Array, Array]]:
    with np.load(path) as found:
        t = np.zeros(found["rotations"].shape[:2])
        if "translations" in found:
            t = found["translations"]
        rows = zip(found["ids"].tolist(), found["rotations"], t, strict=True)
        return {name: (turn, at) for name, turn, at in rows}


def _stamped(path: Path) -> dict[int, tuple[Array, Array]]:
    """Of TUM, whose times are ids."""
    found = {}
    for words in map(str.split, path.read_text().splitlines()):
        if words and not words[0].startswith("#"):
            numbers = np.array(words[1:], dtype=float)
            found[int(float(words[0]))] = _of_quaternion(numbers[3:]), numbers[:3]
    return found
