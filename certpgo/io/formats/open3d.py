"""Open3D's pose graphs, JSON: nodes with poses, and edges with information.

    {"class_name": "PoseGraph", "nodes": [{"pose": [16]}, ...],
     "edges": [{"source_node_id", "target_node_id", "transformation": [16],
                "information": [36], "uncertain", "confidence"}, ...]}

Matrices are column by column. A pose maps a node's points to the world, and a transformation the
source's points to the target: it is our measurement from i = target to j = source. The residual is
the translation and the sine of the angle times the axis of X^-1 T_i^-1 T_j, and its information has
rotation before translation; to second order the rotational part refers to the tangent space.
Nodes have no ids but their places.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import FormatError, InputError, NoMeasurements, in_file
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph
from certpgo.graph.keys import Keys
from certpgo.graph.phrases import counted
from certpgo.graph.trees import tree_initialization
from certpgo.io.compressed import uncompressed_name
from certpgo.io.edge_weights import weighed
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses, ReadOptions
from certpgo.io.json_files import read_json
from certpgo.linalg.arrays import FloatArray, IntArray

_CLASS = re.compile(rb'"class_name"\s*:\s*"PoseGraph(Node|Edge)?"')
#: From rotation before translation to translation before rotation, and back.
_ORDER = [3, 4, 5, 0, 1, 2]
_VERSION = {"version_major": 1, "version_minor": 0}
_Entries = list[Any]


def _recognises(path: Path, head: bytes) -> bool:
    return head.lstrip().startswith(b"{") and _CLASS.search(head) is not None


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    content = _content(path)
    nodes, edges = _entries(path, content, "nodes"), _entries(path, content, "edges")
    if not edges:
        raise NoMeasurements(path, None, "edges: none: this is an estimate, not a graph")
    n = len(nodes)
    R, t = _poses(path, edges, "edges", "transformation")
    pairs = _pairs(path, edges, n)
    information = _table(path, edges, "edges", "information", 36).reshape(-1, 6, 6)
    weighing = weighed(
        path,
        information[:, _ORDER][:, :, _ORDER],
        R,
        options,
        lambda k: f"edges[{k}].information",
    )
    notices = list(weighing.notices)
    if uncertain := sum(edge.get("uncertain") is True for edge in edges):
        said = "edge{s} uncertain: read with all of the information, which Open3D may scale down"
        notices.append(counted(uncertain, said))
    rotation = RotationGraph(n, pairs, R, weighing.kappa)
    return Instance(
        name=uncompressed_name(path).stem,
        graph=PoseGraph(rotation, t, weighing.tau, information=weighing.information),
        ids=np.arange(n),
        initial=Estimate(*_poses(path, nodes, "nodes", "pose")),
        source=str(path),
        notices=tuple(notices),
    )


def _read_poses(path: Path) -> LabelledPoses:
    nodes = _entries(path, _content(path), "nodes")
    if not nodes:
        raise FormatError(path, None, "nodes: at least one expected")
    return LabelledPoses(*_poses(path, nodes, "nodes", "pose"), ids=np.arange(len(nodes)))


def _content(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict) or content.get("class_name") != "PoseGraph":
        raise FormatError(path, None, 'class_name: "PoseGraph" expected')
    return content


def _entries(path: Path, content: dict[str, Any], key: str) -> _Entries:
    found = content.get(key)
    if found is None:  # as Open3D writes an empty list
        return []
    if not isinstance(found, list):
        raise FormatError(path, None, f"{key}: a list expected")
    for k, entry in enumerate(found):
        if not isinstance(entry, dict):
            raise FormatError(path, None, f"{key}[{k}]: an object expected")
    return found


def _table(path: Path, entries: _Entries, kind: str, key: str, size: int) -> FloatArray:
    """The numbers (k, size) of all entries under a key."""
    values = [entry.get(key) for entry in entries]
    for k, value in enumerate(values):
        if not (isinstance(value, list) and len(value) == size and all(map(_is_number, value))):
            raise FormatError(path, None, f"{kind}[{k}].{key}: {size} finite numbers expected")
    return np.array(values, dtype=np.float64).reshape(-1, size)


def _is_number(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return type(value) is int and abs(value) < 2**53


def _poses(path: Path, entries: _Entries, kind: str, key: str) -> tuple[FloatArray, FloatArray]:
    """Rotations (k, 3, 3) and translations (k, 3) of 4x4 matrices."""
    M = np.swapaxes(_table(path, entries, kind, key, 16).reshape(-1, 4, 4), 1, 2)
    for k in np.flatnonzero((M[:, 3] != [0.0, 0.0, 0.0, 1.0]).any(axis=1)).tolist():
        said = "a pose column by column expected, the last row 0 0 0 1"
        raise FormatError(path, None, f"{kind}[{k}].{key}: {said}")
    with in_file(path):
        q = quaternion.from_matrices(M[:, :3, :3], lambda k: f"{kind}[{k}].{key}")
    return quaternion.rotations(q), np.ascontiguousarray(M[:, :3, 3])


def _pairs(path: Path, edges: _Entries, n: int) -> IntArray:
    """The target and the source of each edge."""
    pairs = [[edge.get(f"{end}_node_id") for end in ("target", "source")] for edge in edges]
    for k, pair in enumerate(pairs):
        for node, end in zip(pair, ("target", "source"), strict=True):
            if not (_is_number(node) and node == int(node) and 0 <= node < n):
                said = f"edges[{k}].{end}_node_id: one of the {counted(n, 'node{s}')} expected"
                raise FormatError(path, None, f"{said}, numbered from 0")
        if pair[0] == pair[1]:
            raise FormatError(
                path, None, f"edges[{k}]: node {int(pair[0])} is measured from itself"
            )
    return np.array(pairs).astype(np.intp)


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    if estimate.translations is None:
        raise InputError("open3d needs translations; the estimate has rotations only")
    _write(path, _nodes(estimate), [])


def _write_graph(path: Path, instance: Instance) -> None:
    graph = instance.graph
    if not graph.has_positions:
        raise InputError("open3d holds poses, and this graph measures rotations alone")
    if graph.d == 2:
        raise InputError("open3d holds poses in space, and this graph is planar")
    if instance.world is not None or graph.is_point.any():
        raise InputError("open3d holds poses alone, neither priors nor points")
    initial = instance.initial
    if initial is None:
        # Open3D begins where the nodes are.
        initial = tree_initialization(graph) if graph.is_connected else _at_origin(graph)
    information = _information(graph)[:, _ORDER][:, :, _ORDER]
    edges = [
        {
            "class_name": "PoseGraphEdge",
            **_VERSION,
            "source_node_id": source,
            "target_node_id": target,
            "transformation": numbers,
            "information": matrix,
            "uncertain": False,
            "confidence": 1.0,
        }
        for (target, source), numbers, matrix in zip(
            graph.edges.tolist(),
            _columns(graph.rotations, graph.translations),
            information.reshape(-1, 36).tolist(),
            strict=True,
        )
    ]
    _write(path, _nodes(initial), edges)


def _at_origin(graph: Graph) -> Estimate:
    n = graph.num_nodes
    return Estimate(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))


def _information(graph: Graph) -> FloatArray:
    """(m, 6, 6) matrices, translation before rotation: the source's, or of kappa and tau."""
    if graph.information is None:
        diagonal = np.repeat(np.stack([graph.tau, 2.0 * graph.kappa], axis=1), 3, axis=1)
        return diagonal[:, :, None] * np.eye(6)
    return graph.information.about_tangents().matrices


