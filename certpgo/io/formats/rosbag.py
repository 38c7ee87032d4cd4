"""Bags of ROS 1 (.bag) and ROS 2 (a folder, .mcap, .db3): trajectories, and rtabmap's graph.

    nav_msgs/Path               its last message, whose poses have times
    nav_msgs/Odometry           a pose a message; also geometry_msgs/PoseStamped and
                                geometry_msgs/PoseWithCovarianceStamped
    rtabmap_msgs/MapGraph       its last message: poses, and links from one to another

A pose is that of the body in the frame of the message's header. A link is our measurement (i, j) =
(from, to), and its information has translation before rotation, about the tangent space.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import FormatError, NoMeasurements
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.keys import SECOND
from certpgo.io.bags import Bag, opened_bag
from certpgo.io.edge_weights import weighed
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, LabelledPoses, ReadOptions, estimate_at
from certpgo.io.nodes import distinct
from certpgo.io.rtabmap_links import BETWEEN, skipped_links
from certpgo.io.timestamps import times_and_ids
from certpgo.linalg.arrays import FloatArray, numbered

_PATHS = ("nav_msgs/msg/Path",)
_POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
#: The package's name was another until 2023.
_GRAPHS = ("rtabmap_msgs/msg/MapGraph", "rtabmap_ros/msg/MapGraph")
_SQLITE, _BAG, _MCAP = b"SQLite format 3\0", b"#ROSBAG V", b"\x89MCAP"
_METADATA = "metadata.yaml"


def _recognises(path: Path, head: bytes) -> bool:
    if path.is_dir():
        about = path / _METADATA
        return about.is_file() and b"rosbag2_bagfile_information" in about.read_bytes()[:4096]
    if head.startswith(_SQLITE):
        return path.suffix == ".db3"
    return head.startswith((_BAG, _MCAP))


def _read_graph(path: Path, options: ReadOptions, topic: str | None = None) -> Instance:
    with opened_bag(path, topic) as bag:
        topics = [name for name, kind in bag.types.items() if kind in _GRAPHS]
        if not topics:
            said = f"no rtabmap_msgs/MapGraph among the topics: {_listed(bag)}"
            raise NoMeasurements(path, None, said)
        chosen = bag.only(topics, "graphs")
        message = _last(bag, chosen)
        return _instance(path, chosen, message, options)


def _listed(bag: Bag) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in bag.types.items()) or "none"


def _last(bag: Bag, topic: str) -> Any:
    message = None
    for _, latest in bag.messages(topic):
        message = latest
    if message is None:
        raise FormatError(bag.path, None, f"{topic}: no messages")
    return message


def _instance(path: Path, topic: str, message: Any, options: ReadOptions) -> Instance:
    """The instance in rtabmap's message."""
    kinds = np.array([link.type for link in message.links], dtype=np.intp)
    links = [link for link in message.links if link.type in BETWEEN]
    if not links:
        raise NoMeasurements(path, None, f"{topic}: no links between poses")
    # The fields of ROS 1, and of ROS 2.
    ends = [(_either(link, "fromId", "from_id"), _either(link, "toId", "to_id")) for link in links]
    edges = np.array(ends, dtype=np.intp)
    loops = edges[:, 0] == edges[:, 1]
    if loops.any():
        said = f"{topic}: node {edges[np.argmax(loops), 0]} is measured from itself"
        raise FormatError(path, None, said)

    def name(k: int) -> str:
        return f"{topic}: link {edges[k, 0]} to {edges[k, 1]}"

    R, t = _rigid(
        path,
        [(link.transform.rotation, link.transform.translation) for link in links],
        name,
    )
    matrices = np.array([link.information for link in links], dtype=np.float64).reshape(-1, 6, 6)
    if not (options.ignore_information or np.isfinite(matrices).all()):
        raise FormatError(path, None, f"{topic}: finite information expected")
    weighing = weighed(path, matrices, R, options, name)
    poses = _graph_poses(path, topic, message)
    known = poses.ids if poses.ids is not None else np.empty(0, dtype=np.intp)
    ids = distinct(np.concatenate([known, edges.ravel()]))
    notices = list(weighing.notices)
    notices += skipped_links(kinds)
    rotation = RotationGraph(len(ids), numbered(ids, edges), R, weighing.kappa)
    return Instance(
        name=path.stem,
        graph=PoseGraph(rotation, t, weighing.tau, information=weighing.information),
        ids=ids,
        initial=estimate_at(poses, np.argsort(known), True) if len(known) == len(ids) else None,
        source=str(path),
        notices=tuple(notices),
    )


