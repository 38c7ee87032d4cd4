"""g2o: VERTEX_SE3:QUAT, EDGE_SE3:QUAT and their planar versions.

    VERTEX_SE3:QUAT id x y z qx qy qz qw
    EDGE_SE3:QUAT i j x y z qx qy qz qw [21 numbers]
    VERTEX_SE2 id x y theta
    EDGE_SE2 i j x y theta [6 numbers]
    FIX id ...
    EDGE_PRIOR_SE2 id x y theta [6 numbers]
    EDGE_PRIOR_SE2_XY id x y [3 numbers]
    EDGE_SE3_PRIOR id sensor x y z qx qy qz qw [21 numbers]
    EDGE_SE3_XYZPRIOR id sensor x y z [6 numbers]
    EDGE_POINTXYZ_PRIOR id x y z [6 numbers]
    VERTEX_XY id x y
    EDGE_SE2_XY pose point x y [3 numbers]
    LANDMARK2 pose point x y [3 numbers]
    VERTEX_TRACKXYZ id x y z
    EDGE_SE3_TRACKXYZ pose point sensor x y z [6 numbers]
    PARAMS_SE3OFFSET sensor x y z qx qy qz qw
    EDGE_SE2_SWITCHABLE i j switch x y theta [6 numbers]
    EDGE_SE3_SWITCHABLE i j switch x y z qx qy qz qw [21 numbers]

Similarities are written as `certpgo.io.formats.expmap_sim3` reads them.
The tags of g2o's own examples begin with ONLINE_ or TUTORIAL_.
The last two are of Vertigo (https://openslam-org.github.io/vertigo.html), loop closures that its
optimizer can switch off, read as ordinary ones. rtabmap (corelib/src/optimizer/OptimizerG2O.cpp)
writes them, and EDGE_POINTXYZ_PRIOR for GPS.
A point is where its pose sees it, or a sensor on its body. In LANDMARK2 points are numbered apart.
The information is its upper triangle, row by row, translation before rotation. In g2o's own code
the rotational part of 3D edges refers to the quaternion's vector part
(``rotation_information="quaternion"``); in SE-Sync, GTSAM and by default here to the tangent space.
A graph that was read in g2o's sense is written with the same matrices, to be read so again.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.information import Information
from certpgo.graph.keys import Keys
from certpgo.io.build_graph import instance_from_lines, poses_from_lines
from certpgo.io.dialect import Dialect, Tag, first_tags, pose_texts, quaternion_poses
from certpgo.io.format import Chart, Format
from certpgo.io.formats import expmap_sim3
from certpgo.io.formats.pyfg import recognises as is_pyfg
from certpgo.linalg.arrays import BoolArray, IntArray

_SKIPPED = ("VERTEX_POINT_XYZ", "EDGE_BEARING_SE2_XY", "EDGE_POINT_XYZ", "LANDMARK3")
#: Of poses and of positions, in the plane and in space. Those that are written come first.
_PRIORS = {2: ("EDGE_PRIOR_SE2", "EDGE_SE2_PRIOR"), 3: ("EDGE_SE3_PRIOR",)}
_POSITIONS = {
    2: ("EDGE_PRIOR_SE2_XY", "EDGE_SE2_GPS"),
    3: ("EDGE_SE3_XYZPRIOR", "EDGE_POINTXYZ_PRIOR"),
}
#: Without the id of a sensor.
_OF_BODIES = ("EDGE_POINTXYZ_PRIOR",)
#: Of poses and points, and what is seen of points.
_VERTICES = {2: ("VERTEX_SE2", "VERTEX_XY"), 3: ("VERTEX_SE3:QUAT", "VERTEX_TRACKXYZ")}
_SIGHTINGS = {2: "EDGE_SE2_XY", 3: "EDGE_SE3_TRACKXYZ"}
_SWITCHED = "loop closure{s} with a switch, read without: certpgo solve --robust rejects outliers"
_SWITCHES = ("VERTEX_SWITCH", "EDGE_SWITCH_PRIOR")
_PARAMETERS = ("PARAMS_SE2OFFSET", "TUTORIAL_PARAMS_SE2_OFFSET", "PARAMS_CAMERACALIB")
#: Before VERTEX_SE2 and EDGE_SE2 in files of g2o's own examples.
_EXAMPLES = ("ONLINE", "TUTORIAL")


DIALECT = Dialect(
    name="g2o",
    tags={
        b"VERTEX_SE3:QUAT": Tag("pose", 3, 7),
        b"EDGE_SE3:QUAT": Tag("edge", 3, 7),
        b"VERTEX_SE2": Tag("pose", 2, 3),
        b"EDGE_SE2": Tag("edge", 2, 3),
        **{f"{name}_VERTEX_SE2".encode(): Tag("pose", 2, 3) for name in _EXAMPLES},
        **{f"{name}_EDGE_SE2".encode(): Tag("edge", 2, 3) for name in _EXAMPLES},
        b"FIX": Tag("fix"),
        b"VERTEX_XY": Tag("point", 2, 2, "landmarks"),
        b"EDGE_SE2_XY": Tag("sighting", 2, 2, "landmarks"),
        b"LANDMARK2": Tag("sighting", 2, 2, "landmarks", apart=True),
        b"VERTEX_TRACKXYZ": Tag("point", 3, 3, "landmarks"),
        b"EDGE_SE3_TRACKXYZ": Tag("sighting", 3, 3, "landmarks", sensor=True),
        **{name.encode(): Tag("skip", what="landmarks") for name in _SKIPPED},
        **{
            name.encode(): Tag("prior", d, 4 * d - 5, "priors", sensor=d == 3)
            for d in (2, 3)
            for name in _PRIORS[d]
        },
        **{
            name.encode(): Tag("prior", d, d, "priors", sensor=d == 3 and name not in _OF_BODIES)
            for d in (2, 3)
            for name in _POSITIONS[d]
        },
        b"EDGE_SE2_SWITCHABLE": Tag("edge", 2, 3, _SWITCHED, sensor=True),
        b"EDGE_SE3_SWITCHABLE": Tag("edge", 3, 7, _SWITCHED, sensor=True),
        b"EDGE_SE3:QUAT_SWITCHABLE": Tag("edge", 3, 7, _SWITCHED, sensor=True),
        **{name.encode(): Tag("skip", what="switches") for name in _SWITCHES},
        b"PARAMS_SE3OFFSET": Tag("sensor", 3, 7, "sensor parameters"),
        **{name.encode(): Tag("skip", what="sensor parameters") for name in _PARAMETERS},
    },
    poses=quaternion_poses,
    residual="g2o",
)


def _recognises(path: Path, head: bytes) -> bool:
    return bool(first_tags(head) & DIALECT.tags.keys()) and not is_pyfg(path, head)


def _pose_words(words: list[bytes]) -> list[bytes]:
    return words[2:] if words[0].startswith(b"VERTEX") else []


def _vertex_lines(ids: IntArray, estimate: Estimate, points: BoolArray) -> list[str]:
    numbers, d = pose_texts(estimate.rotations, estimate.translations), estimate.d
    pose, point = _VERTICES[d]
    return [
        f"{point} {k} {_position(text, d)}\n" if is_point else f"{pose} {k} {text}\n"
        for k, text, is_point in zip(ids.tolist(), numbers, points.tolist(), strict=True)
    ]


def _position(pose: str, d: int) -> str:
    """The position among the numbers of a pose."""
    return " ".join(pose.split()[:d])


def _weights(instance: Instance) -> tuple[list[str], list[str]]:
    """The upper triangles of the information of all edges, and of their positions alone."""
    graph, d = instance.graph, instance.graph.d
    if (information := graph.information) is not None:
        # Where the default cost is g2o's, its matrices count; elsewhere F, and so kappa.
        if information.residual != DIALECT.residual or not information.is_definite.all():
            information = information.about_tangents()
        return _full(information), _full(information, d)
    if graph.has_positions:
        kappa, tau = graph.kappa.tolist(), graph.tau.tolist()
    else:
        kappa, tau = graph.kappa.tolist(), [1.0] * graph.num_edges
    whole = [_isotropic(d, *pair) for pair in zip(kappa, tau, strict=True)]
    return whole, [_multiple(d, number) for number in tau]


def _multiple(d: int, tau: float) -> str:
    """The upper triangle of tau I."""
    return f"{tau!r} 0 {tau!r}" if d == 2 else f"{tau!r} 0 0 {tau!r} 0 {tau!r}"


def _full(information: Information, size: int | None = None) -> list[str]:
    """The upper triangle of each edge's matrix, or of its first rows, row by row."""
    row, column = np.triu_indices(size or information.distinct.shape[-1])
    texts = [" ".join(map(repr, M)) for M in information.distinct[:, row, column].tolist()]
    return [texts[k] for k in information.index.tolist()]


