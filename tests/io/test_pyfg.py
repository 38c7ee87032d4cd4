"""CORA's factor graphs: nodes with names, covariances, ranges and priors of points."""

import re
from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, InputError, InputNotice, io
from certpgo.cli import main
from certpgo.errors import NoMeasurements
from certpgo.io.datasets.synthetic import helix
from certpgo.io.format import format_of

#: Nodes, edges of the graph (priors too), points, sightings, priors, ranges.
SAMPLES = {
    "factor_graph_small": (7, 5, 1, 0, 0, 5),
    "goats_15": (476, 472, 3, 0, 0, 786),
    "goats_16": (205, 200, 4, 0, 0, 572),
    "marine": (1057, 1056, 56, 0, 57, 56),
    "mrclam5a": (1095, 2202, 15, 1127, 0, 316),
    "plaza2": (4095, 4090, 4, 0, 0, 1807),
    "single_drone": (1755, 1753, 1, 0, 0, 1754),
}
PLANE = """\
VERTEX_XY L0 1 2  # a point before the poses
VERTEX_SE2 10.5 A0 0 0 0
VERTEX_SE2 11.5 B7 1 0 1.5
VERTEX_SE2:PRIOR 0 A0 100 200 0.5 0.25 0 0 0.25 0 0.125
VERTEX_XY:PRIOR 0 L0 101 202 0.04 0.01 0.0625
EDGE_SE2 10.5 A0 B7 1 0 1.5 0.01 0 0 0.01 0 0.0025
EDGE_SE2_XY 10.5 B7 L0 1 2 0.04 0.01 0.0625
EDGE_RANGE 10.5 L0 A0 2.25 0.0625
EDGE_RANGE 10.5 A0 B7 1 0.25
"""
SPACE = """\
VERTEX_SE3:QUAT 0 A0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 0 A1 1 0 0 0 0 0 1
VERTEX_XYZ L0 1 2 3
EDGE_SE3:QUAT 0 A0 A1 1 0 0 0 0 0 1 .1 .02 0 0 0 .01 .2 0 0 0 0 .3 0 0 0 .04 .01 0 .05 0 .06
EDGE_SE3_XYZ 0 A1 L0 1 2 3 0.25 0 0 0.25 0 0.5
VERTEX_SE3:QUAT:PRIOR 0 A0 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 2 0 0 2 0 2
VERTEX_XYZ:PRIOR 0 A1 1 0 0 0.5 0 0 0.5 0 0.5
EDGE_RANGE 0 A0 L0 3.5 0.5
"""
UPPER = np.triu_indices(6)


@pytest.fixture
def pyfg(file):
    def write(text, name="graph.pyfg"):
        return file(text, name)

    return write


def read(path, **options):
    return io.read(path, quiet=True, **options)


@pytest.mark.parametrize("name", SAMPLES)
def test_counts(dataset, name):
    instance = dataset(name)
    graph, ranges = instance.graph, instance.graph.ranges
    sightings = int(graph.is_point[graph.edges[:, 1]].sum())
    priors = 0 if instance.world is None else int((graph.edges[:, 0] == instance.world).sum())
    if name == "marine":
        sightings = 0  # positions of points are priors
    found = (graph.num_nodes, graph.num_edges, int(graph.is_point.sum()), sightings, priors)
    assert (*found, ranges.num_edges) == SAMPLES[name]
    entry = certpgo.io.datasets.entry(name)
    assert (entry.nodes, entry.edges) == found[:2]
    assert instance.initial.num_nodes == len(instance.names) == graph.num_nodes
    assert instance.options["weights_are"] == "covariance"
    is_pose = [not name.startswith("L") for name in instance.names]
    assert is_pose == (~graph.is_point).tolist()
    flags = graph.is_point[: instance.world].tolist()
    assert flags == sorted(flags)


