"""A node of ROS 2 that publishes the verdict on rtabmap's graph as a diagnostic message."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rtabmap_msgs.msg import MapGraph

import certpgo

LEVELS = {"CERTIFIED": DiagnosticStatus.OK, "REFUTED": DiagnosticStatus.ERROR}
#: Types of rtabmap's links that join two poses.
BETWEEN = range(7)


def lines_of(message: MapGraph) -> Iterator[str]:
    """The graph as lines of g2o; information is about the tangent space, translation first."""
    for node, pose in zip(message.poses_id, message.poses, strict=True):
        if node >= 0:  # others are landmarks
            yield f"VERTEX_SE3:QUAT {node} {_numbers(pose.position, pose.orientation)}"
    for link in message.links:
        if link.type in BETWEEN:
            moved = _numbers(link.transform.translation, link.transform.rotation)
            upper = np.reshape(link.information, (6, 6))[np.triu_indices(6)]
            weights = " ".join(map(repr, upper.tolist()))
            yield f"EDGE_SE3:QUAT {link.from_id} {link.to_id} {moved} {weights}"


def _numbers(t: object, q: object) -> str:
    return f"{t.x!r} {t.y!r} {t.z!r} {q.x!r} {q.y!r} {q.z!r} {q.w!r}"


def status_of(message: MapGraph, seconds: float) -> DiagnosticStatus:
    """The verdict on the poses that rtabmap published, within this many seconds."""
    status = DiagnosticStatus(name="certpgo: rtabmap's graph", level=DiagnosticStatus.WARN)
    try:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "graph.g2o"
            path.write_text("\n".join(lines_of(message)))
            instance = certpgo.read(path, rotation_information="tangent", quiet=True)
        if instance.initial is None:
            raise certpgo.InputError("some nodes of the links have no pose")
        found = certpgo.certify(instance, instance.initial, time_limit=seconds)
    except certpgo.CertPGOError as error:
        status.message = str(error)
        return status
    status.level = LEVELS.get(found.verdict.value, DiagnosticStatus.WARN)
    status.message = found.reason
    numbers = {"cost": found.cost_upper, "lower bound": found.lower_bound, "gap": found.gap}
    values = {"verdict": found.verdict.value, "of": found.objective, **numbers}
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return status


class Verdict(Node):
    """Certifies the last graph; while it works, older ones are dropped."""

    def __init__(self) -> None:
        super().__init__("certpgo_verdict")
        self.declare_parameter("time_limit", 5.0)
        self.publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self.create_subscription(MapGraph, "mapGraph", self.judge, 1)

    def judge(self, message: MapGraph) -> None:
        """Publish the verdict on a graph."""
        status = status_of(message, self.get_parameter("time_limit").value)
        self.publisher.publish(DiagnosticArray(header=message.header, status=[status]))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Verdict())
