"""KITTI poses: the 3x4 matrix [R t] row by row, 12 numbers per line, nodes in order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.keys import Keys
from certpgo.io.chunks import first_row, read_rows
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.io.formats.matrices import of_matrices
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    return len(first_row(head)) == 12


def _read_poses(path: Path) -> LabelledPoses:
    R, t = read_rows(path, 12, "12 numbers [R t] row by row", _convert)
    return LabelledPoses(R, t)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    return of_matrices(rows.reshape(-1, 3, 4))


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    t = quaternion.embedded_translations(estimate.translations)
    if t is None:
        raise InputError("KITTI needs translations; the estimate has rotations only")
    M = np.concatenate([quaternion.embedded(estimate.rotations), t[:, :, None]], axis=2)
    with path.open("w", encoding="ascii") as file:
        file.writelines(" ".join(map(repr, row)) + "\n" for row in M.reshape(-1, 12).tolist())


FORMAT = Format(
    name="kitti",
    suffixes=(".kitti",),
    recognises=_recognises,
    holds="a trajectory",
    read_poses=_read_poses,
    write_poses=_write_poses,
    chart=Chart("matrix", lambda words: words[:]),
)
