"""Scaled bundle adjustment: XM's observations, what is solved, and what holding a scale does.

The optimum is compared with that of least squares over rotation vectors and logarithms of scales.
"""

import struct

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import certpgo
from certpgo import io
from certpgo.cli import main
from certpgo.errors import FormatError, GraphError
from certpgo.io.datasets.monocular import ring_of_depths


def packed(rows, columns=6, stated=None):
    table = np.asarray(rows, dtype="<f8").reshape(-1, columns)
    return struct.pack("<II", stated or len(table), columns) + table.tobytes(order="F")


@pytest.fixture
def written(tmp_path):
    def write(content, name="landmark.bin"):
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return write


#: Cameras 3 and 7 see points 1, 2, 5 and 9.
SEEN = [
    (camera, point, 0.1 * camera, 0.2 * point, 1.0 + 0.1 * (camera * point % 7), 0.5 * camera)
    for camera in (7, 3)
    for point in (9, 1, 5, 2)
]


def as_rows(graph, moved_by):
    i, j = graph.edges.T
    return np.column_stack([i + 1, j + 1 - moved_by, graph.translations, graph.tau])


# --- The file


@pytest.mark.parametrize("columns", [6, 8])
def test_rows_are_points_in_the_frames_of_cameras_of_unknown_scale(written, columns):
    rows = np.pad(np.array(SEEN), ((0, 0), (0, columns - 6)), constant_values=-1.0)
    instance = io.read(written(packed(rows, columns)), quiet=True)
    graph = instance.graph
    assert instance.ids.tolist() == [3, 7, 9, 10, 13, 17]
    assert graph.is_point.tolist() == [False, False, True, True, True, True]
    assert graph.free.tolist() == [True, True, False, False, False, False]
    assert graph.in_mean_unit
    back = np.column_stack([instance.ids[graph.edges], graph.translations, graph.tau])
    back[:, 1] -= 8
    np.testing.assert_array_equal(back, SEEN)
    assert instance.notices[0] == "4 points, 8 sightings; point k has the id k + 8"
    unit = io.read(written(packed(rows, columns)), unit_weights=True, quiet=True)
    assert (unit.graph.tau == 1.0).all()