def test_positions_of_points(dataset):
    """The ranges of marine are to points whose positions were measured."""
    instance = dataset("marine")
    graph = instance.graph
    of_world = graph.edges[:, 0] == instance.world
    assert graph.is_point[graph.edges[of_world, 1]].sum() == 56
    variances = np.unique(np.round(1.0 / graph.tau[of_world][1:], 6))
    np.testing.assert_allclose(variances, [0.1, 0.2, 0.3, 0.4, 0.7])
    assert (graph.kappa[of_world] > 0.0).tolist() == [True] + [False] * 56
    assert instance.names[-1] == "world"
    np.testing.assert_allclose(instance.graph.ranges.weights, 100.0, rtol=1e-15)
    assert any("57 priors" in n and "56 of them positions alone" in n for n in instance.notices)


def test_in_the_plane(pyfg):
    instance = read(pyfg(PLANE))
    graph = instance.graph
    assert instance.names == ("A0", "B7", "L0", "world")
    assert instance.ids.tolist() == [0, 1, 2, 3]
    assert graph.is_point.tolist() == [False, False, True, False]
    assert graph.edges.tolist() == [[0, 1], [1, 2], [3, 0], [3, 2]]
    assert graph.kappa.tolist() == [400.0, 0.0, 8.0, 0.0]
    skew = 2.0 / (0.04 + 0.0625)
    np.testing.assert_allclose(graph.tau, [100.0, skew, 4.0, skew], rtol=1e-15)
    matrix = np.linalg.inv([[0.04, 0.01], [0.01, 0.0625]])
    np.testing.assert_allclose(instance.graph.information_matrices[1][:2, :2], matrix, rtol=1e-14)
    assert not instance.graph.information_matrices[1][2].any()
    assert (instance.world, instance.graph.information.residual) == (3, None)
    there = instance.in_world(instance.initial)
    np.testing.assert_allclose(there.translations, [[0, 0], [1, 0], [1, 2]], atol=1e-13)
    ranges = instance.graph.ranges
    assert ranges.edges.tolist() == [[2, 0], [0, 1]]
    assert (ranges.distances.tolist(), ranges.weights.tolist()) == ([2.25, 1.0], [16.0, 4.0])
    assert {"1 point, 1 sighting", "2 ranges"} <= set(instance.notices)


def test_in_space(pyfg):
    """Weights are those of the inverse of the whole covariance."""
    instance = read(pyfg(SPACE))
    graph = instance.graph
    numbers = SPACE.splitlines()[3].split()[11:]
    covariance = np.zeros((6, 6))
    covariance[UPPER] = [float(number) for number in numbers]
    whole = np.linalg.inv(np.triu(covariance) + np.triu(covariance, 1).T)
    assert graph.edges.tolist() == [[0, 1], [1, 2], [3, 0], [3, 1]]
    assert graph.tau[0] == pytest.approx(3.0 / np.trace(np.linalg.inv(whole[:3, :3])))
    assert graph.kappa[0] == pytest.approx(1.5 / np.trace(np.linalg.inv(whole[3:, 3:])))
    assert graph.kappa[1:].tolist() == [0.0, 0.25, 0.0]
    assert graph.tau[1:].tolist() == pytest.approx([3.0, 1.0, 2.0])
    np.testing.assert_allclose(instance.graph.information_matrices[0], whole, rtol=1e-13)


def test_choices(pyfg):
    path = pyfg(PLANE)
    unit = read(path, unit_weights=True)
    assert set(unit.graph.kappa.tolist()) == {0.0, 1.0}
    assert set(unit.graph.tau.tolist()) == set(unit.graph.ranges.weights.tolist()) == {1.0}
    assert unit.graph.information is None
    alone = read(path, priors=False)
    assert (alone.world, alone.names) == (None, ("A0", "B7", "L0"))
    assert "1 VERTEX_XY:PRIOR line skipped: priors" in alone.notices
    poses = read(path, landmarks=False)
    assert poses.names == ("A0", "B7", "world")
    assert not poses.graph.is_point.any()
    assert poses.graph.edges.tolist() == [[0, 1], [2, 0]]
    assert poses.graph.ranges.edges.tolist() == [[0, 1]]
    assert "1 range to points skipped" in poses.notices
    assert "1 prior of points skipped" in poses.notices
    assert read(path, weights_are="covariance").graph.tau[0] == 100.0
    with pytest.raises(FormatError, match="covariances, not sqrt-information"):
        read(path, weights_are="sqrt-information")
    with pytest.raises(FormatError, match="about tangents, not quaternion"):
        read(path, rotation_information="quaternion")
    assert read(path, mahalanobis=True).graph.kappa[0] == 200.0