def _columns(R: FloatArray, t: FloatArray) -> list[list[float]]:
    """The 16 numbers of each pose, column by column."""
    M = np.tile(np.eye(4), (len(R), 1, 1))
    M[:, :3, :3], M[:, :3, 3] = R, t
    columns: list[list[float]] = np.swapaxes(M, 1, 2).reshape(-1, 16).tolist()
    return columns


def _nodes(estimate: Estimate) -> list[dict[str, Any]]:
    R, t = quaternion.embedded(estimate.rotations), estimate.translations
    t = np.zeros(R.shape[:2]) if t is None else quaternion.embedded_translations(t)
    return [
        {"class_name": "PoseGraphNode", **_VERSION, "pose": numbers}
        for numbers in _columns(R, np.asarray(t))
    ]


def _write(path: Path, nodes: _Entries, edges: _Entries) -> None:
    """Write the file, a line for each node and edge."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f'{{"class_name": "PoseGraph",\n{json.dumps(_VERSION)[1:-1]},\n')
        file.write(f'"nodes": [{_lines(nodes)}],\n"edges": [{_lines(edges)}]}}\n')


def _lines(entries: Sequence[Any]) -> str:
    return "\n" + ",\n".join(map(json.dumps, entries)) + "\n" if entries else ""


FORMAT = Format(
    name="open3d",
    suffixes=(".json",),
    recognises=_recognises,
    holds="poses and measurements",
    read_graph=_read_graph,
    read_poses=_read_poses,
    write_graph=_write_graph,
    write_poses=_write_poses,
)
