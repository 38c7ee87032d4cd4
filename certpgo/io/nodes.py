"""Nodes of tagged lines: from ids or names to numbers 0 ... n-1."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, in_file
from certpgo.graph import Estimate
from certpgo.graph.edges import symmetric
from certpgo.graph.information import Information, of_positions
from certpgo.graph.keys import NO_TIME
from certpgo.graph.labels import unused
from certpgo.graph.mounted import Frames
from certpgo.io.dialect import Kind
from certpgo.io.records import BODY, Records, Rows
from certpgo.io.timestamps import times_and_ids
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, numbered

#: The name of the world, from which priors are measured.
_WORLD = "world"
#: Notice about positions that name a sensor elsewhere.
BODILY = "position{s} of bodies whose sensor is elsewhere: taken as the body's, as g2o does"
#: Measurements by kind, whose nodes are numbers.
Measured = dict[Kind, Rows]
#: A rotation (d, d) and a translation (d,).
_Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Nodes:
    """The nodes of a file.

    Attributes
    ----------
    ids : (n,) ids
    values : initial ones of all nodes, or None
    points : (n,) which are points; None if none are
    names, times_ns, fixed, apart, moved_by : see `certpgo.Instance`
    unvalued : how many lack an initial value that others have
    mounts : where the sensors of priors are on their bodies; None for at their origins
    """

    ids: IntArray
    values: Estimate | None
    points: BoolArray | None
    names: tuple[str, ...] = ()
    times_ns: IntArray | None = None
    fixed: tuple[int, ...] = ()
    apart: BoolArray | None = None
    moved_by: int = 0
    unvalued: int = 0
    mounts: Frames | None = None

    def with_world(self, path: Path) -> Nodes:
        """The nodes, and the world as the last one; a FormatError if no id is left for it."""
        last = self.ids[-1]
        if last == np.iinfo(self.ids.dtype).max:
            raise FormatError(path, None, f"node {last} leaves no id for the world")
        names = self.names and (*self.names, unused(_WORLD, self.names))
        apart = None if self.apart is None else np.append(self.apart, False)
        return replace(self, ids=np.append(self.ids, last + 1), names=names, apart=apart)


def distinct(ids: IntArray) -> IntArray:
    """The distinct ids, ascending (sorting is faster than np.unique's hashing)."""
    ordered = np.sort(ids)
    first = np.r_[np.ones(len(ids[:1]), np.bool_), ordered[1:] != ordered[:-1]]
    return np.asarray(ordered[first], dtype=np.intp)


def refuse_duplicates(
    path: Path, ids: IntArray, lines: IntArray, called: Callable[[int], str] = "node {}".format
) -> None:
    """Refuse the first line whose id is that of an earlier one."""
    if len(distinct(ids)) == len(ids):
        return
    order = np.lexsort((lines, ids))
    again = order[1:][ids[order[1:]] == ids[order[:-1]]]
    first = again[np.argmin(lines[again])]
    raise FormatError(path, int(lines[first]), f"{called(int(ids[first]))} appears twice")


def numbered_by_id(path: Path, content: Records) -> tuple[Nodes, Measured]:
    """The nodes by ascending id, and all measurements.

    Raises
    ------
    FormatError
        Two vertices have the same id; an id is that of a pose and of a point, or of a prior or FIX
        and of no node; or a sensor is unknown, or has two poses.
    """
    poses, points = content.take("pose"), content.take("point")
    measured = _taken(content, "edge", "sighting", "prior")
    edges = measured["edge"].nodes.ravel()
    others = np.concatenate([poses.nodes[:, 0], edges])
    sightings, moved_by = _moved_apart(path, measured["sighting"], others)
    seen = np.isin(points.nodes[:, 0], sightings.nodes[:, 1])
    content.counts["point{s} without a sighting skipped"] += int(np.sum(~seen))
    values = Rows.joined([poses, points.subset(seen)])
    vertices = values.nodes[:, 0]
    refuse_duplicates(path, vertices, values.lines)
    ids = distinct(np.concatenate([vertices, edges, sightings.nodes.ravel()]))
    sensors = _sensors(path, content.take("sensor"))
    measured["sighting"] = _in_body_frame(path, sightings, sensors)
    mounts = _mounts(path, measured["prior"], sensors, content.counts)
    _known(path, ids, measured["prior"].nodes.ravel(), "prior of node {}")
    fixed = _known(path, ids, np.array(content.fixed, dtype=np.intp), "FIX {}")
    measured = {k: replace(rows, nodes=numbered(ids, rows.nodes)) for k, rows in measured.items()}
    order, unvalued = np.argsort(vertices), len(ids) - len(vertices)
    known = None if unvalued else _estimate(values.subset(order))
    apart = distinct(sightings.nodes[sightings.apart, 1])
    nodes = Nodes(
        ids,
        known,
        np.isin(ids, sightings.nodes[:, 1]) if len(sightings) else None,
        fixed=tuple(dict.fromkeys(fixed.tolist())),  # several files may fix one node
        apart=np.isin(ids, apart) if len(apart) else None,
        moved_by=moved_by,
        unvalued=unvalued if len(vertices) else 0,
        mounts=mounts,
    )
    return nodes, measured


def _estimate(rows: Rows) -> Estimate:
    scales = rows.scales if len(rows.scales) else None
    return Estimate(rows.rotations, rows.translations, scales=scales)


def _taken(content: Records, *kinds: Kind) -> Measured:
    return {kind: content.take(kind) for kind in kinds}


def _known(path: Path, ids: IntArray, queries: IntArray, what: str) -> IntArray:
    """The numbers of nodes that must be there."""
    found = numbered(ids, queries)
    if (found < 0).any():
        raise FormatError(path, None, f"{what.format(queries[np.argmin(found)])}: no such node")
    return found


def _moved_apart(path: Path, sightings: Rows, others: IntArray) -> tuple[Rows, int]:
    """Sightings whose points have ids that no pose has, and what was added to their own numbers.

    Points that are numbered apart from poses, as is seen where a pose has the number of a point,
    get their number plus one that makes them follow all other ids.

    Parameters
    ----------
    others : ids of poses; more may see points
    """
    if not len(sightings):
        return sightings, 0
    pairs, apart = sightings.nodes.copy(), sightings.apart
    seeing = distinct(np.concatenate([others, pairs[:, 0]]))
    shared = distinct(pairs[~apart, 1])
    both = shared[np.isin(shared, seeing)]
    if len(both):
        raise FormatError(path, None, f"node {both[0]} is a pose and a point")
    if not np.isin(pairs[apart, 1], np.concatenate([seeing, shared])).any():
        return sightings, 0
    moved_by = max(0, int(max(seeing[-1], shared.max(initial=0))) + 1)
    low, high = int(pairs[apart, 1].min()), int(pairs[apart, 1].max())
    if low < 0 or high + moved_by >= 2**62:
        raise FormatError(path, None, f"numbers of points from 0 expected, not {low} to {high}")
    pairs[apart, 1] += moved_by
    return replace(sightings, nodes=pairs), moved_by


def _sensors(path: Path, rows: Rows) -> dict[int, _Pose]:
    """Where sensors are on their bodies."""
    known: dict[int, _Pose] = {}
    columns = rows.nodes[:, 0].tolist(), rows.rotations, rows.translations, rows.lines.tolist()
    for sensor, R, t, line in zip(*columns, strict=True):
        first = known.setdefault(sensor, (R, t))
        if (first[0] != R).any() or (first[1] != t).any():
            raise FormatError(path, line, f"sensor {sensor} has two different poses")
    return known


def _places(
    path: Path, rows: Rows, sensors: dict[int, _Pose], said: str
) -> tuple[IntArray, Frames]:
    """The measurements whose sensors are not at their body's origin, and where these are."""
    d = rows.translations.shape[1]
    distinct_ones, which = np.unique(rows.sensors, return_inverse=True)
    frames, moved = Frames.none(len(distinct_ones), d), np.zeros(len(distinct_ones), dtype=bool)
    for k, sensor in enumerate(distinct_ones.tolist()):
        # Without a line of parameters, 0 is the body itself.
        if sensor not in sensors and sensor not in (BODY, 0):
            here = "PARAMS_SE3OFFSET", sensor, *[0] * 6, 1
            raise FormatError(
                path,
                None,
                f"{said} sensor {sensor}, which is unknown: a line {' '.join(map(str, here))} "
                "puts it at its body's origin",
            )
        if sensor in sensors:
            R, t = sensors[sensor]
            frames.rotations[k], frames.translations[k] = R, t
            moved[k] = bool(t.any() or (np.eye(d) != R).any())
    own = np.flatnonzero(moved[which])
    return own, frames.subset(which[own])


def _in_body_frame(path: Path, sightings: Rows, sensors: dict[int, _Pose]) -> Rows:
    """Sightings in the frames of the bodies that carry the sensors."""
    t, information = sightings.translations, sightings.information
    own, at = _places(path, sightings, sensors, "a sighting is by")
    if not len(own):
        return sightings
    d, R = t.shape[1], at.rotations
    t[own] = (R @ t[own, :, None])[:, :, 0] + at.translations
    if information is not None:
        matrices = information.matrices[:, :d, :d].copy()
        matrices[own] = symmetric(R @ matrices[own] @ np.swapaxes(R, 1, 2))
        information = Information.of(of_positions(matrices), information.residual)
    return replace(sightings, translations=t, information=information)


def _mounts(
    path: Path, priors: Rows, sensors: dict[int, _Pose], counts: Counter[str]
) -> Frames | None:
    """Where the sensors of priors are on their bodies; None for all at their origins.

    Those of positions do not count, as in g2o's EdgeSE3XYZPrior.
    """
    own, at = _places(path, priors, sensors, "a prior is about")
    bodily = priors.bodily[own]
    counts[BODILY] += int(bodily.sum())
    if bodily.all():
        return None
    where, chosen = Frames.none(len(priors), priors.translations.shape[1]), own[~bodily]
    where.rotations[chosen] = at.rotations[~bodily]
    where.translations[chosen] = at.translations[~bodily]
    return where


def named_nodes(path: Path, content: Records) -> tuple[Nodes, Estimate]:
    """The nodes by the order of their vertices, poses before points, and their vertices.

    Raises
    ------
    FormatError
        There are no vertices, or two have the same name.
    """
    poses, points = content.take("pose"), content.take("point")
    vertices = Rows.joined([poses, points])
    if not len(vertices):
        raise FormatError(path, None, "no vertex lines, which name the nodes")
    ids, values = vertices.nodes[:, 0], Estimate(vertices.rotations, vertices.translations)
    refuse_duplicates(path, ids, vertices.lines, content.names.__getitem__)
    with in_file(path):
        times, _ = times_and_ids(poses.stamps)
    times = np.append(times, np.full(len(points), NO_TIME))
    nodes = Nodes(
        ids,
        None,
        np.arange(len(ids)) >= len(poses) if len(points) else None,
        names=tuple(content.names[k] for k in ids.tolist()),
        # Equal times are a placeholder.
        times_ns=times if len(np.unique(poses.stamps, axis=0)) > 1 else None,
    )
    return nodes, values


def numbered_by_name(
    path: Path, content: Records, *, skip_landmarks: bool
) -> tuple[Nodes, Measured]:
    """The nodes by the order of their vertices, and all measurements; perhaps without points.

    Raises
    ------
    FormatError
        As `named_nodes`; or a name is unknown, or of a point where a pose is expected or reversely.
    """
    nodes, values = named_nodes(path, content)
    n, place = len(nodes.ids), np.full(len(content.names), -1, dtype=np.intp)
    place[nodes.ids] = np.arange(n)
    is_point = np.zeros(n, dtype=np.bool_) if nodes.points is None else nodes.points
    measured = _taken(content, "edge", "sighting", "range", "prior")
    _refuse_misplaced(path, content.names, measured, place, is_point)
    measured = {kind: replace(rows, nodes=place[rows.nodes]) for kind, rows in measured.items()}
    kept = np.arange(n)
    if skip_landmarks:
        kept = kept[~is_point]
        of_points: dict[Kind, str] = {"prior": "prior{s} of points", "range": "range{s} to points"}
        for kind, what in of_points.items():
            apart = np.asarray(is_point[measured[kind].nodes].any(axis=1))
            measured[kind] = measured[kind].subset(~apart)
            content.counts[f"{what} skipped"] += int(np.sum(apart))
    values = values.subset(kept)
    # Vertices that are all at the origin only name the nodes.
    known = np.any(values.translations) or np.any(values.rotations != np.eye(values.d))
    times = nodes.times_ns
    return replace(
        nodes,
        ids=kept,
        values=values if known else None,
        points=None if skip_landmarks else nodes.points,
        names=nodes.names[: len(kept)],
        times_ns=None if times is None else times[: len(kept)],
    ), measured


def _refuse_misplaced(
    path: Path, names: list[str], measured: Measured, place: IntArray, is_point: BoolArray
) -> None:
    """Refuse the first line with a name of no vertex, or of a node of another kind."""
    wrong: list[tuple[int, str]] = []
    for kind, rows in measured.items():
        number = place[rows.nodes]
        points = is_point[number]
        misfit = number < 0
        if kind in ("edge", "sighting"):
            misfit |= points != np.array([False, kind == "sighting"])
        elif kind == "prior":  # of a position it may be a point's
            misfit |= points & (rows.kappa > 0.0)[:, None]
        for row in np.flatnonzero(misfit.any(axis=1)).tolist():
            column = int(np.argmax(misfit[row]))
            name, line = names[rows.nodes[row, column]], int(rows.lines[row])
            if number[row, column] < 0:
                wrong.append((line, f"{name} is unknown: no VERTEX line names it"))
            else:
                found, other = ("point", "pose") if points[row, column] else ("pose", "point")
                wrong.append((line, f"{name} is a {found}, and a {other} is expected there"))
    if wrong:
        raise FormatError(path, *min(wrong))