def test_priors_are_in_the_order_of_the_file(pyfg):
    lines = PLANE.splitlines(keepends=True)
    lines.insert(3, lines.pop(4))
    graph = read(pyfg("".join(lines))).graph
    assert graph.edges.tolist() == [[0, 1], [1, 2], [3, 2], [3, 0]]
    assert graph.kappa.tolist() == [400.0, 0.0, 0.0, 8.0]


def test_matrices_of_what_is_left_out_are_left_out(pyfg):
    skew = PLANE.replace("0.04 0.01 0.0625", "4e-6 0 0.0625")
    information = read(pyfg(skew), landmarks=False).graph.information
    assert len(information.distinct) == 2
    assert information.anisotropy == (1.0, 1.0)


def test_lines_that_are_skipped_are_not_read(pyfg):
    text = PLANE.replace("VERTEX_XY:PRIOR 0 L0", "VERTEX_XY:PRIOR 0 7")
    assert "1 VERTEX_XY:PRIOR line skipped: priors" in read(pyfg(text), priors=False).notices


def test_unit_weights_take_what_is_no_covariance(pyfg):
    text = PLANE.replace("0.0025\n", "-1\n").replace("2.25 0.0625", "2.25 0")
    assert read(pyfg(text), unit_weights=True).graph.ranges.weights.tolist() == [1.0, 1.0]


def test_the_world_has_a_name_of_its_own(pyfg):
    assert read(pyfg(PLANE.replace("B7", "world"))).names == ("A0", "world", "L0", "world_")


def with_line(text, old, new):
    """A text whose line with ``old`` is changed, and that line's number."""
    lines = text.splitlines()
    number = next(k for k, line in enumerate(lines, 1) if old in line)
    lines[number - 1] = lines[number - 1].replace(old, new)
    return "\n".join(lines), number


