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

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, NoMeasurements
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.labels import unused
from certpgo.graph.ranges import Ranges
from certpgo.graph.wording import counted
from certpgo.io.compressed import uncompressed_name
from certpgo.io.contents import BODY, Priors
from certpgo.io.format import Chart, Format, LabelledPoses, ReadOptions
from certpgo.io.named_lines import (
    ENDS,
    TAGS,
    Kind,
    NamedLines,
    NamedPart,
    is_named,
    located,
    read_named,
)
from certpgo.io.named_writing import write_graph, write_poses
from certpgo.io.priors import anchored_graph, joined_information
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: The name of the world, from which priors are measured.
_WORLD = "world"


@dataclass(frozen=True)
class _Nodes:
    """The nodes of a file, poses before points, and their initial values."""

    path: Path
    names: tuple[str, ...]
    values: Estimate
    points: BoolArray
    number: dict[str, int]

    def of(self, kind: Kind, part: NamedPart) -> IntArray:
        """The numbers of the nodes of each line (k, names); a FormatError names a wrong line."""
        ends = ENDS[kind]
        flat = [self.number.get(name, -1) for names in part.names for name in names]
        found = np.array(flat, dtype=np.intp).reshape(-1, len(ends))
        is_point = self.points[found]
        wrong = found < 0
        for column, expected in enumerate(ends):
            if expected is not None:
                wrong[:, column] |= is_point[:, column] != (expected == "point")
        if wrong.any():
            raise self.error()
        return found

    def without_points(self) -> _Nodes:
        """The poses alone."""
        kept = int(np.sum(~self.points))
        names, values = self.names[:kept], self.values.subset(np.arange(kept))
        return _Nodes(self.path, names, values, self.points[:kept], self.number)

    def error(self) -> FormatError:
        """The error of the first line whose names do not fit."""
        kinds = ("point" if flag else "pose" for flag in self.points.tolist())
        return located(self.path, dict(zip(self.names, kinds, strict=True)))


def _nodes(path: Path, content: NamedLines) -> _Nodes:
    poses, points = content.joined("pose"), content.joined("point")
    names = tuple(name for (name,) in poses.names + points.names)
    if not names:
        raise FormatError(path, None, "no vertex lines, which name the nodes")
    number = {name: k for k, name in enumerate(names)}
    values = Estimate(
        np.concatenate([poses.rotations, points.rotations]),
        np.concatenate([poses.translations, points.translations]),
    )
    nodes = _Nodes(path, names, values, np.arange(len(names)) >= len(poses.names), number)
    if len(number) < len(names):
        raise nodes.error()
    return nodes


def _pose_words(words: list[bytes]) -> list[bytes]:
    tag = TAGS.get(words[0])
    return words[3:] if tag is not None and tag.kind == "pose" else []


def _read_poses(path: Path) -> LabelledPoses:
    nodes = _nodes(path, read_named(path, ReadOptions(ignore_information=True)))
    values, points = nodes.values, nodes.points if nodes.points.any() else None
    return LabelledPoses(values.rotations, values.translations, names=nodes.names, points=points)


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    _refuse_choices(path, options)
    content = read_named(path, options)
    nodes = _nodes(path, content)
    measured = {kind: _measured(nodes, content, kind, options) for kind in ENDS}
    if options.skip_landmarks:
        nodes = nodes.without_points()
    graph, information = _graph(path, nodes, measured)
    names, values, origin, world = nodes.names, nodes.values, None, None
    # Vertices that are all at the origin only name the nodes.
    known = np.any(values.translations) or np.any(values.rotations != np.eye(values.d))
    notices = [counted(count, what) for what, count in content.counts.items() if count]
    if nodes.points.any():
        seen = counted(len(measured["sighting"][0]), "sighting{s}")
        notices.append(f"{counted(int(nodes.points.sum()), 'point{s}')}, {seen}")
    priors = _priors(measured)
    if priors is not None:
        graph, origin, notice = anchored_graph(graph, priors)
        notices.append(notice)
        world, names = len(names), (*names, unused(_WORLD, nodes.names))
        information = joined_information([information, priors.information])
    pairs, part = measured["range"]
    if len(pairs):
        notices.append(counted(len(pairs), "range{s}"))
    instance = Instance(
        name=uncompressed_name(path).stem,
        graph=graph,
        ids=np.arange(graph.num_nodes),
        source=str(path),
        options={"rotation_information": "tangent", "weights_are": "covariance"},
        notices=tuple(notices),
        names=names,
        information=information,
        world=world,
        origin=origin,
        ranges=Ranges(graph.num_nodes, pairs, part.numbers, part.tau) if len(pairs) else None,
    )
    return replace(instance, initial=instance.with_world(values) if known else None)


