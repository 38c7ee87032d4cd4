"""Points of a file and their sightings, joined to the graph of its poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph.edges import symmetric
from certpgo.io.contents import BODY, TaggedLines
from certpgo.linalg.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Landmarks:
    """All points of a file, with ids that no pose has.

    Attributes
    ----------
    ids : (p,) of the points, ascending
    pairs : (k, 2) ids of a pose and of a point that it sees
    positions : (k, d) of the point in the frame of the pose, metres
    tau : (k,) weights
    information : (k, d, d) matrices, or None where some lack it
    vertices : ids (v,) and initial positions (v, d)
    apart : ids of those that are numbered apart from poses
    moved_by : what was added to their own numbers
    """

    ids: IntArray
    pairs: IntArray
    positions: FloatArray
    tau: FloatArray
    information: FloatArray | None
    vertices: tuple[IntArray, FloatArray]
    apart: IntArray
    moved_by: int


def landmarks_of(path: Path, content: TaggedLines, poses: IntArray) -> Landmarks | None:
    """The points of a file, and their sightings in its order; None if no pose sees one.

    Points that are numbered apart from poses, as is seen where a pose has the number of a point,
    get their number plus one that makes them follow all other ids.

    Parameters
    ----------
    poses : ids of the poses, ascending; more may see points

    Raises
    ------
    FormatError
        An id is that of a pose and of a point, or a sighting is by an unknown sensor.
    """
    if not content.sightings:
        return None
    parts = content.sightings
    order = np.argsort(np.concatenate(content.sighting_lines))
    apart = np.repeat([part.apart for part in parts], [len(part.tau) for part in parts])[order]
    columns = zip(*((p.pairs, p.positions, p.tau, p.sensors) for p in parts), strict=True)
    pairs, positions, tau, sensors = (np.concatenate(column)[order] for column in columns)
    known = [part.information for part in parts if part.information is not None]
    information = np.concatenate(known)[order] if len(known) == len(parts) else None
    seeing = np.unique(np.concatenate([poses, pairs[:, 0]]))
    shared = np.unique(pairs[~apart, 1])
    both = shared[np.isin(shared, seeing)]
    if len(both):
        raise FormatError(path, None, f"node {both[0]} is a pose and a point")
    moved_by = 0
    if np.isin(pairs[apart, 1], np.concatenate([seeing, shared])).any():
        moved_by = max(0, int(max(seeing[-1], shared.max(initial=0))) + 1)
        low, high = int(pairs[apart, 1].min()), int(pairs[apart, 1].max())
        if low < 0 or high + moved_by >= 2**62:
            raise FormatError(path, None, f"numbers of points from 0 expected, not {low} to {high}")
        pairs = pairs.copy()
        pairs[apart, 1] += moved_by
    ids = np.unique(pairs[:, 1])
    vertices = _vertices(content, ids, positions.shape[1])
    positions, information = _in_body_frame(path, content, sensors, positions, information)
    return Landmarks(
        ids, pairs, positions, tau, information, vertices, np.unique(pairs[apart, 1]), moved_by
    )


def _vertices(content: TaggedLines, ids: IntArray, d: int) -> tuple[IntArray, FloatArray]:
    if not content.points:
        return np.empty(0, dtype=np.intp), np.empty((0, d))
    found = np.concatenate([ids for ids, _ in content.points])
    positions = np.concatenate([positions for _, positions in content.points])
    seen = np.isin(found, ids)
    content.counts["point{s} without a sighting skipped"] += int(np.sum(~seen))
    return found[seen], positions[seen]


def _in_body_frame(
    path: Path,
    content: TaggedLines,
    sensors: IntArray,
    positions: FloatArray,
    information: FloatArray | None,
) -> tuple[FloatArray, FloatArray | None]:
    """Positions and information in the frames of the bodies that carry the sensors."""
    for sensor in np.unique(sensors[sensors != BODY]).tolist():
        if sensor not in content.sensors:
            # Without a line of parameters, 0 is the body itself.
            if sensor == 0:
                continue
            raise FormatError(path, None, f"a sighting is by sensor {sensor}, which is unknown")
        R, t = content.sensors[sensor]
        own = sensors == sensor
        if not ((np.eye(len(t)) == R).all() and not t.any()):
            positions[own] = positions[own] @ R.T + t
            if information is not None:
                information[own] = symmetric(R @ information[own] @ R.T)
    return positions, information
