"""Covariances as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement
from pathlib import Path

from certpgo.io.csv_files import Cell, write_csv
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: Rows and columns of the covariance of a node, by their number.
AXES = {
    1: ("theta",),
    3: ("x", "y", "theta"),
    6: ("x", "y", "z", "rx", "ry", "rz"),
}
ROTATION_AXES = ("rx", "ry", "rz")


def write_covariances(
    path: str | Path,
    covariances: FloatArray,
    ids: IntArray,
    points: BoolArray,
    *,
    rotations: bool = False,
) -> None:
    """Write the upper triangles of nodes' covariances, a line each, with their ids.

    The first line names rows and columns: x_x, x_y, ... in metres and radians.

    Parameters
    ----------
    covariances : (n, b, b), see `certpgo.Marginals`
    ids : (n,) of the nodes
    points : (n,) which are points, whose lines have nothing in the columns of rotations
    rotations : whether b = 3 are rotations in space, not poses in the plane

    Raises
    ------
    InputError
        The file cannot be written.
    """
    axes = ROTATION_AXES if rotations and covariances.shape[1] == 3 else AXES[covariances.shape[1]]
    pairs = list(combinations_with_replacement(range(len(axes)), 2))

    def rows() -> Iterator[list[Cell]]:
        for node, C, is_point in zip(ids.tolist(), covariances, points, strict=True):
            b = len(axes) if not is_point else 2 if len(axes) == 3 else 3
            yield [node, *(float(C[a, c]) if c < b else None for a, c in pairs)]

    write_csv(Path(path), ["id", *(f"{axes[a]}_{axes[c]}" for a, c in pairs)], rows())