def test_what_determines_nothing_is_left_out_and_said(written):
    once, alone = (3, 11, 0, 0, 1, 1), [(8, 1, 0, 0, 1, 1), (8, 2, 0, 0, 1, 1), (8, 11, 0, 0, 1, 1)]
    instance = io.read(written(packed([*SEEN, once])), quiet=True)
    assert instance.graph.num_edges == len(SEEN)
    assert "1 sighting left out: of points seen once" in instance.notices[1]
    # Without camera 8, point 12 is seen once: both go, in turn.
    chained = [(8, 1, 0, 0, 1, 1), (8, 12, 0, 0, 1, 1), (3, 12, 0, 0, 1, 1)]
    left = io.read(written(packed([*SEEN, *chained])), quiet=True)
    np.testing.assert_array_equal(left.graph.edges, instance.graph.edges)
    assert io.read(written(packed([*SEEN, once, *alone])), quiet=True).graph.num_edges == 12
    with pytest.raises(FormatError, match="no camera sees 3 points that others see"):
        io.read(written(packed(SEEN[:4])))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\x01\x00", "this ends early"),
        (packed(SEEN)[:-8], "8 rows of 6 numbers take 392 bytes, not 384"),
        (packed(SEEN) + b"\0", "take 392 bytes, not 393"),
        (packed(np.ones((2, 5)), 5), "not 2 rows of 5 numbers"),
        (struct.pack("<II", 0, 6), "not 0 rows of 6 numbers"),
        (packed([*SEEN, (0, 1, 0, 0, 1, 1)]), "row 9: cameras and points numbered from 1 expected"),
        (packed([(1.5, 1, 0, 0, 1, 1)]), "row 1: cameras and points numbered from 1 expected"),
        (packed([(1, 2.0**31, 0, 0, 1, 1)]), "row 1: cameras and points numbered from 1"),
        (packed([(1, 1, 0, np.inf, 1, 1)]), "row 1: finite numbers expected, not 1 1 0 inf 1 1"),
        (packed([(1, 1, 0, 0, 1, 0.0)]), "row 1: weights above 0 expected"),
    ],
)
def test_other_files_are_refused_in_one_line(written, content, expected, capsys):
    path = written(content)
    with pytest.raises(FormatError) as caught:
        io.read(path)
    assert expected in str(caught.value)
    assert main(["solve", str(path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_without_landmarks_nothing_is_left(written):
    with pytest.raises(FormatError, match="sightings of landmarks alone, which are skipped"):
        io.read(written(packed(SEEN)), landmarks=False)


# --- What is solved


def descended(graph, truth, held):
    """The least cost that least squares finds from the truth, by another parametrization."""
    n = int((~graph.is_point).sum())
    i, j = graph.edges.T

    def residuals(x):
        turn, t, log_s = x[: 3 * n].reshape(n, 3), x[3 * n : -n].reshape(-1, 3), x[-n:]
        s = np.exp(log_s)
        seen = s[i, None] * Rotation.from_rotvec(turn[i]).apply(np.array(graph.translations))
        unit = s[0] if held else np.sqrt(np.mean(s**2))
        return (np.sqrt(graph.tau)[:, None] * (seen + t[i] - t[j]) / unit).ravel()

    turn = Rotation.from_matrix(np.array(truth.rotations[:n])).as_rotvec()
    start = np.concatenate([turn.ravel(), truth.translations.ravel(), np.log(truth.scales[:n])])
    found = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return 2.0 * found.cost


@pytest.mark.parametrize("held", [False, True])
def test_the_optimum_is_that_of_an_independent_descent(held):
    graph, truth = ring_of_depths(7, 15, 4, np.random.default_rng(3))
    if held:
        graph = graph.with_unknown_scales(~graph.is_point & (np.arange(22) > 0))
    answer = certpgo.solve(graph)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(descended(graph, truth, held), rel=1e-7)
    assert answer.certificate.lower_bound <= answer.cost


def test_exact_depths_give_the_scales_back_up_to_one_unit(written):
    graph, truth = ring_of_depths(9, 40, 5, np.random.default_rng(1), noise=0.0)
    path = written(packed(as_rows(graph, 9)))
    answer = certpgo.solve(io.read(path, quiet=True))
    assert answer.verdict.value == "CERTIFIED"
    ratios = answer.estimate.scales[:9] / truth.scales[:9]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-9)


def test_a_held_scale_shrinks_the_others_and_the_mean_unit_does_not():
    """The more, the more noise: log scales -.024, -.185 and -1.17 at 1, 3 and 10 per cent."""
    means = {}
    for noise in (0.01, 0.03, 0.1):
        graph, truth = ring_of_depths(30, 200, 6, np.random.default_rng(0), noise=noise)
        held = graph.with_unknown_scales(~graph.is_point & (np.arange(230) > 0))
        for name, one in (("held", held), ("mean", graph)):
            answer = certpgo.solve(one)
            assert answer.verdict.value == "CERTIFIED"
            off = np.log(answer.estimate.scales / truth.scales)[:30]
            means[name, noise] = (off - off[0])[1:].mean()
        assert means["held", noise] < 0.0
        assert abs(means["mean", noise]) < 0.1
    assert means["held", 0.1] < -1.0 < 4.0 * means["held", 0.03] < 16.0 * means["held", 0.01]


def test_separate_rooms_are_refused(written):
    graph, _ = ring_of_depths(6, 12, 3, np.random.default_rng(0))
    rows = as_rows(graph, 6)
    apart = np.concatenate([rows, rows + np.array([6.0, 12.0, 0.0, 0.0, 0.0, 0.0])])
    with pytest.raises(GraphError, match="within 2 parts of the graph, but not between them"):
        certpgo.solve(io.read(written(packed(apart)), quiet=True))


def test_both_checkers_accept_a_proof_of_it(written, tmp_path, capsys):
    graph, _ = ring_of_depths(6, 14, 4, np.random.default_rng(5))
    path, stored = written(packed(as_rows(graph, 6))), str(tmp_path / "scene.npz")
    io.write(stored, io.read(path, quiet=True))
    proof = str(tmp_path / "scene.proof")
    assert main(["solve", stored, "--proof", proof]) == 0
    assert main(["check", stored, proof]) == 0
    assert main(["check", "--exact", stored, proof]) == 0
    assert "CERTIFIED" in capsys.readouterr().out


def test_the_published_scene_is_certified(dataset):
    """BAL's first scene, in XM's repository: 93 cameras, depths of different units."""
    answer = certpgo.solve(dataset("xm_BAL93"))
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(0.0482439533183, rel=1e-7)
