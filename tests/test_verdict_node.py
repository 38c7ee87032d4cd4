"""The guide's node for ROS 2, with stand-ins of ROS's modules and messages."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import certpgo
from certpgo.io.datasets import synthetic
from certpgo.io.exact.quaternion import to_write

NODE = Path(__file__).parents[1] / "docs" / "how-to" / "verdict_node.py"


class Message(SimpleNamespace):
    """A message: its fields by name."""


class Status(Message):
    OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"


class Node:
    """What a node asks ROS for."""

    def __init__(self, name):
        self.name, self.parameters, self.published = name, {}, []

    def declare_parameter(self, name, value):
        self.parameters[name] = value

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def create_subscription(self, kind, topic, callback, depth):
        self.subscribed = topic, callback


@pytest.fixture
def node(monkeypatch):
    """The guide's module, as ROS would load it."""
    stand_ins = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "diagnostic_msgs": {},
        "diagnostic_msgs.msg": {
            "DiagnosticArray": Message,
            "DiagnosticStatus": Status,
            "KeyValue": Message,
        },
        "rtabmap_msgs": {},
        "rtabmap_msgs.msg": {"MapGraph": Message},
    }
    for name, contents in stand_ins.items():
        module = ModuleType(name)
        module.__dict__.update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("verdict_node", NODE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def vector(t):
    return Message(x=t[0], y=t[1], z=t[2])


def turn(R):
    x, y, z, w = to_write(R[None])[0].tolist()
    return Message(x=x, y=y, z=z, w=w)


def graph_message(graph, estimate, names, also=()):
    """A graph as rtabmap publishes it, with links of other kinds."""
    links = []
    for (i, j), R, t, kappa, tau in zip(
        graph.edges.tolist(),
        graph.rotations,
        graph.translations.tolist(),
        graph.kappa,
        graph.tau,
        strict=True,
    ):
        information = np.diag([2 * tau] * 3 + [4 * kappa] * 3).ravel()
        moved = Message(translation=vector(t), rotation=turn(R))
        links.append(
            Message(
                from_id=names[i], to_id=names[j], type=0, transform=moved, information=information
            )
        )
    links += [Message(**{**vars(links[0]), "type": kind}) for kind in also]
    poses = [
        Message(position=vector(t), orientation=turn(R))
        for R, t in zip(estimate.rotations, estimate.translations.tolist(), strict=True)
    ]
    return Message(header=Message(frame_id="map"), poses_id=names, poses=poses, links=links)


@pytest.fixture(scope="module")
def solved():
    made = synthetic.grid3d(3, np.random.default_rng(0))
    return made, certpgo.solve(made, cost="chordal")


def published(node, message):
    verdict = node.Verdict()
    topic, judge = verdict.subscribed
    assert topic == "mapGraph"
    judge(message)
    [(topic, array)] = verdict.published
    assert topic == "/diagnostics"
    assert array.header is message.header
    [status] = array.status
    return status


def test_the_optimum_is_certified_and_its_numbers_are_published(node, solved):
    made, answer = solved
    names = list(range(10, 10 + made.graph.num_nodes))
    # The optimum of this cost, which is close to F's: solved from the lines that the node writes.
    message = graph_message(made.graph, answer.estimate, names, also=(7, 8, 9))
    lines = list(node.lines_of(message))
    assert sum(line.startswith("EDGE") for line in lines) == made.graph.num_edges
    again = certpgo.solve(_written(lines))
    message = graph_message(made.graph, again.estimate, names)
    status = published(node, message)
    values = {pair.key: pair.value for pair in status.values}
    assert (status.level, values["verdict"]) == (Status.OK, "CERTIFIED")
    assert float(values["cost"]) == pytest.approx(again.cost, rel=1e-6)
    assert float(values["lower bound"]) <= float(values["cost"])
    assert status.message.startswith("CERTIFIED") or "optimum" in status.message


def test_other_verdicts_and_bad_graphs_are_warnings_and_errors(node, solved):
    made, answer = solved
    names = list(range(made.graph.num_nodes))
    status = published(node, graph_message(made.graph, made.truth, names))
    assert status.level == Status.WARN
    assert {pair.key: pair.value for pair in status.values}["verdict"] == "BOUNDED"
    message = graph_message(made.graph, answer.estimate, names)
    message.links[0].information = np.full(36, np.nan)
    status = published(node, message)
    assert status.level == Status.WARN
    assert status.message
    unposed = graph_message(made.graph, answer.estimate, names)
    unposed.poses, unposed.poses_id = unposed.poses[1:], unposed.poses_id[1:]
    assert published(node, unposed).level == Status.WARN


def _written(lines):
    from pathlib import Path
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        path = Path(folder) / "graph.g2o"
        path.write_text("\n".join(lines))
        return certpgo.read(path, rotation_information="tangent", quiet=True)
