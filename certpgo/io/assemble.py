"""From the contents of a file, with its own ids, to nodes 0 ... n-1."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import FormatError, InputError, NoEdges, NoMeasurements
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information, of_positions
from certpgo.graph.wording import counted
from certpgo.io.chunks import text_lines
from certpgo.io.compressed import uncompressed_name
from certpgo.io.contents import TaggedLines
from certpgo.io.format import LabelledPoses, ReadOptions
from certpgo.io.landmarks import Landmarks, landmarks_of
from certpgo.io.lines import UNINFORMED, Dialect, read_lines
from certpgo.io.priors import anchored_graph, joined_information, numbered_priors
from certpgo.linalg.arrays import FloatArray, IntArray, numbered

#: What becomes of nodes that a file fixes: one chooses the frame, more are measurements.
FREED = "all are estimated, and only differences between poses are measured"
#: Largest translation, metres.
FARTHEST = 1e90


def distinct(ids: IntArray) -> IntArray:
    """The distinct ids, ascending (sorting is faster than np.unique's hashing)."""
    ordered = np.sort(ids)
    first = np.r_[np.ones(len(ids[:1]), np.bool_), ordered[1:] != ordered[:-1]]
    return np.asarray(ordered[first], dtype=np.intp)


def instance_from_lines(dialect: Dialect, path: Path, options: ReadOptions) -> Instance:
    """The instance in a file of tagged lines."""
    content = read_lines(path, dialect, options)
    if not (content.edges or content.sightings):
        if content.vertices:
            raise NoMeasurements(path, None, "no edges: this is an estimate, not a graph")
        raise NoEdges(path, None, "no edges")
    joined_edges = _all_edges(path, content, dialect.residual)
    pairs, (R, t), (kappa, tau) = joined_edges.pairs, joined_edges.measured, joined_edges.weights
    _refuse_far(path, pairs, t)
    content.measured.clear()
    vertices, landmarks = joined_edges.vertices, joined_edges.landmarks
    refuse_duplicates(path, vertices)
    ids = distinct(np.concatenate([vertices, pairs.ravel()]))
    notices = [counted(count, what) for what, count in content.counts.items() if count]
    rotation = RotationGraph(len(ids), numbered(ids, pairs), R, kappa)
    priors = numbered_priors(path, content, ids)
    graph: Graph = rotation
    if landmarks is not None:
        graph = PoseGraph(rotation, t, tau, points=np.isin(ids, landmarks.ids))
        notices.append(_about(landmarks))
    elif t.any() or priors:
        graph = PoseGraph(rotation, t, tau)
    else:
        notices.append("all translations are zero: read as a rotation graph")
    fixed = numbered(ids, np.array(content.fixed, dtype=np.intp))
    if (fixed < 0).any():
        raise FormatError(path, None, f"FIX {content.fixed[int(np.argmin(fixed))]}: no such node")
    if len(fixed) > 1:
        notices.append(f"{len(fixed)} nodes fixed by the file: {FREED}")
    initial = None
    if len(vertices):
        values = LabelledPoses(*joined_edges.values, ids=vertices)
        missing = len(ids) - len(vertices)
        if missing:
            notices.append(counted(missing, "node{s} without a vertex line: no initial values"))
        else:
            initial = estimate_for(ids, values, isinstance(graph, PoseGraph))
    information = None
    if isinstance(graph, PoseGraph):
        information = joined_information(joined_edges.information)
    world, origin = None, None
    if isinstance(graph, PoseGraph) and priors is not None:
        _refuse_far(path, np.stack([ids[priors.nodes]] * 2, axis=1), priors.translations)
        if ids[-1] == np.iinfo(ids.dtype).max:
            raise FormatError(path, None, f"node {ids[-1]} leaves no id for the world")
        graph, origin, notice = anchored_graph(graph, priors)
        notices.append(notice)
        world, ids = len(ids), np.append(ids, ids[-1] + 1)
        information = joined_information([information, priors.information])
    stated = options.weights_are
    if stated != "information":
        notices.append(f"the numbers of a measurement's precision are read as its {stated}")
    instance = Instance(
        name=uncompressed_name(path).stem,
        graph=graph,
        ids=ids,
        fixed=tuple(fixed.tolist()),
        source=str(path),
        options={
            "rotation_information": options.rotation_information or dialect.rotation_information,
            **_uninformed(content.counts[UNINFORMED], len(pairs)),
            **({} if stated == "information" else {"weights_are": stated}),
        },
        notices=tuple(notices),
        information=information,
        world=world,
        origin=origin,
        **_numbered_apart(landmarks, ids),
    )
    return replace(instance, initial=None if initial is None else instance.with_world(initial))


@dataclass(frozen=True)
class _AllEdges:
    """Measurements between poses, then those of points, with ids; and initial values."""

    pairs: IntArray
    measured: tuple[FloatArray, FloatArray]
    weights: tuple[FloatArray, FloatArray]
    information: list[Information | None]
    vertices: IntArray
    values: tuple[FloatArray, FloatArray]
    landmarks: Landmarks | None


def _all_edges(path: Path, content: TaggedLines, residual: str | None) -> _AllEdges:
    d = content.d
    measured = [*content.measured, (np.empty((0, d, d)), np.empty((0, d)))]
    values = [*content.values, measured[-1]]
    vertices = np.concatenate([*content.vertices, np.empty(0, dtype=np.intp)])
    pairs = np.concatenate([*content.edges, np.empty((0, 2), dtype=np.intp)])
    weights, information = list(content.weights), list(content.information)
    landmarks = landmarks_of(path, content, distinct(np.concatenate([vertices, pairs.ravel()])))
    if landmarks is not None:
        k, (points, positions) = len(landmarks.tau), landmarks.vertices
        measured.append((np.tile(np.eye(d), (k, 1, 1)), landmarks.positions))
        values.append((np.tile(np.eye(d), (len(points), 1, 1)), positions))
        weights.append((np.zeros(k), landmarks.tau))
        matrices = landmarks.information
        if matrices is None:
            information.append(None)
        else:
            information.append(Information(of_positions(matrices), np.arange(k), residual))
        pairs = np.concatenate([pairs, landmarks.pairs])
        vertices = np.concatenate([vertices, points])
    return _AllEdges(
        pairs, joined(measured), joined(weights), information, vertices, joined(values), landmarks
    )


def _numbered_apart(landmarks: Landmarks | None, ids: IntArray) -> dict[str, Any]:
    """Which nodes are landmarks that are numbered apart, as `Instance` says it."""
    if landmarks is None or not len(landmarks.apart):
        return {}
    return {"apart": np.isin(ids, landmarks.apart), "moved_by": landmarks.moved_by}


def _about(landmarks: Landmarks) -> str:
    said = f"{counted(len(landmarks.ids), 'point{s}')}, "
    said += counted(len(landmarks.tau), "sighting{s}")
    if landmarks.moved_by:
        said += f"; point k has the id k + {landmarks.moved_by}"
    return said


def _refuse_far(path: Path, pairs: IntArray, t: FloatArray) -> None:
    """Refuse a translation whose square, times a weight, may be beyond the range of doubles."""
    largest = np.abs(t).max(axis=1)
    edge = int(np.argmax(largest))
    if largest[edge] > FARTHEST:
        i, j = pairs[edge]
        said = f"edge {i} to {j}: translations up to {FARTHEST:.0e} expected, not {largest[edge]:g}"
        raise FormatError(path, None, said)


def _uninformed(without: int, edges: int) -> dict[str, str]:
    """The option ``information``, present where edges lack it."""
    if not without:
        return {}
    return {"information": "none" if without == edges else "some"}


def poses_from_lines(dialect: Dialect, path: Path) -> LabelledPoses:
    """The poses on the vertex lines of a file."""
    content = read_lines(path, dialect, ReadOptions(ignore_information=True))
    if not content.vertices:
        raise FormatError(path, None, "no vertex lines")
    ids, points = np.concatenate(content.vertices), None
    R, t = joined(content.values)
    if content.points:
        of_points = np.concatenate([ids for ids, _ in content.points])
        points = np.arange(len(ids) + len(of_points)) >= len(ids)
        ids = np.concatenate([ids, of_points])
        R = np.concatenate([R, np.tile(np.eye(content.d), (len(of_points), 1, 1))])
        t = np.concatenate([t, *(positions for _, positions in content.points)])
    refuse_duplicates(path, ids)
    return LabelledPoses(R, t, ids=ids, points=points)


def joined(pairs: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """The first and second arrays of all chunks, concatenated."""
    return np.concatenate([p for p, _ in pairs]), np.concatenate([q for _, q in pairs])


def refuse_duplicates(path: Path, ids: IntArray) -> None:
    """Refuse a node id that occurs twice, naming the line of the second occurrence."""
    ordered = np.sort(ids)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(repeated):
        node = int(repeated[0])
        raise FormatError(path, _second_line(path, node), f"node {node} appears twice")


def _second_line(path: Path, node: int) -> int | None:
    # A vertex line starts with a tag and the id, a line of other formats with the id.
    seen = 0
    for number, line in text_lines(path):
        words = line.split(None, 2)[:2]
        if words and not words[0].lstrip(b"-").isdigit():
            words = words[1:] if words[0].startswith(b"VERTEX") else []
        if words and _is_integer(words[0], node):
            seen += 1
            if seen == 2:
                return number
    return None


def _is_integer(word: bytes, value: int) -> bool:
    try:
        return int(word) == value
    except ValueError:
        return False


def estimate_for(ids: IntArray, poses: LabelledPoses, with_translations: bool) -> Estimate:
    """The poses of the nodes ``ids`` (ascending), in that order.

    Raises
    ------
    InputError
        A node has no pose, a pose has no node, or translations are missing.
    """
    if poses.ids is None:
        if len(poses.rotations) != len(ids):
            raise InputError(
                f"{counted(len(poses.rotations), 'pose{s}')} for the graph's "
                f"{counted(len(ids), 'node{s}')}"
            )
        order: IntArray = np.arange(len(ids))
    else:
        order = _matched(ids, poses.ids)
    if not with_translations:
        return Estimate(poses.rotations[order])
    if poses.translations is None:
        raise InputError("rotations only, but the graph measures translations")
    return Estimate(poses.rotations[order], poses.translations[order])


def truth_for(instance: Instance, poses: LabelledPoses) -> tuple[IntArray, Estimate]:
    """The nodes whose true pose is among ``poses``, ascending, and those poses in that order.

    Raises
    ------
    InputError
        There is none.
    """
    n = instance.graph.num_nodes
    with_translations = isinstance(instance.graph, PoseGraph) and poses.translations is not None
    if poses.ids is None:
        return np.arange(n), estimate_for(instance.ids, poses, with_translations)
    place = numbered(instance.ids[: instance.world], poses.ids)
    known = np.flatnonzero(place >= 0)
    if not len(known):
        raise InputError("truth of another graph: no id is in the graph")
    order = known[np.argsort(place[known])]
    translations = poses.translations if with_translations else None
    return place[order], Estimate(
        poses.rotations[order], None if translations is None else translations[order]
    )


def _matched(ids: IntArray, given: IntArray) -> IntArray:
    """The position of each of ``ids`` in ``given``."""
    place = numbered(ids, given)
    foreign = given[place < 0]
    if len(foreign):
        raise InputError(
            f"estimate of another graph: node {foreign.min()} is not in the graph "
            f"({len(foreign)} of {len(given)} are not)"
        )
    order = np.full(len(ids), -1, dtype=np.intp)
    order[place] = np.arange(len(given))
    missing = ids[order < 0]
    if len(missing):
        raise InputError(
            f"the estimate lacks node {missing[0]} ({len(missing)} of the graph's {len(ids)} nodes)"
        )
    return order
