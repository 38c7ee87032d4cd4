"""rtabmap.db: the graph in a database of rtabmap.

    Node   id, stamp (seconds), pose (3x4 floats, of odometry)
    Link   from_id, to_id, type, information_matrix (6x6 doubles), transform (3x4 floats)

As in rtabmap's corelib/src/resources/DatabaseSchema.sql.in, since version 0.11. A link is our
measurement (i, j) = (from, to), and its information has translation before rotation, about the
tangent space. Its reverse, which rtabmap stores at the other node, is left out. Types 0 to 6 are
between poses, and 7 is a prior, of a node in the world. A prior whose rotation has a variance of
9999 or more is of the position alone, as in rtabmap's own exports (OptimizerG2O.cpp).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from certpgo.errors import FormatError, NoMeasurements, in_file
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.phrases import counted
from certpgo.io.build_graph import anchored
from certpgo.io.edge_weights import Weighing, weighed
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses, ReadOptions, estimate_at
from certpgo.io.nodes import Nodes, distinct
from certpgo.io.records import Rows
from certpgo.io.rtabmap_links import BETWEEN, PRIOR, skipped_links
from certpgo.io.sqlite import MAGIC, Kind, columns_of, found_rows, kinds_of, numbers_of
from certpgo.io.timestamps import decimals, times_and_ids
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, numbered

_PROGRAM = "rtabmap"
_NEEDED: dict[str, dict[str, Kind]] = {
    "Node": {"id": "integers", "stamp": "anything", "pose": "anything"},
    "Link": {
        "from_id": "integers",
        "to_id": "integers",
        "type": "integers",
        "information_matrix": "anything",
        "transform": "anything",
    },
}
#: Information below which a prior's rotation is not measured.
_UNMEASURED = 1.0 / 9999.0


class _Links(NamedTuple):
    """Links: ends (k, 2), types (k,), rotations, translations and information (k, 6, 6)."""

    ends: IntArray
    kinds: IntArray
    rotations: FloatArray
    translations: FloatArray
    information: FloatArray

    def subset(self, chosen: BoolArray) -> _Links:
        """Some of them."""
        R, t, information = self.rotations, self.translations, self.information
        ends, kinds = self.ends[chosen], self.kinds[chosen]
        return _Links(ends, kinds, R[chosen], t[chosen], information[chosen])

    def weighed(self, path: Path, options: ReadOptions) -> Weighing:
        """Their weights."""
        named = [f"link {i} to {j}" for i, j in self.ends.tolist()]
        return weighed(path, self.information, self.rotations, options, named.__getitem__)


def _recognises(path: Path, head: bytes) -> bool:
    if not head.startswith(MAGIC):
        return False
    try:
        return _NEEDED.keys() <= kinds_of(path, _PROGRAM).keys()
    except FormatError:
        return False


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    kinds, links = _links(path)
    between = links.subset(np.isin(links.kinds, BETWEEN))
    if not len(between.ends):
        raise NoMeasurements(path, None, "no links between poses")
    once = _first_of_both(between)
    notices = list(skipped_links(kinds, priors=options.skip_priors))
    if fixes := _gps_fixes(path):
        said = "GPS record{s} of nodes not read: positions are taken from links, as priors"
        notices.append(counted(fixes, said))
    if reversed_links := int(np.sum(~once)):
        notices.append(counted(reversed_links, "link{s} stored again in reverse left out"))
    between = between.subset(once)
    weighing = between.weighed(path, options)
    ids = distinct(between.ends.ravel())
    edges = numbered(ids, between.ends)
    rotation = RotationGraph(len(ids), edges, between.rotations, weighing.kappa)
    t, tau = between.translations, weighing.tau
    instance = Instance(
        name=path.stem,
        graph=PoseGraph(rotation, t, tau, information=weighing.information),
        ids=ids,
        source=str(path),
        notices=(*weighing.notices, *notices),
    )
    priors = links.subset(links.kinds == PRIOR)
    if len(priors.ends) and not options.skip_priors:
        instance = _with_priors(path, instance, priors, options)
    return _with_poses(path, instance)


def _gps_fixes(path: Path) -> int:
    """How many nodes have a GPS fix: six doubles, from stamp to bearing."""
    if "gps" not in columns_of(path, "Node", _PROGRAM):
        return 0
    fixes = found_rows(path, "Node", {"gps": "anything"}, _PROGRAM)
    return sum(isinstance(fix, bytes) and len(fix) == 48 for (fix,) in fixes)


def _links(path: Path) -> tuple[IntArray, _Links]:
    """The types of all links, and those between poses and of priors that have a transform."""
    kinds, found = [], []
    links = found_rows(path, "Link", _NEEDED["Link"], _PROGRAM)
    for i, j, kind, information, transform in links:
        kinds.append(kind)
        if kind not in (*BETWEEN, PRIOR):
            continue
        place = f"link {i} to {j}"
        if (i == j) != (kind == PRIOR):
            said = "is measured from itself" if i == j else "is a prior of two nodes"
            raise FormatError(path, None, f"{place} {said}")
        M = numbers_of(path, f"{place}: transform", transform, 12, "<f4")
        matrix = numbers_of(path, f"{place}: information_matrix", information, 36, "<f8")
        if M is None or matrix is None:
            raise FormatError(path, None, f"{place}: no transform, or no information")
        found.append((i, j, kind, M, matrix))
    return np.array(kinds, dtype=np.intp), _as_links(path, found)


def _as_links(path: Path, found: list[tuple[Any, ...]]) -> _Links:
    ends = np.array([row[:2] for row in found], dtype=np.intp).reshape(-1, 2)
    kinds = np.array([row[2] for row in found], dtype=np.intp)
    R, t = _poses(path, [row[3] for row in found], lambda k: f"link {ends[k, 0]} to {ends[k, 1]}")
    matrices = np.array([row[4] for row in found]).reshape(-1, 6, 6)
    return _Links(ends, kinds, R, t, matrices)


def _poses(path: Path, numbers: list[FloatArray], name: Any) -> tuple[FloatArray, FloatArray]:
    """Rotations (k, 3, 3) and translations (k, 3) of 3x4 matrices, row by row."""
    M = np.array(numbers).reshape(-1, 3, 4)
    with in_file(path):
        return quaternion.rotations(quaternion.from_matrices(M[:, :, :3], name)), M[:, :, 3]


def _first_of_both(links: _Links) -> BoolArray:
    """(k,) which links are not the reverse of an earlier one of the same type."""
    seen: set[tuple[int, int, int]] = set()
    first = []
    for (i, j), kind in zip(links.ends.tolist(), links.kinds.tolist(), strict=True):
        first.append((j, i, kind) not in seen)
        seen.add((i, j, kind))
    return np.array(first)


def _with_priors(path: Path, instance: Instance, priors: _Links, options: ReadOptions) -> Instance:
    """The instance with priors of its nodes, measured from the world."""
    diagonal = np.diagonal(priors.information, axis1=1, axis2=2)
    alone = np.asarray(~(diagonal[:, 3:] > _UNMEASURED).all(axis=1))
    information, R = priors.information.copy(), priors.rotations.copy()
    information[alone, 3:], information[alone, :, 3:], R[alone] = 0.0, 0.0, np.eye(3)
    priors = priors._replace(information=information, rotations=R)
    nodes = numbered(instance.ids, priors.ends[:, 0])
    if (nodes < 0).any():
        node = priors.ends[np.argmin(nodes), 0]
        raise FormatError(path, None, f"prior of node {node}, which no link joins to another")
    weighing = priors.weighed(path, options)
    weights = weighing.kappa, weighing.tau, weighing.information
    rows = Rows(nodes[:, None], priors.rotations, priors.translations, *weights)
    if not instance.graph.has_positions:
        raise TypeError("links measure poses")
    graph, origin, notice = anchored(instance.graph, rows)
    n = len(instance.ids)
    own = Nodes(instance.ids, None, None).with_world(path)
    return replace(
        instance,
        graph=graph,
        ids=own.ids,
        world=n,
        origin=origin,
        notices=(*instance.notices, *weighing.notices, notice),
    )


def _with_poses(path: Path, instance: Instance) -> Instance:
    """The instance with times, and with odometry's poses as initial values if all are known."""
    poses = _nodes(path)
    place = numbered(poses.keys.ids_of(len(poses.rotations)), instance.ids[: instance.world])
    if (place < 0).any():
        return instance
    times = None if poses.times_ns is None else poses.times_ns[place]
    instance = replace(instance, times_ns=times)
    initial: Estimate = estimate_at(poses, place, True)
    return replace(instance, initial=instance.with_world(initial))


