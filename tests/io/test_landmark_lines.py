"""Points and sightings in files, read, written and matched with estimates."""

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, GraphError, InputError, InputNotice, io
from certpgo.graph.components import restricted
from certpgo.graph.labels import Landmark

PLANE = """\
VERTEX_SE2 3 0 0 0
VERTEX_SE2 5 1 0 1.5
VERTEX_XY 4 1 2
EDGE_SE2 3 5 1 0 1.5 100 0 0 100 0 400
EDGE_SE2_XY 3 4 1 2 25 0 25
EDGE_SE2_XY 5 4 2 0 9 1 16
"""
HALF = "0 0.70710678118654752 0 0 0.70710678118654752"
SPACE = f"""\
PARAMS_SE3OFFSET 7 1 2 3 {HALF[2:]} 0
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 2 0 0 2 0 2
EDGE_SE3_TRACKXYZ 0 9 7 1 0 0 4 0 0 9 0 16
EDGE_SE3_TRACKXYZ 1 9 0 5 5 5 9 0 0 9 0 9
""".replace(f"{HALF[2:]} 0", "0.70710678118654752 0 0 0.70710678118654752")


def test_in_the_plane(file):
    instance = io.read(file(PLANE), quiet=True)
    graph = instance.graph
    assert instance.ids.tolist() == [3, 4, 5]
    assert graph.is_point.tolist() == [False, True, False]
    assert graph.edges.tolist() == [[0, 2], [0, 1], [2, 1]]
    assert graph.kappa.tolist() == [400.0, 0.0, 0.0]
    expected = 2.0 / np.trace(np.linalg.inv([[9.0, 1.0], [1.0, 16.0]]))
    np.testing.assert_allclose(graph.tau, [100.0, 25.0, expected], rtol=1e-15)
    assert instance.initial.translations.tolist() == [[0, 0], [1, 2], [1, 0]]
    assert instance.graph.information_matrices[2].tolist() == [[9, 1, 0], [1, 16, 0], [0, 0, 0]]
    assert "1 point, 2 sightings" in instance.notices


def test_sightings_stay_in_the_order_of_the_file(file):
    """Of whatever tags: the checker counts lines."""
    lines = ("EDGE_SE2 0 1 1 0 0", "LANDMARK2 0 7 1 1", "EDGE_SE2_XY 1 8 2 2", "LANDMARK2 1 7 3 3")
    graph = io.read(file("\n".join(lines) + "\n"), quiet=True).graph
    assert graph.edges.tolist() == [[0, 1], [0, 2], [1, 3], [1, 2]]
    assert graph.translations[1:, 0].tolist() == [1.0, 2.0, 3.0]


def test_points_without_sightings_are_noted(file):
    """Where some points are seen, and where none is."""
    unseen = "VERTEX_XY 8 1 2\n"
    for text in (PLANE + unseen, "EDGE_SE2 0 1 1 0 0\n" + unseen):
        assert "1 point without a sighting skipped" in io.read(file(text), quiet=True).notices


@pytest.mark.parametrize("first", [True, False])
def test_points_of_the_plane_are_left_out_of_poses_in_space(file, first):
    stray, poses = "VERTEX_XY 8 1 2\n", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n"
    edge = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {'1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1'}\n"
    found = io.read(file(stray + poses + edge if first else poses + edge + stray), quiet=True)
    assert "1 VERTEX_XY in a file of 3D poses skipped" in found.notices
    assert found.graph.num_nodes == 2
    with pytest.raises(FormatError, match="EDGE_SE2_XY in a file of 3D poses"):
        io.read(file(poses + edge + stray + "EDGE_SE2_XY 0 8 1 1 1 0 1\n"), quiet=True)


def test_in_space_with_a_sensor_on_its_body(file):
    """The sensor is turned by a right angle about x, and 1, 2, 3 metres away."""
    graph = io.read(file(SPACE), quiet=True).graph
    np.testing.assert_allclose(graph.translations[1], [2.0, 2.0, 3.0], atol=1e-15)
    np.testing.assert_allclose(graph.translations[2], [5.0, 5.0, 5.0])
    matrices = io.read(file(SPACE), quiet=True).graph.information_matrices
    np.testing.assert_allclose(matrices[1][:3, :3], np.diag([4.0, 16.0, 9.0]), atol=1e-14)


