"""Bags of ROS 1 and 2: trajectories with their times, rtabmap's graph, topics, broken bags."""

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from bags import Messages, trajectory

import certpgo
from certpgo.errors import FormatError, InputError, InputNotice, NoMeasurements
from certpgo.graph import Instance
from certpgo.io.datasets.synthetic import helix
from certpgo.io.format import format_of

#: A generation of ROS, the name of a bag, and how its messages are stored.
BAGS = {
    "bag": (1, "run.bag", "sqlite3"),
    "folder": (2, "run", "sqlite3"),
    "mcap": (2, "mcapped", "mcap"),
}


@pytest.fixture(params=BAGS.values(), ids=BAGS)
def kind(request, tmp_path):
    """Messages, and what writes topics of them and returns the bag's path."""
    generation, name, storage = request.param
    messages = Messages(generation)
    return messages, lambda topics: messages.write(tmp_path / name, topics, storage)


@pytest.fixture
def ros2(tmp_path):
    messages = Messages(2)
    return messages, lambda topics: messages.write(tmp_path / "run", topics)


def odometry(messages, walk, **more):
    return [
        (time, messages.odometry(time, R, t, **more))
        for time, R, t in zip(walk.times, walk.R, walk.t, strict=True)
    ]


def same(poses, walk):
    assert np.abs(poses.rotations - walk.R).max() < 1e-15
    assert (poses.translations == walk.t).all()
    assert poses.times_ns.tolist() == walk.times


def test_odometry_is_a_trajectory_with_the_times_of_its_headers(kind):
    messages, write = kind
    walk = trajectory(4)
    form = format_of(path := write({"/odom": odometry(messages, walk)}))
    assert form.name == "rosbag"
    same(form.read_poses(path), walk)
    with pytest.raises(NoMeasurements, match=r"no rtabmap_msgs/MapGraph .*/odom \(nav_msgs/msg/O"):
        certpgo.read(path)


def test_the_last_path_and_stamped_poses_are_trajectories(kind):
    messages, write = kind
    walk = trajectory(4)
    first = messages.path(walk.times[:2], walk.R[:2], walk.t[:2])
    whole = messages.path(walk.times, walk.R, walk.t)
    stamped = [
        (time, messages.stamped(time, R, t))
        for time, R, t in zip(walk.times, walk.R, walk.t, strict=True)
    ]
    path = write({"/path": [(5, first), (6, whole)], "/pose": stamped})
    for topic in ("/path", "/pose"):
        same(format_of(path, topic=topic).read_poses(path), walk)
    with pytest.raises(FormatError, match=r"poses on several topics: choose one \(--topic\) of "):
        certpgo.read_estimate(path)
    with pytest.raises(FormatError, match="no topic /pos; the bag has: /path, /pose"):
        certpgo.read_estimate(path, topic="/pos")
    assert certpgo.read_estimate(path, topic="/pose").num_nodes == 4


def test_a_single_file_of_a_folder_is_read_too(tmp_path):
    messages, walk = Messages(2), trajectory(3)
    for storage, suffix in (("sqlite3", "db3"), ("mcap", "mcap")):
        topics = {"/odom": odometry(messages, walk)}
        messages.write(tmp_path / storage, topics, storage)
        (file,) = (tmp_path / storage).glob(f"*.{suffix}")
        same(format_of(file).read_poses(file), walk)


def graph_message(messages, instance, omega, extra=()):
    graph, truth = instance.graph, instance.truth
    ids = instance.ids.tolist()
    poses = map(messages.pose, truth.rotations, truth.translations)
    links = [
        messages.link(ids[i], ids[j], R, t, omega)
        for (i, j), R, t in zip(
            graph.edges.tolist(), graph.rotations, graph.translations, strict=True
        )
    ]
    return messages.graph(ids, poses, [*links, *extra])


def numbered_from_one(n=3):
    made = helix(n, np.random.default_rng(0))
    return Instance("helix", made.graph, 1 + 2 * made.ids, truth=made.truth)


def test_the_graph_of_rtabmap_is_read_with_its_information(kind):
    messages, write = kind
    made = numbered_from_one()
    omega = np.diag([100.0, 100, 100, 800, 800, 800])
    omega[0, 5] = omega[5, 0] = 1.5
    path = write({"/rtabmap/mapGraph": [(1, graph_message(messages, made, omega))]})
    found = certpgo.read(path)
    assert found.ids.tolist() == made.ids.tolist()
    assert found.graph.edges.tolist() == made.graph.edges.tolist()
    assert np.abs(found.graph.rotations - made.graph.rotations).max() < 1e-14
    assert (found.graph.translations == made.graph.translations).all()
    assert set(found.graph.kappa) == {400.0}
    assert set(found.graph.tau) == {100.0}
    assert (found.graph.information_matrices == omega).all()
    assert np.abs(found.initial.translations - made.truth.translations).max() == 0.0
    estimate = certpgo.read_estimate(path, found)
    assert np.abs(estimate.rotations - made.truth.rotations).max() < 1e-14
    assert certpgo.solve(found).verdict == "CERTIFIED"


