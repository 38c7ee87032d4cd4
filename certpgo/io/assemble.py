"""From what a file said, under its own ids, to nodes 0 ... n-1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph
from certpgo.io.chunks import text_lines
from certpgo.io.format import LabelledPoses
from certpgo.io.lines import TaggedLines
from certpgo.io.plural import counted
from certpgo.linalg.arrays import FloatArray, IntArray


def numbered(ids: IntArray, wanted: IntArray) -> IntArray:
    """Position in ``ids`` (ascending) of each of ``wanted``; -1 where it is not there."""
    place = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.asarray(np.where(ids[place] == wanted, place, -1), dtype=np.intp)


def distinct(ids: IntArray) -> IntArray:
    """The distinct ids, ascending (sorting is several times faster than np.unique's hashing)."""
    ordered = np.sort(ids)
    first = np.r_[np.ones(len(ids[:1]), np.bool_), ordered[1:] != ordered[:-1]]
    return np.asarray(ordered[first], dtype=np.intp)


def instance_from_lines(path: Path, said: TaggedLines, options: Mapping[str, str]) -> Instance:
    """The instance a file of tagged lines describes.

    Raises
    ------
    FormatError
        There are no edges, a vertex appears twice, or a fixed node is unknown.
    """
    if not said.edges:
        what = "no edges: this is an estimate, not a graph" if said.vertices else "no edges"
        raise FormatError(path, None, what)
    pairs = np.concatenate(said.edges)
    R, t = joined(said.measured)
    kappa, tau = joined(said.weights)
    said.measured.clear()
    vertices = np.concatenate([*said.vertices, np.empty(0, dtype=np.intp)])
    refuse_duplicates(path, vertices)
    ids = distinct(np.concatenate([vertices, pairs.ravel()]))
    notices = [counted(count, what) for what, count in said.counts.items() if count]
    rotation = RotationGraph(len(ids), numbered(ids, pairs), R, kappa)
    graph: Graph = PoseGraph(rotation, t, tau) if t.any() else rotation
    if graph is rotation:
        notices.append("all translations are zero: read as a rotation graph")
    fixed = numbered(ids, np.array(said.fixed, dtype=np.intp))
    if (fixed < 0).any():
        raise FormatError(path, None, f"FIX {said.fixed[int(np.argmin(fixed))]}: no such node")
    initial = None
    if said.vertices:
        values = LabelledPoses(*joined(said.values), ids=vertices)
        missing = len(ids) - len(vertices)
        if missing:
            notices.append(counted(missing, "node{s} without a vertex line: no initial values"))
        else:
            initial = estimate_for(ids, values, isinstance(graph, PoseGraph))
    return Instance(
        name=path.stem,
        graph=graph,
        ids=ids,
        initial=initial,
        fixed=tuple(fixed.tolist()),
        source=str(path),
        options=options,
        notices=tuple(notices),
    )


def poses_from_lines(path: Path, said: TaggedLines) -> LabelledPoses:
    """The vertex lines of a file.

    Raises
    ------
    FormatError
        There are none, or one appears twice.
    """
    if not said.vertices:
        raise FormatError(path, None, "no vertex lines")
    ids = np.concatenate(said.vertices)
    refuse_duplicates(path, ids)
    R, t = joined(said.values)
    return LabelledPoses(R, t, ids=ids)


def joined(pairs: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Both halves of the chunks, each as one array."""
    return np.concatenate([p for p, _ in pairs]), np.concatenate([q for _, q in pairs])


def refuse_duplicates(path: Path, ids: IntArray) -> None:
    """Refuse a node id that occurs twice.

    Raises
    ------
    FormatError
        With the line of its second occurrence.
    """
    ordered = np.sort(ids)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(repeated):
        node = int(repeated[0])
        raise FormatError(path, _second_line(path, node), f"node {node} appears twice")


def _second_line(path: Path, node: int) -> int | None:
    # A vertex line is a tag and the id, a line of another format starts with the id.
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
        A node has no pose, a pose has no node, or translations are wanted and absent.
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
        No node has one.
    """
    n = instance.graph.num_nodes
    with_translations = isinstance(instance.graph, PoseGraph) and poses.translations is not None
    if poses.ids is None:
        return np.arange(n), estimate_for(instance.ids, poses, with_translations)
    place = numbered(instance.ids, poses.ids)
    known = np.flatnonzero(place >= 0)
    if not len(known):
        raise InputError("another graph's truth: no id is in the graph")
    order = known[np.argsort(place[known])]
    translations = poses.translations if with_translations else None
    return place[order], Estimate(
        poses.rotations[order], None if translations is None else translations[order]
    )


def _matched(ids: IntArray, given: IntArray) -> IntArray:
    """For each of ``ids``, its place in ``given``."""
    place = numbered(ids, given)
    foreign = given[place < 0]
    if len(foreign):
        raise InputError(
            f"another graph's estimate: node {foreign.min()} is not in the graph "
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
