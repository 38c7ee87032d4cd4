"""Priors in g2o files."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import certpgo
from certpgo import FormatError, InputError, io
from certpgo.errors import InputNotice
from certpgo.linalg import rotations as so

SQUARE = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5
EDGE_SE2 0 1 1 0 1.5 100 0 0 100 0 400
"""
SPACE = """\
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 1 0 0 1 0 1
EDGE_SE3:QUAT 1 2 0 1 0 0 0 0 1 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 1 0 0 1 0 1
"""
TAIL = " 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 2 0 0 2 0 2\n"
XYZ = " 9 0 0 9 0 9\n"


@pytest.mark.parametrize("tag", ["EDGE_PRIOR_SE2", "EDGE_SE2_PRIOR"])
def test_poses_in_the_plane(file, tag):
    instance = io.read(file(SQUARE + f"{tag} 1 5 6 0.5 25 0 0 25 0 16\n"), quiet=True)
    assert instance.world == 2
    assert instance.ids.tolist() == [0, 1, 2]
    graph = instance.graph
    assert graph.edges.tolist() == [[0, 1], [2, 1]]
    assert (graph.kappa[1], graph.tau[1]) == (16.0, 25.0)
    np.testing.assert_allclose(graph.translations[1], [5.0, 6.0])
    np.testing.assert_allclose(so.log(graph.rotations[1:]), [[0.5]])
    assert instance.graph.information_matrices.shape == (2, 3, 3)
    assert instance.graph.information.residual == "g2o"
    np.testing.assert_array_equal(instance.initial.rotations[2], np.eye(2))
    assert "1 prior, measured from a node that stands for the world" in instance.notices


@pytest.mark.parametrize("tag", ["EDGE_PRIOR_SE2_XY", "EDGE_SE2_GPS"])
def test_positions_in_the_plane(file, tag):
    text = f"{tag} 0 5 6 4 0 4\n{tag} 1 7 8 2 1 2\n{tag} 1 7 8\n"
    graph = io.read(path := file(SQUARE + text), quiet=True).graph
    assert graph.kappa[1:].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(graph.tau[1:], [4.0, 1.5, 1.0], rtol=1e-15)  # 2 / tr(inverse)
    assert io.read(path, quiet=True).graph.information is None  # one has none
    assert io.read(path, quiet=True, kappa=7.0).graph.kappa.tolist() == [7.0, 0, 0, 0]
    unit = io.read(path, quiet=True, unit_weights=True).graph
    assert unit.kappa.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert unit.tau.tolist() == [1.0] * 4


