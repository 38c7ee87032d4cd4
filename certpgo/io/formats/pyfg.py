"""PyFG, the factor graphs of CORA: nodes with names, ranges, and covariances.

    VERTEX_SE2 time name x y theta
    VERTEX_SE3:QUAT time name x y z qx qy qz qw
    VERTEX_XY name x y
    VERTEX_XYZ name x y z
    EDGE_SE2 time name name x y theta 6 numbers
    EDGE_SE3:QUAT time name name x y z qx qy qz qw 21 numbers
    EDGE_SE2_XY time pose point x y 3 numbers
    EDGE_SE3_XYZ time pose point x y z 6 numbers
    EDGE_RANGE time name name distance variance
    VERTEX_SE2:PRIOR time pose x y theta 6 numbers
    VERTEX_SE3:QUAT:PRIOR time pose x y z qx qy qz qw 21 numbers
    VERTEX_XY:PRIOR time name x y 3 numbers
    VERTEX_XYZ:PRIOR time name x y z 6 numbers

The numbers at the end are a covariance, its upper triangle row by row, translation before rotation.
Nodes are numbered in the order of their vertices, poses before points. Every node has a vertex;
where all of them are at the origin they are no initial values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.edges import symmetric
from certpgo.graph.information import Information
from certpgo.graph.keys import NO_TIME, Keys, in_seconds
from certpgo.io.build_graph import instance_from_lines, poses_from_lines
from certpgo.io.chunks import is_number, without_comments
from certpgo.io.dialect import Dialect, Kind, Tag, pose_texts, quaternion_poses
from certpgo.io.format import Chart, Format
from certpgo.io.lines import is_name
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

DIALECT = Dialect(
    name="pyfg",
    tags={
        b"VERTEX_SE2": Tag("pose", 2, 3, timed=True),
        b"VERTEX_SE3:QUAT": Tag("pose", 3, 7, timed=True),
        b"VERTEX_XY": Tag("point", 2, 2),
        b"VERTEX_XYZ": Tag("point", 3, 3),
        b"EDGE_SE2": Tag("edge", 2, 3, timed=True),
        b"EDGE_SE3:QUAT": Tag("edge", 3, 7, timed=True),
        b"EDGE_SE2_XY": Tag("sighting", 2, 2, "landmarks", timed=True),
        b"EDGE_SE3_XYZ": Tag("sighting", 3, 3, "landmarks", timed=True),
        b"VERTEX_SE2:PRIOR": Tag("prior", 2, 3, "priors", timed=True),
        b"VERTEX_SE3:QUAT:PRIOR": Tag("prior", 3, 7, "priors", timed=True),
        b"VERTEX_XY:PRIOR": Tag("prior", 2, 2, "priors", timed=True),
        b"VERTEX_XYZ:PRIOR": Tag("prior", 3, 3, "priors", timed=True),
        b"EDGE_RANGE": Tag("range", 0, 1, timed=True),
    },
    poses=quaternion_poses,
    precision="covariance",
    named=True,
)
#: Tags by kind, dimension, and whether they are of positions alone.
_TAGS = {(tag.kind, tag.d, tag.is_position): name.decode() for name, tag in DIALECT.tags.items()}
#: Of measurements, and of nodes without a time.
_TIME = "0"


def recognises(path: Path, head: bytes) -> bool:
    """Whether the first bytes of a file are of lines with names, rather than g2o's with numbers.

    A whole line tells; in a file with the suffix .pyfg, also one with too many or too few words.
    """
    for line in without_comments(head).splitlines():
        words = line.split()
        tag = DIALECT.tags.get(words[0]) if words else None
        if tag is None or len(words) < 2 + tag.timed or is_number(words[1 + tag.timed]):
            continue
        size = tag.timed + tag.ids + tag.numbers + DIALECT.precision_size(tag)
        if len(words) == 1 + size or path.suffix == ".pyfg":
            return True
    return False


def _pose_words(words: list[bytes]) -> list[bytes]:
    tag = DIALECT.tags.get(words[0])
    return words[3:] if tag is not None and tag.kind == "pose" else []


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    """Write the vertices of an estimate."""
    t = estimate.translations
    if t is None:
        raise InputError("pyfg needs translations; the estimate has rotations only")
    points = keys.is_point(len(t))
    names = _names(keys.names, keys.ids_of(len(t)), points)
    _write(path, _vertices(names, _times(keys.times_ns, len(t)), estimate.rotations, t, points))


def _write_graph(path: Path, instance: Instance) -> None:
    """Write a graph: vertices, priors, measurements and ranges."""
    graph, known = instance.graph, slice(instance.world)
    if not graph.has_positions:
        raise InputError("pyfg holds poses, and this graph measures rotations alone")
    if not graph.measures_translation.all():
        raise InputError("pyfg has no measurements of an attitude alone")
    n, d, t = len(instance.ids[known]), graph.d, graph.translations
    points = graph.is_point[known]
    names = _names(instance.names[known], instance.ids[known], points)
    # Every node needs a vertex; without initial values all are at the origin.
    values = Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))
    if instance.initial is not None:
        values = instance.in_world(instance.initial)
    of_world = np.zeros(graph.num_edges, dtype=bool)
    if instance.world is not None:
        of_world = np.asarray(graph.edges[:, 0] == instance.world)
        if instance.origin is not None:
            t = t + np.where(of_world[:, None], instance.origin, 0.0)
    at = values.translations
    at = np.zeros((n, d)) if at is None else at
    lines = _vertices(names, _times(instance.times_ns, n), values.rotations, at, points)
    poses = pose_texts(graph.rotations, t)
    covariances = _covariances(instance, graph)
    turned = graph.measures_rotation
    kinds: tuple[tuple[Kind, BoolArray], ...] = (
        ("prior", of_world & turned),
        ("prior", of_world & ~turned),
        ("edge", ~of_world & turned),
        ("sighting", ~of_world & ~turned),
    )
    for kind, chosen in kinds:
        for k in np.flatnonzero(chosen).tolist():
            i, j = graph.edges[k].tolist()
            tag = _TAGS[kind, d, not turned[k]]
            ends = names[j] if kind == "prior" else f"{names[i]} {names[j]}"
            measured = poses[k] if turned[k] else " ".join(map(repr, t[k].tolist()))
            lines.append(f"{tag} {_TIME} {ends} {measured} {covariances[k]}\n")
    _write(path, [*lines, *_ranges(instance, names)])


def _ranges(instance: Instance, names: Sequence[str]) -> Iterator[str]:
    if (ranges := instance.graph.ranges) is None:
        return
    variances = (1.0 / ranges.weights).tolist()
    distances = ranges.distances.tolist()
    for (i, j), *numbers in zip(ranges.edges.tolist(), distances, variances, strict=True):
        if instance.world in (i, j):
            raise InputError("pyfg has no ranges from the world")
        distance, variance = numbers
        yield f"EDGE_RANGE {_TIME} {names[i]} {names[j]} {distance!r} {variance!r}\n"


def _times(times_ns: IntArray | None, n: int) -> list[str]:
    """The times of nodes in seconds."""
    if times_ns is None:
        return [_TIME] * n
    return [_TIME if time == NO_TIME else in_seconds(time) for time in times_ns.tolist()]


def _vertices(
    names: Sequence[str], times: Sequence[str], R: FloatArray, t: FloatArray, points: BoolArray
) -> list[str]:
    d = t.shape[1]
    pose, point = _TAGS["pose", d, False], _TAGS["point", d, True]
    return [
        f"{point} {name} {' '.join(map(repr, at))}\n"
        if is_point
        else f"{pose} {time} {name} {text}\n"
        for name, time, text, at, is_point in zip(
            names, times, pose_texts(R, t), t.tolist(), points.tolist(), strict=True
        )
    ]


def _names(names: Sequence[str], ids: IntArray, points: BoolArray) -> list[str]:
    """The nodes' names; without any, A and L with the ids of poses and points."""
    if not names:
        letters = ("L" if flag else "A" for flag in points.tolist())
        return [f"{letter}{k}" for letter, k in zip(letters, ids.tolist(), strict=True)]
    for name in names:
        if not is_name(name):
            raise InputError(f"pyfg has names without blanks that are no numbers, not {name!r}")
    return list(names)


