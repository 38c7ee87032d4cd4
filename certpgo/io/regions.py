"""Regions of nodes as CSV."""

from __future__ import annotations

from pathlib import Path

from certpgo.io.csv_files import Cell, write_csv
from certpgo.linalg.arrays import FloatArray, IntArray


def write_regions(
    path: str | Path,
    metres: FloatArray | None,
    degrees: FloatArray,
    ids: IntArray,
    world: int | None = None,
) -> None:
    """Write how far each node can be, a line each, with its id.

    The columns are id, metres and degrees; metres are empty of rotations alone, degrees where there
    is no limit.

    Parameters
    ----------
    metres, degrees : (n,) as of `certpgo.ProvenDistance`
    ids : (n,) of the nodes
    world : the node that is left out, as it has no id

    Raises
    ------
    InputError
        The file cannot be written.
    """
    lengths = [None] * len(ids) if metres is None else metres.tolist()
    angles = [angle if angle < 180.0 else None for angle in degrees.tolist()]
    rows: list[list[Cell]] = [list(row) for row in zip(ids.tolist(), lengths, angles, strict=True)]
    if world is not None:
        del rows[world]
    write_csv(Path(path), ["id", "metres", "degrees"], rows)