def test_space(file):
    lines = f"EDGE_SE3_PRIOR 0 0 1 2 3 0 0 0 1{TAIL}EDGE_SE3_XYZPRIOR 2 0 4 5 6{XYZ}"
    instance = io.read(file(SPACE + "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + lines), quiet=True)
    graph = instance.graph
    assert graph.edges[2:].tolist() == [[3, 0], [3, 2]]
    assert graph.kappa[2:].tolist() == [1.0, 0.0]
    assert graph.tau[2:].tolist() == [4.0, 9.0]
    assert (
        "2 priors, measured from a node that stands for the world; 1 of them positions alone"
        in instance.notices[-1]
    )


MIXED = """EDGE_SE2 0 1 1 0 0.1 4 0 0 4 0 9
EDGE_SE2 1 0 -1.1 0 -0.2 4 0 0 4 0 9
EDGE_PRIOR_SE2_XY 0 0 0 5 0 7
EDGE_PRIOR_SE2 1 1.1 0.1 0.1 2 0 0 3 0 4
EDGE_SE2_GPS 1 2 0 5 0 7
EDGE_PRIOR_SE2 0 0.1 0.1 0 2 0 0 3 0 4
"""


def test_they_stay_in_the_order_of_the_file(file):
    """`keep` means the first or last line, and the checker counts lines."""
    graph = io.read(file(MIXED), quiet=True).graph
    assert graph.edges[2:].tolist() == [[2, 0], [2, 1], [2, 1], [2, 0]]
    assert graph.kappa[2:].tolist() == [0.0, 4.0, 0.0, 4.0]
    assert graph.translations[2:, 0].tolist() == [0.0, 1.1, 2.0, 0.1]
    for keep, steps in (("first", [1.0, 0.0, 1.1]), ("last", [-1.1, 2.0, 0.1])):
        kept = io.read(file(MIXED), quiet=True, keep=keep).graph
        assert kept.kappa.tolist() == [9.0, 0.0, 4.0]
        assert kept.translations[:, 0].tolist() == steps


def test_a_proof_under_g2os_cost_is_about_the_same_lines(file, tmp_path):
    path = file(MIXED)
    instance = io.read(path, quiet=True)
    answer = certpgo.solve(instance)
    assert answer.certificate.objective.startswith("g2o")
    proven = instance, answer.estimate, answer.certificate
    said = certpgo.write_proof(tmp_path / "proof.cert", path, *proven)
    assert said.lower == pytest.approx(answer.cost, rel=1e-9)


def test_they_can_be_skipped(file):
    path = file(SQUARE + "EDGE_PRIOR_SE2_XY 0 5 6 4 0 4\n")
    instance = io.read(path, quiet=True, priors=False)
    assert instance.world is None
    assert instance.graph.num_edges == 1
    assert "1 EDGE_PRIOR_SE2_XY line skipped: priors" in instance.notices


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SQUARE + "EDGE_PRIOR_SE2_XY 7 5 6 4 0 4\n", "prior of node 7: no such node"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 1 5 6 4 0\n", "takes 1 id and 2 numbers, then 3"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 1 5\n", "takes 1 id and 2 numbers"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 1 5 6 4 9 4\n", "information of a position is not positive"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 1 5 6 4 x 4\n", "must be decimal numbers"),
        (SQUARE + "EDGE_PRIOR_SE2 1 5 6 0 1 0 0 1 0 -1\n", "not positive definite"),
        (SPACE + f"EDGE_SE3_PRIOR 0 5 1 2 3 0 0 0 1{TAIL}", "sensor 5, which is unknown"),
        (SPACE + f"EDGE_SE3_PRIOR 0 -1 1 2 3 0 0 0 1{TAIL}", "sensor -1, which is unknown"),
        (
            SPACE
            + "PARAMS_SE3OFFSET 5 1 0 0 0 0 0 1\nPARAMS_SE3OFFSET 5 0 0 0 0 0 0 1\n"
            + f"EDGE_SE3_XYZPRIOR 0 5 1 2 3{XYZ}",
            "sensor 5 has two different poses",
        ),
        (SQUARE + f"EDGE_SE3_XYZPRIOR 0 0 1 2 3{XYZ}", "in a file of 2D poses"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 0 1e160 6 4 0 4\n", "translations up to 1e.90 expected"),
        (SQUARE + "EDGE_PRIOR_SE2_XY 0 5 6 1e-320 0 1e-320\n", "information must give weights"),
        (
            SQUARE.replace(" 1 ", " 9223372036854775807 ", 1).replace(
                "0 1 1 0", "0 9223372036854775807 1 0"
            )
            + "EDGE_PRIOR_SE2_XY 0 5 6 4 0 4\n",
            "leaves no id for the world",
        ),
    ],
)
def test_wrong_lines(file, text, message):
    with pytest.raises((FormatError, InputError), match=message):
        io.read(file(text), quiet=True)


def test_written_and_read_again(file, tmp_path):
    text = SQUARE + "EDGE_PRIOR_SE2_XY 0 5 6 4 0 4\nEDGE_PRIOR_SE2 1 7 8 0.5 25 0 0 25 0 16\n"
    instance = io.read(file(text), quiet=True)
    io.write(tmp_path / "again.g2o", instance)
    again = io.read(tmp_path / "again.g2o", quiet=True)
    for name in ("edges", "translations", "tau"):
        np.testing.assert_array_equal(getattr(again.graph, name), getattr(instance.graph, name))
    np.testing.assert_array_equal(again.graph.kappa, instance.graph.kappa)
    assert again.world == instance.world
    io.write(tmp_path / "graph.npz", instance)
    kept = io.read(tmp_path / "graph.npz", quiet=True)
    assert kept.world == instance.world
    np.testing.assert_array_equal(kept.graph.tau, instance.graph.tau)
    lines = SPACE + f"EDGE_SE3_PRIOR 0 0 1 2 3 0 0 0 1{TAIL}EDGE_SE3_XYZPRIOR 2 0 4 5 6{XYZ}"
    space = io.read(file(lines), quiet=True)
    io.write(tmp_path / "space.g2o", space)
    found = io.read(tmp_path / "space.g2o", quiet=True).graph
    np.testing.assert_array_equal(found.tau, space.graph.tau)
    attitude = certpgo.with_priors(
        space.graph.with_edges(np.arange(2)), [0, 1], np.tile(np.eye(3), (2, 1, 1)), kappa=1.0
    )
    io.write(tmp_path / "attitude.g2o", attitude)  # a graph knows its world
    found = io.read(tmp_path / "attitude.g2o", quiet=True).graph
    np.testing.assert_allclose(found.kappa, attitude.kappa, rtol=1e-15)
    np.testing.assert_array_equal(found.tau, attitude.tau)
    unknown = certpgo.Instance("a", attitude, np.arange(attitude.num_nodes))
    with pytest.raises(InputError, match="measure only"):
        io.write(tmp_path / "attitude.g2o", unknown)


