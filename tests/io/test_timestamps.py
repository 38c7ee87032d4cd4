"""Trajectories: timestamps that are ids, that are near those of nodes, or whose order counts."""

import gzip
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strategies import pose_graph

import certpgo
from certpgo import io
from certpgo.errors import FormatError, GraphError, InputError, InputNotice
from certpgo.graph import Estimate, Instance
from certpgo.graph.components import restricted
from certpgo.graph.keys import Keys
from certpgo.io.datasets.synthetic import helix
from certpgo.io.timestamps import timed
from certpgo.solve.metrics import trajectory_errors

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


STAMPS = ["1403636580.838555574", "1403636580.888555574", "1403636580.938555574"]


def first_words(path):
    return [line.split()[0] for line in path.read_text().splitlines()]


@pytest.mark.parametrize("suffix", ["tum", "npz", "pyfg"])
def test_stamps_survive_to_the_last_digit(file, tmp_path, suffix):
    source, middle, back = (
        file(tum(STAMPS), "real.txt"),
        tmp_path / f"a.{suffix}",
        tmp_path / "b.tum",
    )
    certpgo.write(middle, certpgo.read_estimate(source))
    certpgo.write(back, certpgo.read_estimate(middle))
    assert first_words(back) == STAMPS
    assert places(back, None) == [0, 1, 2]


def test_the_order_of_a_file_without_ids_is_kept(file, tmp_path):
    certpgo.write(tmp_path / "b.tum", certpgo.read_estimate(file(tum(["5.5", "2.50"]), "a.tum")))
    assert first_words(tmp_path / "b.tum") == ["5.5", "2.5"]


def test_nanoseconds_are_recognised(file, tmp_path):
    whole = [stamp.replace(".", "") for stamp in STAMPS]
    found = certpgo.read_estimate(file(tum(whole), "ns.tum"))
    assert found.keys.times_ns.tolist() == [int(word) for word in whole]
    certpgo.write(tmp_path / "s.tum", found)
    assert first_words(tmp_path / "s.tum") == STAMPS
    evo = [f"{float(stamp):.18e}" for stamp in STAMPS]
    times = certpgo.read_estimate(file(tum(evo), "evo.tum")).keys.times_ns
    assert np.abs(times - found.keys.times_ns).max() < 240  # the spacing of doubles there
    with pytest.raises(FormatError, match="in seconds, or in whole nanoseconds, expected"):
        certpgo.read_estimate(file(tum([f"{word}.5" for word in whole]), "odd.tum"))
    with pytest.raises(FormatError, match=r"a.tum:2: timestamps in seconds expected"):
        certpgo.read_estimate(file(tum(["1", "1e300", "2"]), "a.tum"))


@pytest.mark.parametrize("suffix", ["g2o", "tum", "rots", "npz", "pyfg"])
def test_ids_with_gaps_survive(file, tmp_path, suffix):
    lines = "".join(f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1\n" for k in (10, 30, 20))
    path = tmp_path / f"a.{suffix}"
    estimate = certpgo.read_estimate(file(lines, "a.g2o"))
    if suffix == "rots":
        estimate = estimate.with_translations(None)
    certpgo.write(path, estimate)
    assert certpgo.read_estimate(path).keys.ids.tolist() == [10, 20, 30]
    moved = estimate.moved(np.eye(3)).anchored(0).subset(np.array([2, 0]))
    assert moved.keys.ids.tolist() == [30, 10]


@pytest.mark.parametrize(
    ("suffix", "said"),
    [
        ("g2o", ["g2o files hold no timestamps"]),
        ("kitti", ["kitti files hold no node ids", "kitti files hold no timestamps"]),
        ("json", ["open3d files hold no node ids", "open3d files hold no timestamps"]),
        ("tum", ["a tum file holds timestamps or node ids: the ids are not written"]),
        ("npz", []),
    ],
)
def test_labels_without_a_place_are_named(tmp_path, suffix, said):
    keys = Keys(ids=[4, 7], times_ns=[1_500_000_000, 2_000_000_000])
    estimate = Estimate(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), keys)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        certpgo.write(tmp_path / f"a.{suffix}", estimate)
    assert [str(one.message).split(": ", 1)[1].split(": they")[0] for one in caught] == said


def test_labels_are_checked():
    poses = np.tile(np.eye(3), (2, 1, 1))
    for keys, said in (
        ({"ids": [1, 1]}, "ids must be distinct"),
        ({"times_ns": [0.5, 1.0]}, "times_ns must be integers"),
        ({"names": ("a", "a")}, "names must be distinct"),
    ):
        with pytest.raises(GraphError, match=said):
            Keys(**keys)
    with pytest.raises(GraphError, match=r"ids must be \(2,\), not \(3,\)"):
        Estimate(poses, keys=Keys(ids=[1, 2, 3]))