WRONG = [
    ("EDGE_SE2_XY 10.5", "EDGE_SE2_XYZ 10.5", "pyfg has no tag 'EDGE_SE2_XYZ' (--skip"),
    ("EDGE_SE2 10.5 A0 B7", "EDGE_SE2 10.5 A0 B8", "B8 is unknown: no VERTEX line names it"),
    ("RANGE 10.5 L0 A0", "RANGE 10.5 L1 A0", "L1 is unknown"),
    ("PRIOR 0 L0", "PRIOR 0 L1", "L1 is unknown"),
    ("EDGE_SE2 10.5 A0 B7", "EDGE_SE2 10.5 A0 L0", "L0 is a point, and a pose is expected there"),
    ("EDGE_SE2_XY 10.5 B7 L0", "EDGE_SE2_XY 10.5 B7 A0", "A0 is a pose, and a point is expected"),
    ("PRIOR 0 A0", "PRIOR 0 L0", "L0 is a point, and a pose is expected there"),
    ("11.5 B7", "11.5 A0", "A0 appears twice"),
    ("11.5 B7", "11.5 L0", "L0 appears twice"),
    ("11.5 B7", "11.5 7", "a name expected, such as A0, not the number '7'"),
    ("A0 B7 1 0 1.5", "A0 A0 1 0 1.5", "A0 is measured from itself"),
    ("L0 A0 2.25", "A0 A0 2.25", "A0 is measured from itself"),
    ("11.5 B7 1", "11.5 B7", "VERTEX_SE2 takes a time, a name and 3 numbers; 4 values found"),
    ("0 0.0025", "0", "2 names, 3 numbers and 6 numbers of a covariance; 11 values found"),
    ("2.25 0.0625", "2.25", "takes a time, 2 names, a distance and a variance; 4 values found"),
    ("XY L0 1 2", "XY L0 1 2 3", "VERTEX_XY takes a name and 2 numbers; 4 values found"),
    ("B7 1 0 1.5", "B7 1 inf 1.5", "numbers must be finite"),
    ("11.5 B7", "nan B7", "numbers must be finite"),
    ("11.5 B7", "noon B7", "numbers expected after the tag, not 'noon'"),
    ("A0 B7 1 0 1.5", "A0 B7 1 x 1.5", "numbers expected after the names, not 'x'"),
    ("0 0.0025", "0 nan", "numbers must be finite"),
    ("0 0.0025", "0 0_1", "numbers expected after the names, not '0_1'"),
    ("0 0.0025", "0 0", "a covariance is not positive definite"),
    ("0.04 0.01 0.0625", "0.04 1 0.0625", "a covariance is not positive definite"),
    ("2.25 0.0625", "2.25 0", "a variance must be positive, not 0"),
    ("2.25 0.0625", "2.25 -1", "a variance must be positive, not -1"),
    ("2.25 0.0625", "2.25 1e-300", "variances between"),
    ("2.25 0.0625", "2.25 nan", "numbers must be finite"),
    ("2.25 0.0625", "-2.25 0.0625", "a distance must not be negative, as -2.25 is"),
    ("2.25 0.0625", "1e99 0.0625", "positions and distances up to 1e"),
    ("A0 B7 1 0 1.5", "A0 B7 1e99 0 1.5", "positions and distances up to 1e"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_wrong_lines(pyfg, old, new, message):
    text, number = with_line(PLANE, old, new)
    path = pyfg(text)
    with pytest.raises(FormatError, match=re.escape(message)) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}:{number}: ")
    assert "\n" not in str(caught.value)


def test_dimensions_are_not_mixed(pyfg):
    with pytest.raises(FormatError, match=r":10: VERTEX_XYZ in a file of 2D poses"):
        read(pyfg(PLANE + "VERTEX_XYZ L9 1 2 3\n"))
    with pytest.raises(FormatError, match=r":9: EDGE_SE2 in a file of 3D poses"):
        read(pyfg(SPACE + "EDGE_SE2 10.5 A0 B7 1 0 1.5 0.01 0 0 0.01 0 0.0025\n"))
    with pytest.raises(FormatError, match=r":9: a quaternion must not be zero"):
        read(pyfg(SPACE + "VERTEX_SE3:QUAT 0 A2 1 0 0 0 0 0 0\n"))


def test_names_are_text(tmp_path):
    path = tmp_path / "graph.pyfg"
    path.write_bytes(PLANE.encode().replace(b"B7", b"B\xff"))
    with pytest.raises(FormatError, match=r":3: names in UTF-8 expected"):
        read(path)
    path.write_text(PLANE.replace("B7", "Boje\N{LATIN SMALL LETTER U WITH DIAERESIS}"), "utf-8")
    io.write(path, read(path))
    assert read(path).names[1].startswith("Boje")


def test_files_without_a_graph(pyfg):
    lines = PLANE.splitlines(keepends=True)
    with pytest.raises(NoMeasurements, match="this is an estimate"):
        read(pyfg("".join(lines[:3])))
    with pytest.raises(FormatError, match="no edges: measurements between poses"):
        read(pyfg("".join(lines[:5] + lines[7:])))
    with pytest.raises(FormatError, match="no vertex lines"):
        read(pyfg(lines[5]))


def test_content_decides(file):
    planar = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    points = "VERTEX_XY 5 1 2\nEDGE_SE2_XY 0 5 1 2 1 0 1\n"
    for text, name in ((planar, "g2o"), (points, "g2o"), (PLANE, "pyfg"), (SPACE, "pyfg")):
        for suffix in (".g2o", ".pyfg", ".txt"):
            assert format_of(file(text, f"graph{suffix}")).name == name
    assert format_of(file("VERTEX_SE2 0 A0 1 2\n", "graph.pyfg")).name == "pyfg"
    assert format_of(file("VERTEX_SE2 0 x 1 2\n", "graph.g2o")).name == "g2o"


def assert_agree(a, b, rtol=1e-13):
    assert a.names == b.names
    assert a.world == b.world
    np.testing.assert_array_equal(a.graph.edges, b.graph.edges)
    np.testing.assert_array_equal(a.graph.is_point, b.graph.is_point)
    for p, q in (
        (a.graph.tau, b.graph.tau),
        (a.graph.kappa, b.graph.kappa),
        (a.graph.translations, b.graph.translations),
        (a.graph.ranges.weights, b.graph.ranges.weights),
        (a.graph.information_matrices, b.graph.information_matrices),
    ):
        np.testing.assert_allclose(p, q, rtol=rtol, atol=rtol * np.abs(q).max())
    np.testing.assert_allclose(a.graph.rotations, b.graph.rotations, atol=1e-14)
    np.testing.assert_array_equal(a.graph.ranges.edges, b.graph.ranges.edges)
    np.testing.assert_array_equal(a.graph.ranges.distances, b.graph.ranges.distances)
    np.testing.assert_allclose(a.initial.rotations, b.initial.rotations, atol=1e-14)
    np.testing.assert_allclose(a.initial.translations, b.initial.translations, atol=1e-9)


@pytest.mark.parametrize("suffix", [".pyfg", ".npz"])
@pytest.mark.parametrize("name", SAMPLES)
def test_samples_are_written_and_read_again(dataset, tmp_path, name, suffix):
    instance, path = dataset(name), tmp_path / f"again{suffix}"
    io.write(path, instance)
    assert_agree(read(path), instance, 1e-13 if suffix == ".pyfg" else 0.0)


@pytest.mark.parametrize("text", [PLANE, SPACE])
def test_small_ones_are_written_and_read_again(pyfg, tmp_path, text):
    instance, path = read(pyfg(text)), tmp_path / "again.pyfg"
    io.write(path, instance)
    assert_agree(read(path), instance)
    far = replace(instance, origin=np.full(instance.graph.d, 1024.0))
    io.write(path, far)
    np.testing.assert_array_equal(read(path).origin, far.origin)


@pytest.mark.parametrize("text", [PLANE, SPACE])
def test_estimates_are_matched_by_their_names(pyfg, tmp_path, text):
    instance = read(pyfg(text))
    path = tmp_path / "estimate.pyfg"
    io.write(path, instance.initial, instance=instance)
    found = io.read_estimate(path, instance)
    np.testing.assert_allclose(found.translations, instance.initial.translations, atol=1e-13)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(reversed(lines)))
    again = io.read_estimate(path, instance)
    np.testing.assert_array_equal(again.translations, found.translations)
    with pytest.raises(NoMeasurements):
        read(path)
    poses = read(pyfg(text), landmarks=False)
    assert io.read_estimate(path, poses).num_nodes == instance.graph.num_nodes - 1
    path.write_text(path.read_text().replace("L0", "L5"))
    with pytest.raises(FormatError, match=r"L5 is not in the graph \(1 of 3 are not\)"):
        io.read_estimate(path, instance)
    path.write_text(path.read_text().replace("L5", "A0"))
    with pytest.raises(FormatError, match="A0 appears twice"):
        io.read_estimate(path, instance)