def _covariances(instance: Instance, graph: Graph) -> list[str]:
    """The upper triangles of the covariances of all edges, row by row."""
    if graph.information is not None:
        return _full(instance, graph.information.about_tangents())
    weights = zip(graph.kappa.tolist(), graph.tau.tolist(), strict=True)
    return [_isotropic(graph.d, *pair) for pair in weights]


def _full(instance: Instance, information: Information) -> list[str]:
    texts, d = [], instance.graph.d
    for k, whole in enumerate(information.distinct):
        matrix = whole if whole[d:].any() else whole[:d, :d]
        # Of a row of zeros an eigenvalue is zero up to its rounding, which may be above.
        if not (matrix.diagonal().all() and np.linalg.eigvalsh(matrix)[0] > 0.0):
            i, j = instance.ids[instance.graph.edges[np.argmax(information.index == k)]]
            raise InputError(
                f"edge {i} to {j}: pyfg holds covariances, and the information is not positive "
                "definite (--isotropic writes the weights of F)"
            )
        texts.append(_upper(symmetric(np.linalg.inv(matrix)[None])[0]))
    return [texts[k] for k in information.index.tolist()]


def _isotropic(d: int, kappa: float, tau: float) -> str:
    variances = [1.0 / tau] * d
    if kappa > 0.0:
        variances += [1.0 / kappa] if d == 2 else [0.5 / kappa] * 3
    return _upper(np.diag(variances))


def _upper(matrix: FloatArray) -> str:
    return " ".join(map(repr, matrix[np.triu_indices(len(matrix))].tolist()))


def _write(path: Path, lines: Sequence[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(lines)


FORMAT = Format(
    name="pyfg",
    suffixes=(".pyfg",),
    recognises=recognises,
    holds="poses, points, measurements and ranges",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
    read_poses=partial(poses_from_lines, DIALECT),
    write_graph=_write_graph,
    write_poses=_write_poses,
    holds_points=True,
    holds_ranges=True,
    chart=Chart("quaternion", _pose_words, planar_angle=True),
    holds_ids=True,
    holds_times=True,
    holds_name=is_name,
)