def test_ids_of_their_own(file):
    text = "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4\nLANDMARK2 0 {} 1 0 4 0 4\nLANDMARK2 1 {} 1 0 4 0 4\n"
    instance = io.read(file(text.format(1, 1)), quiet=True)
    assert instance.ids.tolist() == [0, 1, 3]
    assert "1 point, 2 sightings; point k has the id k + 2" in instance.notices
    apart = io.read(file(text.format(8, 8)), quiet=True)
    assert apart.ids.tolist() == [0, 1, 8]
    isam = text.replace("EDGE_SE2", "ODOMETRY").replace("LANDMARK2", "LANDMARK").format(1, 1)
    again = io.read(file(isam, "graph.txt"), quiet=True)
    assert again.options["rotation_information"] == "rpy"
    np.testing.assert_array_equal(again.graph.tau, instance.graph.tau)
    assert again.ids.tolist() == instance.ids.tolist()


@pytest.mark.parametrize(
    ("stated", "numbers", "kappa", "tau"),
    [
        ("information", "4 0 0 4 0 16", 16.0, 4.0),
        ("covariance", "0.25 0 0 0.25 0 0.0625", 16.0, 4.0),
        ("sqrt-information", "2 0 0 2 0 4", 16.0, 4.0),
        ("sqrt-information", "2 1 0 2 0 4", 16.0, 2.0 / (21.0 / 80.0 + 0.25)),
    ],
)
def test_what_numbers_mean(file, stated, numbers, kappa, tau):
    position = " ".join(numbers.split()[k] for k in (0, 1, 3))
    text = f"ODOMETRY 0 1 1 0 0 {numbers}\nLANDMARK 0 5 1 0 {position}\nLANDMARK 1 5 1 0 1 0 1\n"
    instance = io.read(file(text, "graph.txt"), weights_are=stated, quiet=True)
    root = np.array([[2.0, 1.0], [0.0, 2.0]])
    if numbers == "2 1 0 2 0 4":
        tau = 2.0 / np.trace(np.linalg.inv(root.T @ root))
    assert instance.graph.kappa[0] == pytest.approx(kappa)
    np.testing.assert_allclose(instance.graph.tau[:2], tau, rtol=1e-14)
    said = any(f"are read as its {stated}" in notice for notice in instance.notices)
    assert said == (stated != "information")


def test_datasets_know_what_their_numbers_are(dataset):
    instance = dataset("victoria_park")
    assert instance.options["weights_are"] == "covariance"
    assert instance.graph.tau[0] == pytest.approx(2.0 / (1e-4 + 4e-6))
    roots = dataset("victoriaPark")
    np.testing.assert_allclose(roots.graph.tau, instance.graph.tau, rtol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PLANE + "EDGE_SE2_XY 3 5 1 2 25 0 25\n", "node 5 is a pose and a point"),
        (PLANE + "EDGE_SE2_XY 3 4 1 2 25 0\n", "takes 2 ids and 2 numbers, then 3"),
        (PLANE + "EDGE_SE2_XY 3 4 1 2 25 99 25\n", "information of a position is not positive"),
        (PLANE + "VERTEX_XY 4 1 2\n", "node 4 appears twice"),
        ("VERTEX_SE2 3 0 0 0\n", "no edges: this is an estimate"),
        (
            "VERTEX_SE2 3 0 0 0\nEDGE_PRIOR_SE2 3 0 0 0 9 0 0 9 0 9\n",
            "no edges: measurements between poses, or of points, expected with priors",
        ),
        (SPACE + "EDGE_SE3_TRACKXYZ 1 9 3 5 5 5 9 0 0 9 0 9\n", "sensor 3, which is unknown"),
        (
            PLANE + "LANDMARK2 3 -1 1 2 25 0 25\nLANDMARK2 3 4 1 2 1 0 1\n",
            "numbers of points from 0",
        ),
    ],
)
def test_wrong_lines(file, text, message):
    with pytest.raises((FormatError, InputError), match=message):
        io.read(file(text), quiet=True)


def test_wrong_statements(file):
    text = "ODOMETRY 0 1 1 0 0 1 5 0 1 0 1\n"
    with pytest.raises(FormatError, match="a covariance is not positive definite"):
        io.read(file(text, "graph.txt"), weights_are="covariance")
    with pytest.raises(InputError, match="weights_are must be one of information, sqrt"):
        io.read(file(text, "graph.txt"), weights_are="variance")


