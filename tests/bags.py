"""Small bags of ROS, written with rosbags."""

from types import SimpleNamespace

import numpy as np

from certpgo.io.exact.quaternion import to_write

ODOMETRY, PATH = "nav_msgs/msg/Odometry", "nav_msgs/msg/Path"
STAMPED, GRAPH = "geometry_msgs/msg/PoseStamped", "rtabmap_msgs/msg/MapGraph"
#: rtabmap's messages of ROS 1; those of ROS 2 are the package's own.
LINK1 = "int32 fromId\nint32 toId\nint32 type\ngeometry_msgs/Transform transform\n"
GRAPH1 = (
    "Header header\ngeometry_msgs/Transform mapToOdom\nint32[] posesId\n"
    "geometry_msgs/Pose[] poses\nLink[] links\n"
)


class Messages:
    """Messages of one generation of ROS."""

    def __init__(self, generation):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        from certpgo.io import bags

        self.ros1 = generation == 1
        if self.ros1:
            self.store = get_typestore(Stores.ROS1_NOETIC)
            link = LINK1 + "float64[36] information\n"
            self.store.register(get_types_from_msg(link, "rtabmap_msgs/msg/Link"))
            self.store.register(get_types_from_msg(GRAPH1, GRAPH))
        else:
            self.store = bags._types()

    def make(self, kind, **fields):
        if self.ros1 and kind == "std_msgs/msg/Header":
            fields = {"seq": 0, **fields}
        return self.store.types[kind](**fields)

    def header(self, time, frame):
        seconds, part = divmod(time, 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=part)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def turn(self, R):
        x, y, z, w = to_write(R[None])[0].tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, R, t):
        x, y, z = t.tolist()
        at = self.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
        return self.make("geometry_msgs/msg/Pose", position=at, orientation=self.turn(R))

    def vector(self, t):
        x, y, z = t.tolist()
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def transform(self, R, t):
        return self.make(
            "geometry_msgs/msg/Transform", translation=self.vector(t), rotation=self.turn(R)
        )

    def stamped(self, time, R, t, frame="map"):
        return self.make(STAMPED, header=self.header(time, frame), pose=self.pose(R, t))

    def odometry(self, time, R, t, frame="odom"):
        of_pose = self.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(R, t), covariance=np.zeros(36)
        )
        still = self.vector(np.zeros(3))
        twist = self.make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=self.make("geometry_msgs/msg/Twist", linear=still, angular=still),
            covariance=np.zeros(36),
        )
        return self.make(
            ODOMETRY,
            header=self.header(time, frame),
            child_frame_id="base",
            pose=of_pose,
            twist=twist,
        )

    def path(self, times, R, t, frame="map"):
        poses = [self.stamped(*one) for one in zip(times, R, t, strict=True)]
        return self.make(PATH, header=self.header(0, frame), poses=poses)

    def link(self, i, j, R, t, information, kind=0):
        ends = {"fromId": i, "toId": j} if self.ros1 else {"from_id": i, "to_id": j}
        return self.make(
            "rtabmap_msgs/msg/Link",
            **ends,
            type=kind,
            transform=self.transform(R, t),
            information=np.asarray(information, dtype=np.float64).ravel(),
        )

    def graph(self, ids, poses, links):
        ids = np.array(ids, dtype=np.int32)
        still = self.transform(np.eye(3), np.zeros(3))
        fields = (
            {"mapToOdom": still, "posesId": ids}
            if self.ros1
            else {"map_to_odom": still, "poses_id": ids}
        )
        return self.make(
            GRAPH, header=self.header(0, "map"), poses=list(poses), links=list(links), **fields
        )

    def write(self, path, topics, storage="sqlite3"):
        """Write a bag; ``topics`` are lists of pairs of a time and a message, by topic."""
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
        writer = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        with writer:
            for topic, messages in topics.items():
                kind = messages[0][1].__msgtype__
                connection = writer.add_connection(topic, kind, typestore=self.store)
                for time, message in messages:
                    writer.write(connection, time, encode(message, kind))
        return path


def trajectory(n, seed=0):
    """Times (nanoseconds) and poses along a walk."""
    from certpgo.linalg import rotations as so

    rng = np.random.default_rng(seed)
    times = [1_700_000_000_000_000_000 + 100_000_000 * k for k in range(n)]
    return SimpleNamespace(times=times, R=so.random(rng, n, 3), t=rng.standard_normal((n, 3)))