def _isotropic(d: int, kappa: float, tau: float) -> str:
    # Isotropic, so that reading it returns kappa and tau exactly.
    if d == 2:
        return f"{tau!r} 0 0 {tau!r} 0 {kappa!r}"
    a, b = repr(tau), repr(2.0 * kappa)
    return f"{a} 0 0 0 0 0 {a} 0 0 0 0 {a} 0 0 0 {b} 0 0 {b} 0 {b}"


def _prior(
    graph: Graph, k: int, node: int, mount: int, pose: str, weight: str, of_position: str
) -> str:
    """The line of an edge from the world, of a sensor with that number."""
    d = graph.d
    sensor = f" {mount}" if d == 3 else ""
    # Where a position's sensor is does not count, that of a pose of unknown rotation does.
    if graph.kappa[k] > 0.0 or mount:
        return f"{_PRIORS[d][0]} {node}{sensor} {pose} {weight}\n"
    return f"{_POSITIONS[d][0]} {node}{sensor} {_position(pose, d)} {of_position}\n"


def _sensors(graph: Graph) -> tuple[IntArray, list[str]]:
    """(m,) numbers of sensors at the arms of edges, 0 for the body, and the lines of these."""
    if graph.arms is None:
        return np.zeros(graph.num_edges, dtype=np.intp), []
    places = np.concatenate([np.zeros((1, graph.d)), graph.arms])
    distinct, number = np.unique(places, axis=0, return_inverse=True)
    order = np.argsort(distinct.any(axis=1), kind="stable")  # the body first
    mounts = np.argsort(order)[number.ravel()[1:]]
    turned = np.tile(np.eye(graph.d), (len(distinct), 1, 1))
    poses = pose_texts(turned, distinct[order])
    return mounts, [f"PARAMS_SE3OFFSET {k} {pose}\n" for k, pose in enumerate(poses)][1:]