@pytest.mark.parametrize("text", [PLANE, SPACE])
@pytest.mark.parametrize("suffix", ["g2o", "npz"])
def test_written_and_read_again(file, tmp_path, text, suffix):
    instance = io.read(file(text), quiet=True)
    io.write(tmp_path / f"again.{suffix}", instance)
    again = io.read(tmp_path / f"again.{suffix}", quiet=True)
    for name in ("edges", "nodes", "translations"):
        np.testing.assert_array_equal(getattr(again.graph, name), getattr(instance.graph, name))
    np.testing.assert_allclose(again.graph.tau, instance.graph.tau, rtol=1e-12)
    if instance.initial is not None:
        np.testing.assert_array_equal(again.initial.translations, instance.initial.translations)


def test_estimates(file, tmp_path):
    instance = io.read(file(PLANE), quiet=True)
    answer = certpgo.solve(instance)
    best = answer.estimate
    for suffix in ("g2o", "npz"):
        path = tmp_path / f"out.{suffix}"
        io.write(path, best, instance=instance, anchor="none")
        again = io.read_estimate(path, instance)
        np.testing.assert_allclose(again.translations, best.translations, atol=1e-15)
        # A graph without points takes the poses.
        bare = io.read(file(PLANE), quiet=True, landmarks=False)
        assert io.read_estimate(path, bare).num_nodes == 2
    with pytest.warns(InputNotice, match="points are not written"):
        io.write(tmp_path / "out.tum", best, instance=instance, anchor="none")
    assert len((tmp_path / "out.tum").read_text().splitlines()) == 2
    # Of poses alone, points are where they are seen.
    poses = io.read_estimate(tmp_path / "out.tum", instance)
    expected = np.zeros(2)
    for k, pose in ((1, 0), (2, 2)):
        seen = best.translations[pose] + best.rotations[pose] @ instance.graph.translations[k]
        expected += instance.graph.tau[k] * seen
    expected /= instance.graph.tau[1:].sum()
    np.testing.assert_allclose(poses.translations[1], expected, atol=1e-12)


def test_the_first_pose_holds_the_frame_not_a_point_before_it(file, tmp_path):
    """A point has no rotation, so an estimate is not anchored at one, whatever its id."""
    text = PLANE.replace(" 4 ", " 1 ").replace("VERTEX_SE2 3 0 0 0", "VERTEX_SE2 3 2 3 0.5")
    instance = io.read(file(text), quiet=True)
    assert instance.ids.tolist() == [1, 3, 5]
    best = certpgo.solve(instance).estimate
    turned = best.rotations.copy()
    turned[0] = [[0.0, -1.0], [1.0, 0.0]]
    spun = certpgo.Estimate(turned, best.translations)
    for name, estimate in (("best", best), ("spun", spun)):
        for anchor, pose in (("file", [2.0, 3.0]), ("identity", [0.0, 0.0])):
            path = tmp_path / f"{name}_{anchor}.g2o"
            io.write(path, estimate, instance=instance, anchor=anchor)
            again = io.read_estimate(path, instance)
            np.testing.assert_allclose(again.translations[1], pose, atol=1e-12)
    for anchor in ("file", "identity"):
        found = [
            io.read_estimate(tmp_path / f"{n}_{anchor}.g2o", instance) for n in ("best", "spun")
        ]
        np.testing.assert_allclose(found[0].translations, found[1].translations, atol=1e-12)


def test_points_and_the_world(file):
    text = PLANE + "EDGE_PRIOR_SE2 3 0.1 0 0 25 0 0 25 0 16\nEDGE_PRIOR_SE2_XY 4 1.2 2 25 0 25\n"
    instance = io.read(file(text), quiet=True)
    assert instance.world == 3
    assert instance.graph.is_point.tolist() == [False, True, False, False]
    assert instance.graph.edges[-1].tolist() == [3, 1]
    answer = certpgo.solve(instance)
    assert answer.verdict.value == "CERTIFIED"
    assert "of positions" in answer.certificate.objective


def test_stereo(file, tmp_path):
    rows = (
        "0 5 120 100 60 9 9 9\n1 5 110 90 60 9 9 9\n0 6 100.5 100 60 9 9 9\n1 7 120 100 60 9 9 9\n"
    )
    file("100 100 0 50 40 0.5\n", "calibration.txt")
    instance = io.read(file(rows, "stereo_factors.txt"), quiet=True)
    assert instance.ids.tolist() == [0, 1, 7]
    np.testing.assert_allclose(instance.graph.translations[0], [1.75, 0.5, 2.5])
    np.testing.assert_allclose(instance.graph.tau, (0.02 + 0.5 * 2.5**2 / 50.0) ** -2)
    assert any("2 sightings left out" in notice for notice in instance.notices)
    assert "weights from the file's disparities and calibration" in str(instance)
    (tmp_path / "calibration.txt").unlink()
    with pytest.raises(FormatError, match=r"calibration\.txt: no such file"):
        io.read(tmp_path / "stereo_factors.txt")
    with pytest.raises(FormatError, match="'stereo_factors' expected in the file's name"):
        io.read(file(rows, "seen.txt"))
    file("100 100\n", "calibration.txt")
    with pytest.raises(FormatError, match="a calibration, fx fy skew u0 v0 baseline, expected"):
        io.read(tmp_path / "stereo_factors.txt")
    file("100 100 0 50 40 0.5\n", "calibration.txt")
    with pytest.raises(FormatError, match="ids must be integers"):
        io.read(file(rows + "0.5 7 120 100 60 9 9 9\n", "stereo_factors.txt"))