def test_estimates_are_in_the_world(file, tmp_path):
    text = SQUARE + "EDGE_PRIOR_SE2 0 5 6 0.5 25 0 0 25 0 16\n"
    instance = io.read(file(text), quiet=True)
    answer = certpgo.solve(instance)
    io.write(tmp_path / "out.g2o", answer.estimate, instance=instance)
    again = io.read_estimate(tmp_path / "out.g2o", instance)
    assert again.num_nodes == 3
    np.testing.assert_array_equal(again.translations[2], 0.0)
    np.testing.assert_allclose(again.translations[0], [5.0, 6.0], atol=1e-9)
    assert len(io.read_estimate(tmp_path / "out.g2o").rotations) == 2
    io.write(tmp_path / "out.tum", answer.estimate, instance=instance)
    assert len((tmp_path / "out.tum").read_text().splitlines()) == 2
    judged = certpgo.certify(certpgo.Quadratic(instance.graph), again)
    assert judged.verdict.value == "CERTIFIED"
    read = io.read(file(text), quiet=True, truth=tmp_path / "out.g2o")
    np.testing.assert_array_equal(read.truth.translations[2], 0.0)


FIELD = "".join(
    f"EDGE_SE2 {k} {(k + 1) % 12} {1.0 + 0.02 * (k % 3)} 0.01 {0.5236 + 0.01 * (k % 2)}"
    " 100 0 0 100 0 100\n"
    for k in range(12)
)


def field(file, x, y):
    """A ring of poses with positions around (x, y), metres."""
    a = 0.5236 * np.arange(12)
    p = np.stack([1.93 * np.cos(a), 1.93 * np.sin(a)], axis=1) + 0.1 * np.sin(7.0 * a)[:, None]
    return io.read(
        file(FIELD + "".join(
            f"EDGE_PRIOR_SE2_XY {k} {round(u + x, 3)!r} {round(v + y, 3)!r} 25 0 25\n"
            for k, (u, v) in enumerate(p.tolist())
        )), quiet=True,
    )  # fmt: skip


def test_map_coordinates_cost_no_digits(file, tmp_path):
    near, far = field(file, 0.0, 0.0), None
    first = certpgo.solve(near, cost="chordal")
    far = field(file, 500000.0, 4500000.0)
    assert near.origin is None
    assert np.abs(far.origin - [500000.0, 4500000.0]).max() < 8.0
    answer = certpgo.solve(far, cost="chordal")
    assert answer.certificate.lower_bound == pytest.approx(first.certificate.lower_bound, rel=1e-5)
    assert answer.certificate.tolerance < 1e-4 * answer.cost
    there = far.in_world(answer.estimate)
    moved = near.in_world(first.estimate).translations + np.array([5e5, 4.5e6])
    np.testing.assert_allclose(there.translations, moved, atol=1e-3)
    io.write(tmp_path / "out.g2o", answer.estimate, instance=far)
    again = io.read_estimate(tmp_path / "out.g2o", far)
    problem = certpgo.Quadratic(far.graph)
    assert certpgo.certify(problem, again).verdict.value == "CERTIFIED"
    # An estimate that is off is not certified either.
    turned = again.rotations @ so.exp(np.full((13, 1), 0.05) * np.arange(13)[:, None] % 0.1)
    off = certpgo.Estimate(turned, again.translations)
    assert certpgo.certify(problem, off).verdict.value != "CERTIFIED"
    io.write(tmp_path / "again.g2o", far)
    copied = io.read(tmp_path / "again.g2o", quiet=True)
    np.testing.assert_array_equal(copied.graph.translations, far.graph.translations)
    np.testing.assert_array_equal(copied.origin, far.origin)
    io.write(tmp_path / "again.npz", far)
    np.testing.assert_array_equal(io.read(tmp_path / "again.npz", quiet=True).origin, far.origin)


def test_the_world_is_never_matched_by_an_id(file, tmp_path):
    instance = io.read(file(SQUARE + "EDGE_PRIOR_SE2 0 5 6 0.5 25 0 0 25 0 16\n"), quiet=True)
    path = tmp_path / "longer.tum"
    path.write_text("".join(f"{k} 5 6 0 0 0 0 1\n" for k in range(3)))
    with pytest.raises(FormatError, match="node 2 is not in the graph"):
        io.read_estimate(path, instance)
    with pytest.warns(InputNotice, match="timestamps taken for node ids; 1 other pose not used"):
        nodes, _ = io.read_truth(path, instance)
    assert nodes.tolist() == [0, 1]