def _refuse_choices(path: Path, options: ReadOptions) -> None:
    if options.rotation_information not in (None, "tangent"):
        said = f"not {options.rotation_information}"
        raise FormatError(path, None, f"the rotational covariances are about tangents, {said}")
    if options.weights_are == "sqrt-information":
        raise FormatError(path, None, "the numbers are covariances, not sqrt-information")


def _measured(
    nodes: _Nodes, content: NamedLines, kind: Kind, options: ReadOptions
) -> tuple[IntArray, NamedPart]:
    """The nodes (k, names) of measurements of a kind, and what is measured."""
    part = content.joined(kind)
    ends = nodes.of(kind, part)
    if not options.skip_landmarks:
        return ends, part
    kept = np.asarray(~nodes.points[ends].any(axis=1))
    what = "range{s} to points" if kind == "range" else "prior{s} of points"
    content.counts[f"{what} skipped"] += int(np.sum(~kept))
    return ends[kept], part.subset(kept)


def _graph(
    path: Path, nodes: _Nodes, measured: Mapping[Kind, tuple[IntArray, NamedPart]]
) -> tuple[PoseGraph, Information | None]:
    """Measurements between poses, then those of points, and their information."""
    of_graph: tuple[Kind, ...] = ("edge", "sighting")
    parts = [measured[kind] for kind in of_graph if len(measured[kind][0])]
    if not parts:
        if any(len(ends) for ends, _ in measured.values()):
            said = "no edges: measurements between poses, or of points, expected with ranges"
            raise FormatError(path, None, said)
        raise NoMeasurements(path, None, "no edges: this is an estimate, not a graph")
    R, t, kappa, tau = _concatenated([part for _, part in parts])
    pairs = np.concatenate([ends for ends, _ in parts])
    points = nodes.points if nodes.points.any() else None
    graph = PoseGraph(RotationGraph(len(nodes.names), pairs, R, kappa), t, tau, points=points)
    return graph, joined_information([part.information for _, part in parts])


def _priors(measured: Mapping[Kind, tuple[IntArray, NamedPart]]) -> Priors | None:
    of_one: tuple[Kind, ...] = ("prior", "position")
    parts = [measured[kind] for kind in of_one if len(measured[kind][0])]
    if not parts:
        return None
    R, t, kappa, tau = _concatenated([part for _, part in parts])
    nodes = np.concatenate([ends[:, 0] for ends, _ in parts])
    information = joined_information([part.information for _, part in parts])
    return Priors(nodes, R, t, kappa, tau, information, np.full(len(nodes), BODY))


def _concatenated(parts: list[NamedPart]) -> Iterator[FloatArray]:
    for name in ("rotations", "translations", "kappa", "tau"):
        yield np.concatenate([getattr(part, name) for part in parts])


FORMAT = Format(
    name="pyfg",
    suffixes=(".pyfg",),
    recognises=is_named,
    holds="poses, points, measurements and ranges",
    read_graph=_read_graph,
    read_poses=_read_poses,
    write_graph=write_graph,
    write_poses=write_poses,
    holds_points=True,
    holds_ranges=True,
    chart=Chart("quaternion", _pose_words, planar_angle=True),
)