def test_poses_as_numbered_matrices(file):
    line = "{} 0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1\n"
    estimate = io.read_estimate(file(line.format(4) + line.format(2), "poses.txt"))
    np.testing.assert_array_equal(estimate.translations, [[1, 2, 3], [1, 2, 3]])
    np.testing.assert_allclose(estimate.rotations[0][0], [0.0, -1.0, 0.0], atol=1e-15)
    with pytest.raises(FormatError, match="must be 0 0 0 1"):
        io.read_estimate(file(line.format(4).replace("0 0 0 1\n", "0 0 0 2\n"), "poses.txt"))


def test_points_that_no_pose_sees_are_at_the_origin(dataset, tmp_path):
    """Of a graph with ranges, where poses alone say nothing about beacons."""
    instance = dataset("factor_graph_small")
    io.write(tmp_path / "poses.tum", instance.initial.subset(np.arange(6)))
    estimate = io.read_estimate(tmp_path / "poses.tum", instance)
    np.testing.assert_array_equal(estimate.translations[6], 0.0)


def test_labels_tell_landmarks_and_the_world_from_poses(file, tmp_path):
    step, seen = "EDGE_SE2 0 1 1 0 0 4 0 0 4 0 4\n", "LANDMARK2 0 {} 1 0 4 0 4\n"
    prior = "EDGE_PRIOR_SE2 0 0 0 0 4 0 0 4 0 4\n"
    labels = {0: (0, 1, Landmark(0), certpgo.WORLD), 7: (0, 1, Landmark(7), certpgo.WORLD)}
    for number, expected in labels.items():
        instance = io.read(file(step + seen.format(number) + prior), quiet=True)
        assert instance.labels == expected
        io.write(tmp_path / "graph.npz", instance)
        assert io.read(tmp_path / "graph.npz", quiet=True).labels == expected
        part = restricted(instance, np.array([0, 2, 3]), "part")
        assert part.labels == (0, *expected[2:])
        again = certpgo.Instance.labelled("again", instance.graph, expected)
        assert (again.ids.tolist(), again.labels) == (instance.ids.tolist(), expected)
    named = certpgo.Instance.labelled("named", instance.graph, ["a", "b", "c", certpgo.WORLD])
    assert named.names == ("a", "b", "c", "the world")
    assert named.labels == ("a", "b", "c", certpgo.WORLD)
    with pytest.raises(GraphError, match="the ids leave none for landmarks or the world"):
        certpgo.Instance.labelled("full", instance.graph, [0, 1, 2**63 - 1, certpgo.WORLD])


def test_npz_keeps_where_a_world_is_assumed_to_be(tmp_path):
    rotation = certpgo.RotationGraph(2, [[0, 1]], np.eye(2)[None], [1.0])
    graph = certpgo.PoseGraph(rotation, [[1.0, 0.0]], [1.0])
    turned = certpgo.with_priors(graph, [0, 1], np.tile(np.eye(2), (2, 1, 1)), kappa=1.0)
    io.write(tmp_path / "graph.npz", turned)
    assert io.read(tmp_path / "graph.npz", quiet=True).graph.assumed.tolist() == [
        False,
        False,
        False,
        True,
    ]
    with pytest.raises(GraphError, match="assumed must be 4 flags"):
        certpgo.PoseGraph(turned.rotations_alone, turned.translations, turned.tau, assumed=[True])


def test_a_sensor_with_two_poses_is_refused_at_its_line(monkeypatch, file):
    other = "PARAMS_SE3OFFSET 7 0 0 0 0 0 0 1\n"
    for size in (1 << 20, 50):
        monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", size)
        with pytest.raises(FormatError, match=r":3: sensor 7 has two different poses"):
            io.read(file(SPACE.replace("EDGE_SE3_T", other + "EDGE_SE3_T", 1)), quiet=True)