def _either(message: Any, *names: str) -> Any:
    return next(getattr(message, name) for name in names if hasattr(message, name))


def _graph_poses(path: Path, topic: str, message: Any) -> LabelledPoses:
    """The poses in rtabmap's message; landmarks have negative ids, and are left out."""
    ids = np.array(_either(message, "posesId", "poses_id"), dtype=np.intp)
    if len(ids) != len(message.poses) or len(np.unique(ids)) < len(ids):
        raise FormatError(path, None, f"{topic}: a pose for each of its ids expected")
    poses = [(pose.orientation, pose.position) for pose in message.poses]
    R, t = _rigid(path, poses, lambda k: f"{topic}: pose {ids[k]}")
    kept = ids >= 0
    return LabelledPoses(R[kept], t[kept], ids=ids[kept])


def _rigid(path: Path, poses: list[tuple[Any, Any]], name: Any) -> tuple[FloatArray, FloatArray]:
    """Rotations (k, 3, 3) and translations (k, 3) of ROS's quaternions and vectors."""
    numbers = np.array(
        [[q.x, q.y, q.z, q.w, p.x, p.y, p.z] for q, p in poses], dtype=np.float64
    ).reshape(-1, 7)
    bad = ~np.isfinite(numbers).all(axis=1) | ~numbers[:, :4].any(axis=1)
    if bad.any():
        said = f"{name(int(np.argmax(bad)))}: finite numbers and a quaternion expected, not zero"
        raise FormatError(path, None, said)
    return quaternion.rotations(numbers[:, :4]), numbers[:, 4:]


def _read_poses(path: Path, topic: str | None = None) -> LabelledPoses:
    with opened_bag(path, topic) as bag:
        usable = (*_PATHS, *_POSES, *_GRAPHS)
        topics = [name for name, kind in bag.types.items() if kind in usable]
        if not topics:
            said = f"a topic with poses expected ({', '.join(usable[:3])}), not {_listed(bag)}"
            raise FormatError(path, None, said)
        chosen = bag.only(topics, "poses")
        kind = bag.types[chosen]
        if kind in _GRAPHS:
            return _graph_poses(path, chosen, _last(bag, chosen))
        return _trajectory(bag, chosen, kind)


def _trajectory(bag: Bag, topic: str, kind: str) -> LabelledPoses:
    if kind in _PATHS:
        stamped = list(_last(bag, topic).poses)
        poses = [one.pose for one in stamped]
        recorded = np.zeros(len(poses), dtype=np.int64)
    else:
        received, stamped = [], []
        for time, message in bag.messages(topic):
            received.append(time)
            stamped.append(message)
        # With a covariance the pose is one level deeper.
        poses = [getattr(one.pose, "pose", one.pose) for one in stamped]
        recorded = np.array(received, dtype=np.int64)
    if not poses:
        raise FormatError(bag.path, None, f"{topic}: no poses")
    frames = sorted({one.header.frame_id for one in stamped})
    if len(frames) > 1:
        said = f"{topic}: poses in one frame expected, not in {', '.join(map(repr, frames))}"
        raise FormatError(bag.path, None, said)
    R, t = _rigid(
        bag.path,
        [(pose.orientation, pose.position) for pose in poses],
        lambda k: f"{topic}: pose {k}",
    )
    stamps = [one.header.stamp for one in stamped]
    times = np.array([stamp.sec * SECOND + stamp.nanosec for stamp in stamps], dtype=np.int64)
    known = times if times.any() else recorded
    if not known.any():
        return LabelledPoses(R, t)
    _, ids = times_and_ids(np.stack(np.divmod(known, SECOND), axis=1))
    return LabelledPoses(R, t, ids=ids, times_ns=known)


def _on_topic(topic: str) -> Format:
    return _format(topic)


def _format(topic: str | None) -> Format:
    return Format(
        name="rosbag",
        suffixes=(".bag", ".mcap", ".db3"),
        recognises=_recognises,
        holds="messages of ROS",
        read_graph=partial(_read_graph, topic=topic),
        read_poses=partial(_read_poses, topic=topic),
        on_topic=_on_topic,
    )


FORMAT = _format(None)