def test_what_is_no_link_between_poses_is_skipped_and_named(ros2):
    messages, write = ros2
    still = (np.eye(3), np.zeros(3), np.eye(6))
    extra = [
        messages.link(1, 1, *still, kind=7),
        messages.link(1, -5, *still, kind=8),
        messages.link(1, 1, *still, kind=9),
        messages.link(3, 3, *still, kind=9),
        messages.link(1, 3, *still, kind=99),
    ]
    made = numbered_from_one()
    path = write({"/graph": [(1, graph_message(messages, made, np.eye(6), extra))]})
    found = certpgo.read(path, quiet=True)
    assert found.graph.num_edges == made.graph.num_edges
    assert found.ids.tolist() == made.ids.tolist()
    assert found.notices == (
        "1 prior of poses skipped",
        "1 sighting of landmarks skipped",
        "2 measurements of gravity skipped",
        "1 link of unknown type skipped",
    )


def test_poses_in_two_frames_are_refused(ros2):
    messages, write = ros2
    walk = trajectory(4)
    first, second = odometry(messages, walk)[:2], odometry(messages, walk, frame="map")[2:]
    path = write({"/odom": [*first, *second]})
    with pytest.raises(FormatError, match="/odom: poses in one frame expected, not in 'map', 'odo"):
        certpgo.read_estimate(path)


def test_numbers_that_are_no_pose_are_refused(ros2):
    messages, write = ros2
    walk = trajectory(3)
    bad = odometry(messages, walk)
    bad[1][1].pose.pose.orientation = messages.make(
        "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0
    )
    with pytest.raises(FormatError, match="/odom: pose 1: finite numbers and a quaternion"):
        certpgo.read_estimate(write({"/odom": bad}))


@pytest.mark.parametrize(
    ("information", "end", "expected"),
    [
        (-np.eye(6), 3, "/graph: link 1 to 3: the rotation block of the information is not posit"),
        (np.triu(np.ones((6, 6))), 3, "/graph: link 1 to 3: a symmetric matrix expected"),
        (np.full((6, 6), np.nan), 3, "/graph: finite information expected"),
        (np.eye(6), 1, "/graph: node 1 is measured from itself"),
    ],
)
def test_a_link_that_measures_nothing_is_refused(ros2, information, end, expected):
    messages, write = ros2
    link = messages.link(1, end, np.eye(3), np.ones(3), information)
    with pytest.raises(FormatError, match=expected):
        certpgo.read(write({"/graph": [(1, messages.graph([], [], [link]))]}))


def test_broken_bags_are_refused_with_their_path(tmp_path, ros2):
    messages, write = ros2
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + b"\0" * 50)
    (tmp_path / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\0" * 50)
    (tmp_path / "broken.db3").write_bytes(b"SQLite format 3\0" + b"\0" * 50)
    folder = write({"/odom": odometry(messages, trajectory(2))})
    for file in folder.glob("*.db3"):
        file.unlink()
    for name in ("broken.bag", "broken.mcap", "broken.db3", "run"):
        with pytest.raises(FormatError, match=f"{name}: a complete bag of ROS expected: "):
            certpgo.read_estimate(tmp_path / name)


def test_a_topic_is_of_a_bag(file):
    path = file("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(FormatError, match="a g2o file has no topics"):
        certpgo.read(path, topic="/odom")


def test_a_trajectory_in_a_bag_is_certified_on_the_command_line(ros2, tmp_path, capsys):
    from certpgo.cli import main

    messages, write = ros2
    made = numbered_from_one()
    solved = certpgo.solve(made).estimate
    certpgo.write(graph := tmp_path / "graph.g2o", made)
    times = [k * 10**9 for k in made.ids.tolist()]
    good = messages.path(times, solved.rotations, solved.translations)
    other = messages.path(times, made.truth.rotations, made.truth.translations)
    path = write({"/solved": [(1, good)], "/other": [(1, other)]})
    assert main(["certify", str(graph), str(path), "--topic", "/solved", "--cost", "chordal"]) == 0
    assert "CERTIFIED" in capsys.readouterr().out
    assert main(["certify", str(graph), str(path)]) == 1
    assert "choose one (--topic) of /other" in capsys.readouterr().err
    tum = tmp_path / "solved.tum"
    assert main(["convert", str(path), str(tum), "--topic", "/solved", "--timestamps", "ids"]) == 0
    assert len(tum.read_text().splitlines()) == solved.num_nodes
    assert main(["info", str(graph), "--topic", "/solved"]) == 1
    assert "--topic is for ROS bags" in capsys.readouterr().err


def test_without_rosbags_the_extra_is_named(ros2, monkeypatch):
    import sys

    messages, write = ros2
    path = write({"/odom": odometry(messages, trajectory(2))})
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(certpgo.MissingDependency, match="pip install 'rosbags"):
        certpgo.read_estimate(path)


def test_notices_name_a_guess(ros2):
    messages, write = ros2
    made, walk = numbered_from_one(), trajectory(9)
    path = write({"/odom": odometry(messages, walk)})
    with pytest.warns(InputNotice, match="timestamps are not node ids"):
        assert certpgo.read_estimate(path, made).num_nodes == 9
    with pytest.raises(InputError, match="cannot be matched"):
        certpgo.read_estimate(path, numbered_from_one(4))
