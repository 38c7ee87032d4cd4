"""Trajectories: timestamps that are ids, that are near those of nodes, or whose order counts."""

import numpy as np
import pytest
from strategies import pose_graph

from certpgo import io
from certpgo.errors import FormatError, InputNotice
from certpgo.graph import Instance

N = 5


@pytest.fixture
def instance():
    graph, _, _ = pose_graph(np.random.default_rng(0), N, 3)
    return Instance("walk", graph, np.array([2, 3, 5, 8, 9]))


def tum(times):
    """Pose k stands at x = k."""
    return "".join(f"{time} {k} 0 0 0 0 0 1\n" for k, time in enumerate(times))


def places(path, instance, **options):
    return io.read_estimate(path, instance, **options).translations[:, 0].tolist()


def test_timestamps_that_are_ids_in_any_order_and_rounded_by_text(file, instance):
    assert places(file(tum([9, 8, 5, 3, 2]), "a.tum"), instance) == [4, 3, 2, 1, 0]
    assert places(file(tum(["2.0000001", "3", 5, 8, 9]), "a.tum"), instance) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("times", [[10.25, 10.5, 11, 11.5, 12], [100, 101, 102, 103, 104]])
def test_other_timestamps_are_matched_in_order_and_this_is_said(file, instance, times):
    path = file(tum(times), "a.tum")
    with pytest.warns(InputNotice, match="ascending order"):
        assert places(path, instance) == [0, 1, 2, 3, 4]
    with pytest.raises(FormatError, match="not node ids, and 4 poses cannot"):
        io.read_estimate(file(tum(times[:4]), "a.tum"), instance)
    with pytest.raises(FormatError, match="not node ids"):
        io.read_estimate(file(tum(times[::-1]), "a.tum"), instance)


def test_ids_that_are_another_graphs_are_refused(file, instance):
    with pytest.raises(FormatError, match="node 4 is not in the graph"):
        io.read_estimate(file(tum([2, 3, 4, 8, 9]), "a.tum"), instance)


def test_the_nearest_pose_of_a_denser_trajectory(file, instance):
    stamps = file("1.0\n1.5\n2.0\n2.5\n3.0\n", "times.txt")
    path = file(tum(np.arange(1.0, 3.01, 0.1) + 0.004), "a.tum")
    with pytest.warns(InputNotice) as said:
        assert places(path, instance, timestamps=stamps) == [0, 5, 10, 15, 20]
    assert "off by at most 0.004 s" in str(said[0].message)
    assert "16 poses at times without a node ignored" in str(said[1].message)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([1, 1.5, 2, 2.52, 3], "node 8, at 2.5 s, has no pose"),
        ([1, 1.5, 2, 2.5], "node 9, at 3 s, has no pose"),
        ([1, 1, 2, 2.5, 3], "timestamp 1.0 appears twice"),
    ],
)
def test_a_node_without_a_pose_of_its_own(file, instance, times, expected):
    stamps = file("1.0\n1.5\n2.0\n2.5\n3.0\n", "times.txt")
    with pytest.raises(FormatError, match=expected):
        io.read_estimate(file(tum(times), "a.tum"), instance, timestamps=stamps)


def test_one_pose_cannot_serve_two_nodes(file, instance):
    stamps = file("1.0\n1.001\n2.0\n2.5\n3.0\n", "times.txt")
    with pytest.raises(FormatError, match=r"no pose of its own within 0\.01 s"):
        io.read_estimate(file(tum([1.0005, 1.4, 2, 2.5, 3]), "a.tum"), instance, timestamps=stamps)


def test_kitti_is_matched_in_order(file, instance):
    text = "".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(N))
    assert places(file(text, "a.kitti"), instance) == [0, 1, 2, 3, 4]
