"""Scaled bundle adjustment: points in the frames of cameras whose depths have no common unit.

XM's list of observations (Han and Yang, "Building Rome with convex optimization", RSS 2025):
landmark.bin, a matrix of doubles, column by column, after its numbers of rows and columns, both
little-endian uint32. Each row is

    camera point x y z weight ...

and what follows, such as a colour, is not read. Cameras and points are numbered from 1, and x y z
is where the point is in the camera's frame: a ray times a depth, in a unit that each camera has for
itself. What is minimised is

    sum weight |A_i x + t_i - p|^2,    A_i = s_i R_i.

XM holds one camera at the scale 1, which shrinks all others where depths are noisy. Here none is
held: the unit is the root mean square of all scales.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance
from certpgo.graph.phrases import counted
from certpgo.io.compressed import opened, uncompressed_name
from certpgo.io.format import Format, ReadOptions
from certpgo.io.sightings import graph_of_sightings, seen_twice
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

_NAME = "landmark.bin"
_SIZE = struct.Struct("<II")
#: Numbers of an observation, and sightings that a camera needs for its seven unknowns.
_COLUMNS, _NEEDED = 6, 3
_EXPECTED = "XM's observations, rows of camera, point, x, y, z and weight"


def _recognises(path: Path, head: bytes) -> bool:
    return uncompressed_name(path).name == _NAME


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    if options.skip_landmarks:
        raise FormatError(path, None, "there are sightings of landmarks alone, which are skipped")
    pairs, where, tau = _observations(path)
    if options.ignore_information:
        tau = np.ones(len(tau))
    used = _used(pairs)
    if not used.any():
        raise FormatError(path, None, f"no camera sees {_NEEDED} points that others see, too")
    graph, ids, moved_by = graph_of_sightings(pairs[used], where[used], tau[used], free=True)
    points, seen = int(graph.is_point.sum()), int(used.sum())
    notices = [
        f"{counted(points, 'point{s}')}, {counted(seen, 'sighting{s}')}; "
        f"point k has the id k + {moved_by}"
    ]
    if seen < len(used):
        left_out = counted(len(used) - seen, "sighting{s}")
        notices.append(
            f"{left_out} left out: of points seen once, or by cameras that see fewer than "
            f"{_NEEDED} others"
        )
    return Instance(
        path.stem,
        graph,
        ids,
        source=str(path),
        notices=tuple(notices),
        apart=graph.is_point,
        moved_by=moved_by,
    )


def _used(pairs: IntArray) -> BoolArray:
    """(k,) which sightings determine something: what is left of the others goes, too."""
    used = np.ones(len(pairs), dtype=bool)
    while used.any():
        cameras, points = pairs[used].T
        kept = seen_twice(points)
        _, which = np.unique(cameras, return_inverse=True)
        kept &= np.bincount(which, kept)[which] >= _NEEDED
        if kept.all():
            break
        used[used] = kept
    return used


def _observations(path: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    """Cameras and points (k, 2), positions (k, 3) and weights (k,)."""
    with opened(path) as file:
        data = file.read()
    if len(data) < _SIZE.size:
        raise FormatError(path, None, f"{_EXPECTED} expected; this ends early")
    rows, columns = _SIZE.unpack_from(data)
    if columns < _COLUMNS or not rows:
        raise FormatError(path, None, f"{_EXPECTED} expected, not {rows} rows of {columns} numbers")
    stated = _SIZE.size + 8 * columns * rows
    if len(data) != stated:
        said = f"{rows} rows of {columns} numbers take {stated} bytes, not {len(data)}"
        raise FormatError(path, None, f"{_EXPECTED} expected: {said}")
    table = np.frombuffer(data, "<f8", offset=_SIZE.size).reshape(columns, rows)[:_COLUMNS].T
    whole = (table[:, :2] == np.floor(table[:, :2])) & (table[:, :2] >= 1.0)
    whole &= table[:, :2] < 2.0**31
    for bad, expected in (
        (~np.isfinite(table).all(axis=1), "finite numbers"),
        (~whole.all(axis=1), "cameras and points numbered from 1"),
        (table[:, 5] <= 0.0, "weights above 0"),
    ):
        if bad.any():
            k = int(np.argmax(bad))
            given = " ".join(f"{x:g}" for x in table[k])
            raise FormatError(path, None, f"row {k + 1}: {expected} expected, not {given}")
    return table[:, :2].astype(np.intp), table[:, 2:5].astype(np.float64), table[:, 5].copy()


FORMAT = Format(
    name="xm",
    suffixes=(),
    recognises=_recognises,
    holds="points seen by cameras of unknown scale",
    read_graph=_read_graph,
)