def _sighting(d: int, pair: list[int], pose: str, of_position: str) -> str:
    """The line of an edge to a point."""
    where = f"{pair[0]} {pair[1]}{' 0' if d == 3 else ''} {_position(pose, d)}"
    return f"{_SIGHTINGS[d]} {where} {of_position}\n"


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    if estimate.scales is not None:
        expmap_sim3.write_poses(path, estimate, keys)
        return
    with path.open("w", encoding="ascii") as file:
        n = estimate.num_nodes
        file.writelines(_vertex_lines(keys.ids_of(n), estimate, keys.is_point(n)))


def _write_graph(path: Path, instance: Instance) -> None:
    if instance.graph.has_scales:
        expmap_sim3.write_graph(path, instance)
        return
    graph, ids = instance.graph, instance.ids
    tag = "EDGE_SE3:QUAT" if graph.d == 3 else "EDGE_SE2"
    t = graph.translations if graph.has_positions else None
    if t is not None and instance.origin is not None:
        t = t + np.where(graph.edges[:, :1] == instance.world, instance.origin, 0.0)
    # What information on a translation alone is about is in the frame of the first node.
    alone = ~graph.measures_rotation[:, None, None]
    numbers = pose_texts(np.where(alone, np.eye(graph.d), graph.rotations), t)
    pairs = ids[graph.edges].tolist()
    weights, of_positions = _weights(instance)
    lines = [
        f"{tag} {i} {j} {pose} {weight}\n"
        for (i, j), pose, weight in zip(pairs, numbers, weights, strict=True)
    ]
    mounts, sensors = _sensors(graph)
    points = graph.is_point
    for k in np.flatnonzero(points[graph.edges[:, 1]]).tolist():
        lines[k] = _sighting(graph.d, pairs[k], numbers[k], of_positions[k])
    if graph.has_positions and instance.world is not None:
        for k in np.flatnonzero((graph.edges == instance.world).any(axis=1)).tolist():
            node, given = ids[graph.edges[k, 1]], (weights[k], of_positions[k])
            lines[k] = _prior(graph, k, node, int(mounts[k]), numbers[k], *given)
    known = slice(instance.world)
    with path.open("w", encoding="ascii") as file:
        if (points.any() or sensors) and graph.d == 3:
            file.write("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n")
            file.writelines(sensors)
        if instance.initial is not None:
            values = instance.in_world(instance.initial) if instance.world else instance.initial
            file.writelines(_vertex_lines(ids[known], values, points[known]))
        file.writelines(f"FIX {ids[k]}\n" for k in instance.fixed)
        file.writelines(lines[k] for k in np.flatnonzero(graph.is_measured).tolist())


FORMAT = Format(
    name="g2o",
    suffixes=(".g2o",),
    recognises=_recognises,
    holds="poses and measurements",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
    read_poses=partial(poses_from_lines, DIALECT),
    write_graph=_write_graph,
    write_poses=_write_poses,
    holds_points=True,
    holds_scales=True,
    holds_ids=True,
    chart=Chart("quaternion", _pose_words, planar_angle=True),
)
