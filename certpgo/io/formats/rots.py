"""1DSfM's rots.txt: an id and R row by row, world to camera, 10 numbers per line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.keys import Keys
from certpgo.io.chunks import first_row, lines_of_rows, read_rows, whole
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses
from certpgo.io.nodes import refuse_duplicates
from certpgo.linalg.arrays import FloatArray


def _recognises(path: Path, head: bytes) -> bool:
    row = first_row(head)
    return len(row) == 10 and row[0].is_integer()


def _read_poses(path: Path) -> LabelledPoses:
    numbers, R = read_rows(path, 10, "an id and 9 numbers of R row by row", _convert)
    ids = numbers.astype(np.intp)
    refuse_duplicates(path, ids, lines_of_rows(path))
    return LabelledPoses(R, None, ids=ids)


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    q = quaternion.from_matrices(rows[:, 1:].reshape(-1, 3, 3))
    return whole(rows[:, 0]), np.swapaxes(quaternion.rotations(q), -1, -2)


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    M = np.swapaxes(quaternion.embedded(estimate.rotations), -1, -2).reshape(-1, 9)
    with path.open("w", encoding="ascii") as file:
        for node, row in zip(keys.ids_of(len(M)).tolist(), M.tolist(), strict=True):
            file.write(f"{node} {' '.join(map(repr, row))}\n")


FORMAT = Format(
    name="rots",
    suffixes=(".rots",),
    recognises=_recognises,
    holds="absolute rotations",
    read_poses=_read_poses,
    write_poses=_write_poses,
    chart=Chart("matrix", lambda words: words[1:], world_to_camera=True),
    holds_translations=False,
    holds_ids=True,
)