def test_graphs_without_names_get_some(tmp_path, file):
    instance = helix(3, np.random.default_rng(0))
    path = tmp_path / "helix.pyfg"
    with pytest.warns(InputNotice, match="fixed nodes"):
        io.write(path, replace(instance, ids=instance.ids + 5, fixed=(0,), initial=None))
    found = read(path)
    assert found.names[:2] == ("A5", "A6")
    assert found.initial is None
    np.testing.assert_allclose(found.graph.tau, instance.graph.tau, rtol=1e-15)
    np.testing.assert_allclose(found.graph.kappa, instance.graph.kappa)
    estimate = tmp_path / "estimate.pyfg"
    io.write(estimate, instance.truth, instance=instance, anchor="none")
    with pytest.warns(InputNotice, match="the numbers in names are used as node ids"):
        again = io.read_estimate(estimate, instance)
    np.testing.assert_array_equal(again.translations, instance.truth.translations)
    g2o = "EDGE_SE2 0 1 1 0 0 4 1 0 4 0 4\nEDGE_SE2_XY 0 9 1 0 4 1 4\nEDGE_SE2_XY 1 9 1 0 4 1 4\n"
    seen = read(file(g2o))
    io.write(path, seen)
    assert read(path).names == ("A0", "A1", "L9")
    np.testing.assert_allclose(
        read(path).graph.information_matrices,
        seen.graph.information_matrices,
        rtol=1e-14,
        atol=1e-14,
    )