def test_points_and_ids_survive_beside_each_other(file, tmp_path):
    source = file("VERTEX_SE2 3 1 0 0\nVERTEX_XY 8 5 6\nVERTEX_SE2 5 2 0 0\n", "a.g2o")
    path = tmp_path / "b.g2o"
    certpgo.write(path, certpgo.read_estimate(source))
    assert [line.split()[:2] for line in path.read_text().splitlines()] == [
        ["VERTEX_SE2", "3"],
        ["VERTEX_SE2", "5"],
        ["VERTEX_XY", "8"],
    ]


def test_an_estimate_finds_its_nodes_by_its_labels(instance):
    graph, n = instance.graph, np.arange(N)
    estimate = certpgo.solve(graph).estimate.keyed(Keys(ids=instance.ids))
    turned = estimate.subset(n[::-1])
    assert certpgo.certify(instance, turned).gap == certpgo.certify(instance, estimate).gap
    foreign = estimate.keyed(Keys(ids=instance.ids + 1))
    with pytest.raises(InputError, match="estimate of another graph: node 4 is not in the graph"):
        certpgo.certify(instance, foreign)


def truth_of(path, instance, **options):
    with pytest.warns(InputNotice) as said:
        nodes, poses = io.read_truth(path, instance, **options)
    return nodes.tolist(), poses.translations[:, 0].tolist(), str(said[0].message)


def test_a_truth_is_matched_by_time_where_both_have_times(file, instance):
    stamps = file("0.5\n2.5\n5.004\n7\n9.02\n", "times.txt")
    path = file(tum([f"{k}.000" for k in range(12)]), "truth.tum")
    nodes, at, said = truth_of(path, instance, timestamps=stamps)
    assert (nodes, at) == ([2, 3], [5, 7])
    assert "truth of 2 of 5 poses, matched by time, off by at most 0.004 s; 10 other poses" in said
    shifted = {"timestamps": stamps, "offset": 0.5, "max_difference": 0.001}
    assert truth_of(path, instance, **shifted)[:2] == ([0, 1], [0, 2])
    nodes, at, said = truth_of(path, instance)  # without the nodes' times they may be ids
    assert (nodes, at) == ([0, 1, 2, 3, 4], [2, 3, 5, 8, 9])
    assert "matched by timestamps taken for node ids; 7 other poses not used" in said
    in_ns = file(tum([f"{k}000000000000" for k in range(9, 12)]), "ns.tum")
    late = file("1.0\n9000\n9500\n10000\n10500\n", "late.txt")
    nodes, _, said = truth_of(in_ns, instance, timestamps=late)
    assert nodes == [1, 3]
    assert "read as nanoseconds" in said
    with pytest.raises(
        FormatError, match=r"within 0\.01 s of a node: .* 0\.5 to 9\.02 s, the poses'"
    ):
        io.read_truth(path, instance, timestamps=stamps, offset=100.0)


def test_times_of_nodes_go_with_parts_worlds_and_files(file, tmp_path):
    lines = "EDGE_SE2 {} {} 1 0 0 1 0 0 1 0 1\n"
    graph = lines.format(0, 1) + lines.format(4, 5) + "EDGE_PRIOR_SE2 0 5 6 0.5 25 0 0 25 0 16\n"
    whole = timed(io.read(file(graph), quiet=True), file("0.25\n0.5\n0.75\n1.25\n", "times.txt"))
    part = restricted(whole, np.array([0, 1, 4]), "part")
    answer = certpgo.solve(part)
    certpgo.write(tmp_path / "a.tum", answer)
    assert first_words(tmp_path / "a.tum") == ["0.25", "0.5"]
    certpgo.write(tmp_path / "a.npz", part)
    assert io.read(tmp_path / "a.npz", quiet=True).times_ns.tolist() == [250_000_000, 500_000_000]
    certpgo.write(tmp_path / "e.npz", answer)
    again = io.read_estimate(tmp_path / "e.npz", part)
    assert np.abs(again.translations - answer.estimate.anchored(2).translations).max() < 1e-12
    assert part.in_world(again).keys.times_ns.tolist() == [250_000_000, 500_000_000]


def test_compressed_trajectories_keep_their_stamps(tmp_path):
    path = tmp_path / "a.tum.gz"
    path.write_bytes(gzip.compress(tum(STAMPS).encode()))
    certpgo.write(tmp_path / "b.tum", certpgo.read_estimate(path))
    assert first_words(tmp_path / "b.tum") == STAMPS