def test_poses_are_matched_in_order_and_by_time(file, tmp_path):
    instance = io.read(file(SQUARE + "EDGE_PRIOR_SE2 0 5 6 0.5 25 0 0 25 0 16\n"), quiet=True)
    answer = certpgo.solve(instance)
    times, path = tmp_path / "times.txt", tmp_path / "out.tum"
    times.write_text("10.5\n11.5\n")
    io.write(path, answer.estimate, instance=instance, timestamps=times)
    again = io.read_estimate(path, instance, timestamps=times)
    np.testing.assert_allclose(again.translations, _all(instance, answer), atol=1e-9)


def _all(instance, answer):
    return instance.with_world(instance.in_world(answer.estimate)).translations


def test_parameters_of_sensors_are_no_obstacle(file):
    stray = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n"
    assert io.read(file(SQUARE + stray), quiet=True).graph.d == 2
    assert (
        io.read(
            file(SPACE + "PARAMS_SE3OFFSET 0\n"), quiet=True, priors=False, landmarks=False
        ).graph.d
        == 3
    )


def turned(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (500_000.0, 4_000_000.0)])
def test_positions_beside_an_attitude_written_at_the_origin(file, east, north):
    """A compass, and positions of UTM far away: the least squares of SciPy, near the origin."""
    instance = io.read(
        file(
            "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n"
            "EDGE_PRIOR_SE2 0 0 0 0.5 0 0 0 0 0 1\n"
            f"EDGE_PRIOR_SE2_XY 0 {east} {north} 1 0 1\n"
            f"EDGE_PRIOR_SE2_XY 2 {east + 1.75} {north + 0.25} 1 0 1\n"
        ),
        quiet=True,
    )
    said = "2 of them positions alone; 1 of them attitudes alone"
    assert any(said in notice for notice in instance.notices)

    def residuals(x):
        t, angles = x[:6].reshape(3, 2), x[6:]
        steps = [turned(angles[k]).T @ (t[k + 1] - t[k]) - [1, 0] for k in range(2)]
        return np.concatenate(
            [*steps, np.diff(angles), [angles[0] - 0.5], t[0], t[2] - [1.75, 0.25]]
        )

    found = least_squares(residuals, [0, 0, 1, 0, 2, 0, 0, 0, 0], xtol=1e-15, gtol=1e-15)
    answer = certpgo.solve(instance)
    assert answer.cost == pytest.approx(2 * found.cost, rel=1e-9)
    t = instance.in_world(answer.estimate).translations
    assert t - [east, north] == pytest.approx(found.x[:6].reshape(3, 2), abs=1e-6)


def test_attitudes_alone(file):
    """Two compasses that differ by what the odometry turns: nothing is left over."""
    instance = io.read(
        file(
            "EDGE_SE2 0 1 1 0 0.25 1 0 0 1 0 1\n"
            "EDGE_PRIOR_SE2 0 7 7 0.5 0 0 0 0 0 1\nEDGE_PRIOR_SE2 1 0 0 0.75 0 0 0 0 0 1\n"
        ),
        quiet=True,
    )
    assert any("2 of them attitudes alone" in notice for notice in instance.notices)
    answer = certpgo.solve(instance)
    assert answer.cost == pytest.approx(0.0, abs=1e-20)
    R = instance.in_world(answer.estimate).rotations
    assert np.arctan2(R[:, 1, 0], R[:, 0, 0]) == pytest.approx([0.5, 0.75], abs=1e-12)


@pytest.mark.parametrize("placed", ["", "EDGE_PRIOR_SE2_XY 0 3 4 1 0 1\n"], ids=["assumed", "gps"])
def test_a_part_without_the_node_that_placed_the_world(file, placed):
    """What is left of the compasses is solved: by hand, 1/3 of (0.25 - 0.1)^2."""
    from certpgo.graph.components import restricted

    instance = io.read(
        file(
            "EDGE_SE2 0 1 1 0 0.25 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0.25 1 0 0 1 0 1\n"
            "EDGE_PRIOR_SE2 0 7 7 0.5 0 0 0 0 0 1\nEDGE_PRIOR_SE2 1 7 7 0.5 0 0 0 0 0 1\n"
            f"EDGE_PRIOR_SE2 2 0 0 0.6 0 0 0 0 0 1\n{placed}"
        ),
        quiet=True,
    )
    part = restricted(instance, np.array([1, 2, 3]), "without the first")
    assert part.known_numbers.tolist() == [1, 3, 4, -1]
    assert part.num_measurements == 3
    assert part.pairs[part.is_measured].tolist() == [[1, 2], [3, 1], [3, 2]]
    answer = certpgo.solve(part)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(0.0075, rel=1e-9)
    again = restricted(part, np.array([0, 1, 2]), "the same")
    assert again.graph.num_edges == part.graph.num_edges
