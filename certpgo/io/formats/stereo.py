"""Points seen by a stereo camera, as in GTSAM's examples.

    camera point uL uR v X Y Z

The columns of a point in the left and the right image and its row, pixels; X Y Z, where that is in
the camera's frame, is computed again. The calibration is in a file of the same folder and name,
with ``calibration`` in place of ``stereo_factors``: fx fy skew u0 v0 baseline, pixels and metres.

Depth is fx b / (uL - uR), and half a pixel of disparity changes it by 0.5 depth^2 / (fx b): with 2
cm of other errors tau = (0.02 + 0.5 depth^2 / (fx b))^-2.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.graph import Instance
from certpgo.graph.phrases import counted
from certpgo.io.chunks import first_row, read_rows, whole
from certpgo.io.format import Format, ReadOptions
from certpgo.io.sightings import graph_of_sightings, seen_twice
from certpgo.linalg.arrays import FloatArray

_NAME, _CALIBRATION = "stereo_factors", "calibration"
#: Disparity above which and depth below which a sighting is used, pixels and metres.
LEAST_DISPARITY, FARTHEST = 1.0, 40.0
#: Errors of a position: a part that does not depend on depth, metres, and of disparity, pixels.
NEAR_ERROR, DISPARITY_ERROR = 0.02, 0.5


def _recognises(path: Path, head: bytes) -> bool:
    row = first_row(head)
    if len(row) != 8 or not (row[0].is_integer() and row[1].is_integer()):
        return False
    _, _, left, right, _, _, _, Z = row
    # Of a trajectory, whose lines are as long, the last four numbers are a unit quaternion.
    return left > right and Z > 1.0


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    if options.skip_landmarks:
        raise FormatError(path, None, "there are sightings of landmarks alone, which are skipped")
    fx, fy, _, u0, v0, baseline = _calibration(path)
    rows = read_rows(path, 8, "camera point uL uR v X Y Z", _convert)
    pairs, pixels = rows[0].astype(np.intp), rows[1]
    disparity = pixels[:, 0] - pixels[:, 1]
    with np.errstate(divide="ignore"):
        depth = fx * baseline / disparity
    used = (disparity > LEAST_DISPARITY) & (depth < FARTHEST)
    used[used] = seen_twice(pairs[used, 1])
    if not used.any():
        raise FormatError(path, None, "no point is near enough and seen twice")
    pairs, pixels, z = pairs[used], pixels[used], depth[used]
    where = np.stack([(pixels[:, 0] - u0) / fx * z, (pixels[:, 2] - v0) / fy * z, z], axis=1)
    tau = (NEAR_ERROR + DISPARITY_ERROR * z**2 / (fx * baseline)) ** -2
    if options.ignore_information:
        tau = np.ones(len(z))
    graph, ids, moved_by = graph_of_sightings(pairs, where, tau)
    points = counted(graph.num_nodes - len(graph.pose_nodes), "point{s}")
    seen = counted(len(z), "sighting{s}")
    notices = [f"{points}, {seen}; point k has the id k + {moved_by}"]
    if len(used) > len(z):
        left_out = counted(int(np.sum(~used)), "sighting{s}")
        notices.append(
            f"{left_out} left out: disparity up to {LEAST_DISPARITY:g} pixel, farther than "
            f"{FARTHEST:g} m, or of points seen once"
        )
    return Instance(
        path.stem,
        graph,
        ids,
        source=str(path),
        options={"weights_are": "disparities"},
        notices=tuple(notices),
        apart=graph.is_point,
        moved_by=moved_by,
    )


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    pairs = whole(rows[:, :2])
    if (pairs < 0.0).any():
        raise InputError("cameras and points are numbered from 0")
    return pairs, rows[:, 2:5]


def _calibration(path: Path) -> list[float]:
    beside = path.with_name(path.name.replace(_NAME, _CALIBRATION))
    expected = "a calibration, fx fy skew u0 v0 baseline"
    if beside == path:
        said = f"{_NAME!r} expected in the file's name, as {_CALIBRATION!r} in that of {expected}"
        raise FormatError(path, None, said)
    if not beside.is_file():
        raise FormatError(beside, None, f"no such file: {expected}, for {path.name}")
    numbers = first_row(beside.read_bytes())
    if len(numbers) != 6 or not (numbers[0] > 0.0 and numbers[1] > 0.0 and numbers[5] > 0.0):
        raise FormatError(beside, 1, f"{expected}, expected")
    return list(numbers)


FORMAT = Format(
    name="stereo",
    suffixes=(),
    recognises=_recognises,
    holds="points seen by a stereo camera",
    read_graph=_read_graph,
)
