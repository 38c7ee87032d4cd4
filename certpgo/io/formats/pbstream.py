"""Cartographer's .pbstream: the pose graph in the state that it serializes.

Eight bytes, then records of a size (uint64) and gzip-compressed protocol buffers, as in its
cartographer/io/proto_stream.cc; the graph is field 1 of a SerializedData (mapping/proto):

    PoseGraph        constraint = 2, trajectory = 4
    Constraint       submap_id = 1, node_id = 2, relative_pose = 3, tag = 5,
                     translation_weight = 6, rotation_weight = 7
    SubmapId NodeId  trajectory_id = 1, index = 2
    Trajectory       node = 1, submap = 2, trajectory_id = 3
    Node             timestamp = 1, pose = 5, node_index = 7
    Submap           pose = 1, submap_index = 2
    Rigid3d          translation = 1 and rotation = 2, with x y z and x y z w from 1

Submaps and nodes are poses; a constraint is where a node is in a submap. Its residuals are errors
times weights, of which the squares are the information: in the plane that is the cost of EdgeSE2.
What else Cartographer minimises (odometry, IMU, Huber's loss of loop closures) is left out.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import FormatError, NoMeasurements, in_file
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.keys import NO_TIME
from certpgo.graph.phrases import counted
from certpgo.io.compressed import largest
from certpgo.io.edge_weights import weighed
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses, ReadOptions
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import FloatArray, IntArray

_MAGIC = struct.pack("<Q", 0x7B1D1F7B5BF501DB)
_SIZE = struct.Struct("<Q")
#: For zlib: with gzip's header.
_GZIP = 31
#: Fields that a file of any size may have.
_FEW = 1 << 16
#: Ticks of 100 ns from the year 1 to 1970.
_EPOCH = 719162 * 86400 * 10**7
#: Fields of a message: numbers, or the bytes of a text or message.
_Fields = dict[int, list[Any]]
#: A submap or a node by kind, trajectory and index.
_Key = tuple[str, int, int]


@dataclass(frozen=True)
class _State:
    """Poses (x y z, then x y z w) by what they are of, times of nodes, and constraints."""

    poses: dict[_Key, FloatArray]
    ticks: dict[_Key, int]
    constraints: list[tuple[_Key, _Key, FloatArray, float, float, int]]


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith(_MAGIC)


class _Messages:
    """Reads messages, with no more fields than the file has bytes; a ValueError says that not."""

    def __init__(self, path: Path) -> None:
        self._room = max(readable(path).stat().st_size, _FEW)

    def fields(self, data: bytes) -> _Fields:
        """The fields of a message."""
        found: _Fields = defaultdict(list)
        for number, value in _values(data):
            self._room -= 1
            if self._room < 0:
                raise ValueError
            found[number].append(value)
        return found

    def pose(self, data: bytes) -> FloatArray:
        """The position, then the quaternion, x y z w."""
        parts = self.fields(data)
        t, q = (self.fields(_one(parts, number, b"")) for number in (1, 2))
        return np.array([_number(t, k) for k in (1, 2, 3)] + [_number(q, k) for k in (1, 2, 3, 4)])


def _values(data: bytes) -> Iterator[tuple[int, Any]]:
    """The numbers of fields and their values; a ValueError or struct.error if it is no message."""
    value: Any
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            value, at = _varint(data, at)
        elif kind == 1:
            (value,), at = struct.unpack_from("<d", data, at), at + 8
        elif kind == 5:
            (value,), at = struct.unpack_from("<f", data, at), at + 4
        elif kind == 2:
            size, at = _varint(data, at)
            if at + size > len(data):
                raise ValueError
            value, at = data[at : at + size], at + size
        else:
            raise ValueError
        yield tag >> 3, value


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 64 and at < len(data):
        byte, at = data[at], at + 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
    raise ValueError


def _one(fields: _Fields, number: int, otherwise: Any) -> Any:
    """The last value of a field, which may be left out where it is zero."""
    return fields[number][-1] if number in fields else otherwise


def _number(fields: _Fields, number: int) -> float:
    """A finite number; ValueError if it is none."""
    value = _one(fields, number, 0.0)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _integer(fields: _Fields, number: int) -> int:
    """An integer of 63 bits; ValueError if it is none."""
    value = _one(fields, number, 0)
    if not isinstance(value, int) or value >= 2**63:
        raise ValueError
    return value


def _records(path: Path) -> Iterator[bytes]:
    """The decompressed records."""
    content, at, room = readable(path).read_bytes(), len(_MAGIC), largest(path)
    while at < len(content):
        (size,) = _SIZE.unpack_from(content, at)
        begin, at = at + _SIZE.size, at + _SIZE.size + size
        if at > len(content):
            raise ValueError
        stream = zlib.decompressobj(_GZIP)
        record = stream.decompress(content[begin:at], room + 1)
        room -= len(record)
        if room < 0:
            raise FormatError(path, None, "expands out of proportion to its size")
        if not stream.eof:
            raise ValueError
        yield record


def _read(path: Path) -> _State:
    messages = _Messages(path)
    try:
        for record in _records(path):
            for graph in messages.fields(record).get(1, []):
                if isinstance(graph, bytes):
                    return _state(messages, messages.fields(graph))
    except FormatError:
        raise
    except (ValueError, struct.error, zlib.error, TypeError):
        raise FormatError(path, None, "a state of Cartographer expected; this is damaged") from None
    raise FormatError(path, None, "no pose graph in this state of Cartographer")


def _state(messages: _Messages, graph: _Fields) -> _State:
    poses: dict[_Key, FloatArray] = {}
    ticks: dict[_Key, int] = {}
    trajectories = [messages.fields(data) for data in graph[4]]
    for number, trajectory in zip(_numbers(trajectories, 3), trajectories, strict=True):
        for kind, field, pose, index in (("submap", 2, 1, 2), ("node", 1, 5, 7)):
            entries = [messages.fields(data) for data in trajectory[field]]
            for k, entry in zip(_numbers(entries, index), entries, strict=True):
                poses[kind, number, k] = messages.pose(_one(entry, pose, b""))
                if kind == "node":
                    ticks[kind, number, k] = _integer(entry, 1)
    constraints = []
    for entry in map(messages.fields, graph[2]):
        ends = []
        for kind, field in (("submap", 1), ("node", 2)):
            where = messages.fields(_one(entry, field, b""))
            ends.append((kind, _integer(where, 1), _integer(where, 2)))
        measured = messages.pose(_one(entry, 3, b""))
        weights = _number(entry, 6), _number(entry, 7)
        constraints.append((ends[0], ends[1], measured, *weights, _integer(entry, 5)))
    return _State(poses, ticks, constraints)


def _numbers(entries: list[_Fields], field: int) -> list[int]:
    """What numbers entries have; in files of early versions, which state none, their places."""
    if not any(field in entry for entry in entries):
        return list(range(len(entries)))
    return [_integer(entry, field) for entry in entries]


def _times(path: Path, state: _State, keys: list[_Key]) -> IntArray:
    """Nanoseconds since 1970, `NO_TIME` for submaps."""
    times = [100 * (state.ticks[k] - _EPOCH) if k in state.ticks else NO_TIME for k in keys]
    if not all(NO_TIME <= time < -NO_TIME for time in times):
        raise FormatError(path, None, "timestamps expected of the years 1678 to 2261")
    return np.array(times)


def _rigid(path: Path, poses: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Rotations and translations of poses (k, 7), in the plane of their yaw."""
    with in_file(path):
        R = quaternion.rotations(poses[:, 3:])
    if d == 3:
        return R, poses[:, :3]
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return quaternion.planar_rotations(yaw), poses[:, :2]


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    state = _read(path)
    if not state.constraints:
        raise NoMeasurements(path, None, "no constraints: this state has poses alone")
    measured = np.array([pose for _, _, pose, *_ in state.constraints])
    d = 3 if measured[:, 2:5].any() else 2
    ends = [(submap, node) for submap, node, *_ in state.constraints]
    keys = sorted({key for pair in ends for key in pair})
    place = {key: k for k, key in enumerate(keys)}
    R, t = _rigid(path, measured, d)
    with np.errstate(over="ignore"):
        weights = np.array([row[3:5] for row in state.constraints]) ** 2
    information = np.repeat(weights, (d, d * (d - 1) // 2), axis=1)
    matrices = information[:, :, None] * np.eye(information.shape[1])
    names = tuple(f"{kind}{trajectory}/{index}" for kind, trajectory, index in keys)

    def named(k: int) -> str:
        return " to ".join(names[place[end]] for end in ends[k])

    weighing = weighed(path, matrices, R, options, named)
    pairs = np.array([[place[end] for end in pair] for pair in ends])
    rotation = RotationGraph(len(keys), pairs, R, weighing.kappa)
    loops = sum(row[5] for row in state.constraints)
    said = counted(loops, "loop closure{s}, without Huber's loss that Cartographer has of these")
    own = weighing.information
    if own is not None and d == 2:
        own = replace(own, residual="g2o")
    known = all(key in state.poses for key in keys)
    initial = (
        Estimate(*_rigid(path, np.array([state.poses[k] for k in keys]), d)) if known else None
    )
    return Instance(
        name=path.stem,
        graph=PoseGraph(rotation, t, weighing.tau, information=own),
        ids=np.arange(len(keys)),
        initial=initial,
        source=str(path),
        options={"weights_are": "sqrt-information"},
        notices=(*weighing.notices, *([said] if loops else [])),
        names=names,
        times_ns=_times(path, state, keys),
    )


def _read_poses(path: Path) -> LabelledPoses:
    state = _read(path)
    keys = [key for key in state.poses if key[0] == "node"]
    if not keys:
        raise FormatError(path, None, "no nodes of trajectories in this state of Cartographer")
    R, t = _rigid(path, np.array([state.poses[key] for key in keys]), 3)
    names = tuple(f"{kind}{trajectory}/{index}" for kind, trajectory, index in keys)
    return LabelledPoses(R, t, times_ns=_times(path, state, keys), names=names)


FORMAT = Format(
    name="pbstream",
    suffixes=(),
    recognises=_recognises,
    holds="a pose graph",
    read_graph=_read_graph,
    read_poses=_read_poses,
)
