"""Point clouds for viewers."""

import numpy as np
import pytest
from strategies import point_graph, rng_of

import certpgo
from certpgo import Estimate, FormatError, InputError, Instance, io

BLUE, ORANGE = [0, 114, 178], [213, 94, 0]


def cloud(path):
    """Header and numbers of a file."""
    header, body = path.read_text().split("end_header\n")
    return header.splitlines(), np.array([line.split() for line in body.splitlines()], dtype=float)


@pytest.mark.parametrize("d", [2, 3])
def test_poses_and_points_in_their_colours(tmp_path, d):
    graph, truth = point_graph(rng_of(d), 3, 2, d)
    path = tmp_path / "map.ply"
    instance = Instance("map", graph, np.arange(5))
    io.write(path, truth, instance=instance, anchor="none")
    header, rows = cloud(path)
    assert header[:2] == ["ply", "format ascii 1.0"]
    assert "comment certpgo: 3 poses in blue, 2 points in orange, metres" in header
    assert "element vertex 5" in header
    assert [line.split()[1:] for line in header if line.startswith("property")] == [
        *(["double", axis] for axis in "xyz"),
        *(["uchar", colour] for colour in ("red", "green", "blue")),
    ]
    np.testing.assert_array_equal(rows[:, :d], truth.translations)
    np.testing.assert_array_equal(rows[:, d:3], 0.0)
    for row, is_point in zip(rows, graph.is_point, strict=True):
        assert row[3:].tolist() == (ORANGE if is_point else BLUE)


def test_without_a_graph_all_are_poses(tmp_path):
    io.write(tmp_path / "map.ply", Estimate(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))))
    _, rows = cloud(tmp_path / "map.ply")
    assert rows[:, 3:].tolist() == [BLUE, BLUE]


def test_the_world_is_no_part_of_the_map(tmp_path):
    graph, truth = point_graph(rng_of(1), 4, 3, 3)
    joined = certpgo.with_priors(graph, [int(graph.pose_nodes[0])], np.eye(3)[None], kappa=4.0)
    instance = Instance("map", joined, np.arange(8), world=7)
    whole = instance.with_world(truth)
    io.write(tmp_path / "map.ply", whole, instance=instance)
    _, rows = cloud(tmp_path / "map.ply")
    np.testing.assert_allclose(rows[:, :3], truth.translations, atol=1e-14)


def test_what_is_refused(tmp_path):
    path = tmp_path / "map.ply"
    with pytest.raises(InputError, match="PLY needs translations"):
        io.write(path, Estimate(np.tile(np.eye(3), (2, 1, 1))))
    graph, truth = point_graph(rng_of(1), 4, 3, 3)
    with pytest.raises(InputError, match="ply cannot be written for a graph"):
        io.write(path, graph)
    assert not path.exists()
    io.write(path, truth)
    for read in (io.read, io.read_estimate):
        with pytest.raises((InputError, FormatError), match="a point cloud"):
            read(path)