def test_what_cannot_be_written(pyfg, tmp_path, file):
    instance = read(pyfg(PLANE))
    with pytest.raises(InputError, match=r"only .npz and .pyfg files hold ranges, and there are 2"):
        io.write(tmp_path / "graph.g2o", instance)
    with pytest.warns(InputNotice) as said:
        io.write(tmp_path / "graph.g2o", replace(instance, graph=instance.graph.with_ranges(None)))
    assert "g2o files hold no timestamps" in str(said[0].message)
    assert "g2o files hold no such names as 'A0'" in str(said[1].message)
    unseen = read(pyfg(PLANE.replace("EDGE_SE2_XY", "# ")))
    with pytest.raises(InputError, match="points that no pose sees, and there are 1 point"):
        io.write(tmp_path / "graph.g2o", replace(unseen, graph=unseen.graph.with_ranges(None)))
    out = tmp_path / "graph.pyfg"
    for name in ("a b", "12", "", "a#b", "a\x7f", "\ud800"):
        with pytest.raises(InputError, match="names without blanks that are no numbers"):
            io.write(out, replace(instance, names=(name, *instance.names[1:])))
    with pytest.raises(InputError, match="this graph measures rotations alone"):
        io.write(out, instance.graph.rotations_alone)
    bad = "EDGE_SE2 0 1 1 0 0 4 9 0 4 0 4\n".replace("4 9 0 4 0 4", "4 0 3 4 0 1")
    with pytest.raises(InputError, match=r"edge 0 to 1: .*information is not positive definite"):
        io.write(out, read(file(bad)))
    compass = certpgo.with_priors(
        read(file(bad)).graph, np.array([0, 1]), np.tile(np.eye(2), (2, 1, 1)), kappa=np.ones(2)
    )
    anchored = certpgo.Instance("a", compass, np.arange(3), world=2)
    for known in (anchored, compass):  # a graph knows its world as well
        with pytest.raises(InputError, match="no measurements of an attitude alone"):
            io.write(out, known)
    unknown = certpgo.Instance("a", compass, np.arange(3))
    with pytest.raises(InputError, match=r"only .npz files hold edges that measure only"):
        io.write(out, unknown)
    with pytest.raises(InputError, match="the estimate has rotations only"):
        io.write(out, certpgo.Estimate(np.eye(2)[None]))


def test_arrays_of_ranges_are_checked(pyfg, tmp_path):
    path = tmp_path / "graph.npz"
    io.write(path, read(pyfg(PLANE)))
    arrays = dict(np.load(path))
    np.savez(path, **{k: v for k, v in arrays.items() if k != "range_weights"})
    with pytest.raises(FormatError, match="the array 'range_weights' is missing"):
        read(path)
    np.savez(path, **{**arrays, "range_weights": np.ones(3)})
    with pytest.raises(FormatError, match="'range_weights' must be"):
        read(path)


def test_the_command_converts(pyfg, tmp_path, capsys):
    source, target, back = pyfg(PLANE), tmp_path / "out.npz", tmp_path / "back.pyfg"
    assert main(["convert", str(source), str(target)]) == 0
    assert main(["convert", str(target), str(back)]) == 0
    assert_agree(read(back), read(source))
    poses = tmp_path / "poses.pyfg"
    assert main(["convert", str(source), str(poses), "--estimate"]) == 0
    capsys.readouterr()
    assert main(["convert", str(source), str(tmp_path / "out.g2o")]) != 0
    assert "hold ranges, and there are 2" in capsys.readouterr().err
    assert not (tmp_path / "out.g2o").exists()


def test_negative_ids_come_back(file, tmp_path):
    lines = "EDGE_SE2 -4 -1 1 0 0\nEDGE_SE2 -1 4 1 0 0.5\nEDGE_SE2_XY -4 -7 2 1 1 0 1\n"
    instance = io.read(file(lines), quiet=True)
    estimate = certpgo.solve(instance).estimate
    certpgo.write(tmp_path / "t.pyfg", estimate, instance=instance)
    assert " A-4 " in (tmp_path / "t.pyfg").read_text()
    with pytest.warns(InputNotice, match="numbers in names"):
        again = io.read_estimate(tmp_path / "t.pyfg", instance)
    assert again.keys.ids.tolist() == [-7, -4, -1, 4]
    assert again.translations == pytest.approx(estimate.anchored(1).translations, abs=1e-12)