def test_times_that_robots_share_tell_no_nodes_apart(file, tmp_path):
    vertex, edge = "VERTEX_SE2 {} {} {} 0 0\n", "EDGE_SE2 0 {} {} {} 0 0 1 0 0 1 0 1\n"
    names = ["A0", "A1", "B0", "B1"]
    text = "".join(vertex.format(k % 2 + 0.5, name, k) for k, name in enumerate(names))
    text += "".join(edge.format(names[k], names[k + 1], 1) for k in range(3))
    instance = io.read(file(text, "two.pyfg"), quiet=True)
    path = tmp_path / "out.tum"
    with pytest.warns(InputNotice) as said:
        certpgo.write(path, instance.initial, instance=instance)
    assert [str(one.message).split(": ", 1)[1] for one in said] == [
        "several poses have one timestamp: node ids are written instead",
        "tum files hold no such names as 'A0': they are not written",
    ]
    assert places(path, instance) == [0, 1, 2, 3]
    certpgo.write(tmp_path / "out.pyfg", instance.initial)
    assert "VERTEX_SE2 1.5 B1 3.0" in (tmp_path / "out.pyfg").read_text()


def test_repeated_stamps_are_ignored_of_the_truth_too(file):
    """Of evo's issue 331: all are the same. The truth is off by 0.1 m at its last pose."""
    edges = "".join(f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0 0 0 0 1\n" for k in range(3))
    graph = file(edges, "g.g2o")
    at = [(0, 0), (1, 0), (1, 1), (0, 1)]
    rows = ["16.5 {} {} 0 0 0 0 1\n".format(*place) for place in at]
    estimate = file("".join(rows), "est.txt")
    truth = file("".join([*rows[:3], "16.5 0 1.1 0 0 0 0 1\n"]), "gt.txt")
    instance = io.read(graph, quiet=True)
    for read in (io.read_estimate, io.read_truth):
        with pytest.raises(FormatError, match=r"16\.5 appears twice, as numbers 1 and 2 .* index"):
            read(truth, instance)
    with pytest.raises(FormatError, match=r"16\.5 appears twice, as numbers 1 and 2"):
        io.read_estimate(estimate)
    found = io.read_estimate(estimate, instance, timestamps="index")
    nodes, known = io.read_truth(truth, instance, timestamps="index")
    errors = trajectory_errors(found.subset(nodes), known)
    t = known.translations - known.translations.mean(axis=0)
    given = found.translations - found.translations.mean(axis=0)
    turn, _ = Rotation.align_vectors(t, given)
    rms = np.sqrt(((turn.apply(given) - t) ** 2).sum(axis=1).mean())
    assert errors.ate_m == pytest.approx(rms, rel=1e-9)


def test_truth_of_positions_alone(file):
    """With rotations, without, and without names: the same ATE in metres, and no degrees."""
    rng = np.random.default_rng(5)
    instance = helix(12, rng)
    t = instance.truth.translations
    near = Estimate(instance.truth.rotations, t + rng.normal(0.0, 0.1, t.shape))
    pad = "0 0 0 1"
    texts = {
        "a.tum": "".join(
            f"{k} {x!r} {y!r} {z!r} {pad}\n" for k, (x, y, z) in enumerate(t.tolist())
        ),
        "a.csv": "timestamp,x,y,z\n"
        + "".join(f"{k},{x!r},{y!r},{z!r}\n" for k, (x, y, z) in enumerate(t.tolist())),
        "a.txt": "".join(f"{k} {x!r} {y!r} {z!r}\n" for k, (x, y, z) in enumerate(t.tolist())),
        "b.txt": "".join(
            f"{k + 0.25} {x!r} {y!r} {z!r}\n" for k, (x, y, z) in enumerate(t.tolist())
        ),
    }
    found = {}
    for name, text in texts.items():
        with warnings.catch_warnings(action="ignore"):
            nodes, truth = io.read_truth(file(text, name), instance)
        found[name] = trajectory_errors(near.subset(nodes), truth)
    for name in ("a.csv", "a.txt", "b.txt"):
        assert found[name].ate_m == pytest.approx(found["a.tum"].ate_m, rel=1e-12)
        assert found[name].ate_deg is found[name].rpe_m is found[name].rpe_deg is None
        with pytest.raises(FormatError, match=r"positions alone|id x y yaw"):
            io.read_estimate(file(texts[name], name), instance)
    graph = file("", "g.g2o")
    certpgo.write(graph, replace(instance, truth=None))
    with pytest.raises(InputError, match="positions alone, without rotations"):
        io.read(graph, truth=file(texts["a.csv"], "a.csv"), quiet=True)
    rotations = Instance("turns", instance.graph.rotations_alone, instance.ids)
    with pytest.raises(FormatError, match="the graph measures rotations alone"):
        io.read_truth(file(texts["a.csv"], "a.csv"), rotations)


def test_planar_poses_with_times(file):
    text = "0.5 0 0 0\n1.5 1 0 1.5707963267948966\n"
    estimate = io.read_estimate(file(text, "poses.txt"))
    assert estimate.keys.times_ns.tolist() == [500_000_000, 1_500_000_000]
    np.testing.assert_allclose(estimate.rotations[1], [[0, -1], [1, 0]], atol=1e-15)