def _read_poses(path: Path) -> LabelledPoses:
    poses = _nodes(path)
    if not len(poses.rotations):
        raise FormatError(path, None, "table Node: at least one pose expected")
    return poses


def _nodes(path: Path) -> LabelledPoses:
    """The nodes that have a pose."""
    rows = sorted(found_rows(path, "Node", _NEEDED["Node"], _PROGRAM), key=lambda row: row[0])
    known = [
        (node, stamp, M)
        for node, stamp, pose in rows
        if (M := numbers_of(path, f"node {node}: pose", pose, 12, "<f4")) is not None
    ]
    ids = np.array([node for node, _, _ in known], dtype=np.intp)
    R, t = _poses(path, [M for _, _, M in known], lambda k: f"node {ids[k]}")
    stamps = [stamp for _, stamp, _ in known]
    if not all(isinstance(stamp, int | float) and 0 < stamp < 9e9 for stamp in stamps):
        return LabelledPoses(R, t, ids=ids)
    times, _ = times_and_ids(decimals([repr(stamp).encode() for stamp in stamps]))
    return LabelledPoses(R, t, ids=ids, times_ns=times)


FORMAT = Format(
    name="rtabmap",
    suffixes=(),
    recognises=_recognises,
    holds="a graph",
    read_graph=_read_graph,
    read_poses=_read_poses,
)
