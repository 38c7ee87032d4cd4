"""Bags of ROS, of both generations, opened with rosbags, which is imported when it is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError, InputError, MissingDependency
from certpgo.io.pipes import readable

#: rtabmap's messages as ROS 2 has them, for bags that hold no definitions.
_RTABMAP = {
    "rtabmap_msgs/msg/Link": (
        "int32 from_id\nint32 to_id\nint32 type\n"
        "geometry_msgs/Transform transform\nfloat64[36] information\n"
    ),
    "rtabmap_msgs/msg/MapGraph": (
        "std_msgs/Header header\ngeometry_msgs/Transform map_to_odom\n"
        "int32[] poses_id\ngeometry_msgs/Pose[] poses\nrtabmap_msgs/Link[] links\n"
    ),
}


@dataclass(frozen=True)
class Bag:
    """An open bag.

    Attributes
    ----------
    path : of its file or folder
    types : the type of each topic's messages, by topic
    reader : of rosbags
    """

    path: Path
    types: dict[str, str]
    reader: Any

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """The messages on a topic, with the times at which they were recorded, nanoseconds."""
        chosen = [one for one in self.reader.connections if one.topic == topic]
        for connection, time, data in self.reader.messages(connections=chosen):
            yield time, self.reader.deserialize(data, connection.msgtype)

    def only(self, topics: list[str], what: str) -> str:
        """The only one of some topics.

        Raises
        ------
        FormatError
            There are several; the message lists them.
        """
        if len(topics) > 1:
            listed = ", ".join(f"{name} ({self.types[name]})" for name in topics)
            said = f"{what} on several topics: choose one (--topic) of {listed}"
            raise FormatError(self.path, None, said)
        return topics[0]


@contextmanager
def opened_bag(path: Path, topic: str | None) -> Iterator[Bag]:
    """An open bag, of a single topic if one is chosen.

    Raises
    ------
    MissingDependency
        rosbags is not installed.
    FormatError
        The bag cannot be read, or has no such topic.
    """
    try:
        from rosbags.highlevel import AnyReader
    except ImportError:
        raise MissingDependency("rosbags, which reads bags of ROS,", "ros") from None
    try:
        with AnyReader([readable(path)], default_typestore=_types()) as reader:
            types = {one.topic: one.msgtype for one in reader.connections}
            if topic is not None:
                if topic not in types:
                    known = ", ".join(sorted(types)) or "none"
                    said = f"no topic {topic}; the bag has: {known}"
                    raise FormatError(path, None, said)
                types = {topic: types[topic]}
            yield Bag(path, dict(sorted(types.items())), reader)
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(path, None, str(error)) from None
    except Exception as error:  # of whatever reads what is inside: YAML, SQLite, MCAP, CDR
        said = f"a complete bag of ROS expected: {str(error) or type(error).__name__}"
        raise FormatError(path, None, " ".join(said.split())) from None


def _types() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.LATEST)
    for name, text in _RTABMAP.items():
        store.register(get_types_from_msg(text, name))
    return store
