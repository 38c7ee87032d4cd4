"""What a reader makes of ids, vertices, comments, options and notices."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy import io as matlab
from scipy import sparse

from certpgo import io
from certpgo.errors import InputNotice
from certpgo.graph import Graph
from certpgo.graph.components import connected_parts
from certpgo.io.format import formats
from certpgo.io.formats import g2o
from certpgo.linalg import rotations as so

UNIT = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"


def test_formats_are_the_files_of_their_folder():
    stems = {path.stem for path in Path(g2o.__file__).parent.glob("[!_]*.py")}
    assert len(formats()) == len(stems)
    assert {"g2o", "toro", "isam", "1dsfm", "npz", "tum", "kitti"} <= set(formats())


def test_ids_are_arbitrary_and_sorted(file):
    instance = io.read(
        file(
            "EDGE_SE2 70 -4 1 0 0 1 0 0 1 0 1\n"
            "EDGE_SE2 -4 9223372036854775807 1 0 0 1 0 0 1 0 1\n"
            "VERTEX_SE2 70 1 2 0\nVERTEX_SE2 -4 3 4 0\nVERTEX_SE2 9223372036854775807 5 6 0\n"
            "FIX 70\n"
        )
    )
    assert instance.ids.tolist() == [-4, 70, 2**63 - 1]
    assert instance.graph.edges.tolist() == [[1, 0], [0, 2]]
    assert instance.initial.translations.tolist() == [[3, 4], [1, 2], [5, 6]]
    assert instance.fixed == (1,)
    assert instance.name == "graph"


def test_edges_keep_their_order_and_direction(file):
    instance = io.read(
        file("EDGE_SE2 2 1 5 6 0.5 1 0 0 1 0 1\nEDGE_SE2 0 1 7 8 -0.5 1 0 0 1 0 1\n")
    )
    assert instance.graph.edges.tolist() == [[2, 1], [0, 1]]
    assert instance.graph.translations.tolist() == [[5, 6], [7, 8]]
    expected = so.exp(np.array([[0.5], [-0.5]]))
    np.testing.assert_allclose(instance.graph.rotations, expected, rtol=0, atol=1e-15)


def test_comments_blank_lines_carriage_returns_and_a_missing_last_newline(file):
    path = file(
        "# a map\r\n\r\n  EDGE_SE2\t0 1 1 0 0 1 0 0 1 0 1 # the first\r\n\n"
        "EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1"
    )
    assert io.read(path).graph.num_edges == 2


def test_isolated_vertices_stay(file):
    lines = "".join(f"VERTEX_SE2 {k} 0 0 0\n" for k in range(4))
    instance = io.read(file(lines + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"))
    assert instance.graph.num_nodes == 4
    assert sorted(instance.graph.component_sizes) == [1, 1, 2]


def test_zero_translations_make_a_rotation_graph(file):
    path = file(f"VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\nEDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 {UNIT}\n")
    instance = io.read(path, quiet=True)
    assert not instance.graph.has_positions
    assert any("rotation graph" in notice for notice in instance.notices)


@pytest.mark.parametrize(
    ("text", "notice"),
    [
        (
            "EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 2 1 0 0\n",
            "2 edges without information: kappa = tau = 1",
        ),
        ("EDGE_SE2 0 1 1 0 0 1 0 9 1 0 1\n", "1 edge with information indefinite"),
        (f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1.1 {UNIT}\n", "1 quaternion off norm 1"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", "1 node without a vertex"),
        (
            "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 0 9 1 2 1 0 1\n",
            "1 point, 1 sighting",
        ),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1\n", "1 prior,"),
    ],
)
def test_notices_are_collected_and_warned(file, text, notice):
    path = file(text)
    with pytest.warns(InputNotice, match=notice) as record:
        instance = io.read(path)
    assert record[0].filename == __file__
    assert any(notice in said for said in instance.notices)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert io.read(path, quiet=True).notices == instance.notices


def test_landmarks_can_be_skipped(file):
    path = file("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nVERTEX_XY 9 1 2\nEDGE_SE2_XY 0 9 1 2 1 0 1\n")
    instance = io.read(path, quiet=True, landmarks=False)
    assert instance.ids.tolist() == [0, 1]
    assert len(instance.notices) == 2


def test_information_may_be_missing_on_some_edges(file):
    path = file("EDGE_SE2 0 1 1 0 0 5 0 0 5 0 7\nEDGE_SE2 1 2 1 0 0\n")
    graph = io.read(path, quiet=True).graph
    assert graph.kappa.tolist() == [7, 1]
    assert graph.tau.tolist() == [5, 1]


PARALLEL = (
    "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 2\nEDGE_SE2 1 0 2 0 0 1 0 0 1 0 3\n"
    "EDGE_SE2 1 2 3 0 0 1 0 0 1 0 4\n"
)


@pytest.mark.parametrize(
    ("keep", "kappa"), [("all", [2, 3, 4]), ("first", [2, 4]), ("last", [3, 4])]
)
def test_keep_chooses_among_parallel_edges(file, keep, kappa):
    instance = io.read(file(PARALLEL), keep=keep)
    assert instance.graph.kappa.tolist() == kappa
    assert instance.options["keep"] == keep


@pytest.mark.parametrize(
    ("options", "weights", "kappa", "tau"),
    [
        ({}, "file", [2, 3, 4], [1, 1, 1]),
        ({"unit_weights": True}, "unit", [1, 1, 1], [1, 1, 1]),
        ({"kappa": 7, "tau": 0.5}, "kappa=7.0,tau=0.5", [7, 7, 7], [0.5, 0.5, 0.5]),
        ({"tau": 9.0}, "kappa=file,tau=9.0", [2, 3, 4], [9, 9, 9]),
    ],
)
def test_weights_can_be_overridden(file, options, weights, kappa, tau):
    instance = io.read(file(PARALLEL), **options)
    assert instance.options["weights"] == weights
    assert instance.graph.kappa.tolist() == kappa
    assert instance.graph.tau.tolist() == tau


@pytest.mark.parametrize(
    ("about", "kappa"), [(None, 8.0), ("tangent", 8.0), ("rpy", 8.0), ("quaternion", 2.0)]
)
def test_rotational_information_has_three_meanings(file, about, kappa):
    information = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 16 0 0 16 0 16"
    path = file(f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {information}\n")
    instance = io.read(path, rotation_information=about)
    assert instance.graph.kappa.tolist() == [kappa]
    assert instance.options["rotation_information"] == (about or "tangent")


def test_toro_has_its_own_order_of_information(file):
    path = file("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 1 0 4 9 0 0\n", "old.txt")
    graph = io.read(path).graph
    assert (graph.kappa[0], graph.tau[0]) == (9.0, 1.6)


def test_isam_and_toro_are_told_apart(file):
    edge = "EDGE2 0 1 1 0 0 1 0 0 1 0 9\n"
    assert io.read(file(edge, "a.txt")).options["rotation_information"] == "rpy"
    toro = io.read(file("EDGE2 0 1 1 0 0 1 0 1 9 0 0\n", "a.graph"))
    assert toro.options["rotation_information"] == "tangent"
    assert toro.graph.kappa[0] == 9.0


def test_progress_counts_the_bytes(monkeypatch, file):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 50)
    path = file(PARALLEL)
    told = []
    io.read(path, progress=lambda done, total: told.append((done, total)))
    size = path.stat().st_size
    assert told == [(53, size), (size, size)]  # the first three are tried as a mark of UTF-8


@pytest.mark.parametrize("name", ["a.g2o", "a.txt"])
def test_a_byte_order_mark_is_passed_over(tmp_path, name):
    path = tmp_path / name
    lines = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    path.write_text(lines if name == "a.g2o" else "0 1 2 3 0 0 0 1\n", encoding="utf-8-sig")
    if name == "a.g2o":
        assert io.read(path).graph.num_edges == 1
    assert io.read_estimate(path).num_nodes == (2 if name == "a.g2o" else 1)


def test_chunks_change_nothing(monkeypatch, file):
    lines = "".join(f"EDGE_SE2 {k} {k + 1} {k} 0 0.1 1 0 0 1 0 {k + 1}\n" for k in range(200))
    whole = io.read(file(lines)).graph
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 37)
    pieces = io.read(file(lines)).graph
    np.testing.assert_array_equal(whole.edges, pieces.edges)
    np.testing.assert_array_equal(whole.kappa, pieces.kappa)
    np.testing.assert_array_equal(whole.translations, pieces.translations)


@pytest.fixture
def scene(file, tmp_path):
    """A 1DSfM scene of three cameras beside one more, with its world-to-camera rotations."""
    W = so.random(np.random.default_rng(3), 5, 3)
    ids = [4, 9, 11, 30, 31]
    lines = []
    for i, j in [(0, 1), (1, 2), (2, 0), (3, 4)]:
        row = (W[i] @ W[j].T).ravel().tolist()
        lines.append(f"{ids[i]} {ids[j]} {' '.join(map(repr, row))} 0 0 1\n")
    file("".join(lines), "scene/EGs.txt")
    file("4\n9\n11\n", "scene/cc.txt")
    return tmp_path / "scene", W


def rots(W, ids):
    rows = (" ".join(map(repr, w.ravel().tolist())) for w in W)
    return "".join(f"{k} {row}\n" for k, row in zip(ids, rows, strict=True))


def test_1dsfm_measures_from_world_to_camera(scene, file):
    folder, W = scene
    file(rots(W[:3], [4, 9, 11]), "scene/gt_rots.txt")
    for path in (folder, folder / "EGs.txt"):
        instance = io.read(path, quiet=True)
        assert instance.name == "scene"
        assert instance.ids.tolist() == [4, 9, 11]
        assert "1 edge outside the component of cc.txt ignored" in instance.notices
        R = instance.truth.rotations
        np.testing.assert_allclose(R, np.swapaxes(W[:3], 1, 2), rtol=0, atol=1e-14)
        i, j = instance.graph.edges.T
        measured = instance.graph.rotations
        np.testing.assert_allclose(R[i] @ measured, R[j], rtol=0, atol=1e-14)


def test_1dsfm_truth_that_is_partial_is_only_noticed(scene, file):
    folder, W = scene
    path = file(rots(W[1:3], [9, 11]), "scene/rots.txt")
    instance = io.read(folder, quiet=True)
    assert instance.truth is None
    assert (
        "truth for 2 of 3 nodes in rots.txt: certpgo.io.read_truth reads them" in instance.notices
    )
    nodes, truth = io.read_truth(path, instance)
    assert nodes.tolist() == [1, 2]
    np.testing.assert_allclose(truth.rotations, np.swapaxes(W[1:3], 1, 2), rtol=0, atol=1e-14)


def test_bundler_cameras_look_along_their_negative_z(scene, file):
    folder, W = scene
    D = np.diag([1.0, -1.0, -1.0])
    t = np.arange(36.0).reshape(12, 3)
    cameras = []
    for k in range(12):
        known = {4: 0, 9: 1, 11: 2}.get(k)
        focal, R = (0, np.zeros((3, 3))) if known is None else (1, D @ W[known])
        rows = [[focal, 0, 0], *R.tolist(), t[k].tolist()]
        cameras += [" ".join(map(repr, row)) + "\n" for row in rows]
    path = file("# Bundle file v0.3\n12 0\n" + "".join(cameras), "scene/gt_bundle.out")
    instance = io.read(folder, quiet=True)
    expected = np.swapaxes(W[:3], 1, 2)
    np.testing.assert_allclose(instance.truth.rotations, expected, rtol=0, atol=1e-14)
    poses = io.read_estimate(path)
    np.testing.assert_allclose(poses.rotations, expected, rtol=0, atol=1e-14)
    centre = -np.einsum("nij,nj->ni", expected, t[[4, 9, 11]] @ D)
    np.testing.assert_allclose(poses.translations, centre, rtol=0, atol=1e-13)


def test_truth_from_noise_free_relative_poses(file):
    # A square walked anticlockwise, closed by a last edge.
    step = "1 0 1.5707963267948966"
    graph = file("".join(f"EDGE_SE2 {10 * k} {10 * ((k + 1) % 4)} {step}\n" for k in range(4)))
    truth = file(
        "".join(f"EDGE2 {10 * k} {10 * ((k + 1) % 4)} {step}\n" for k in range(4)), "t.txt"
    )
    instance = io.read(graph, truth=truth, quiet=True)
    corners = [[0, 0], [1, 0], [1, 1], [0, 1]]
    np.testing.assert_allclose(instance.truth.translations, corners, rtol=0, atol=1e-15)


def test_viewing_graphs_are_topology_alone(tmp_path):
    A = np.zeros((5, 5))
    A[[0, 1, 3], [1, 2, 0]] = 1
    path = tmp_path / "scene.mat"
    matlab.savemat(path, {"A": sparse.csc_matrix(A + A.T)})
    instance = io.read(path, quiet=True)
    assert instance.graph.num_nodes == 5
    assert instance.graph.edges.tolist() == [[0, 1], [0, 3], [1, 2]]
    np.testing.assert_array_equal(instance.graph.rotations, np.tile(np.eye(3), (3, 1, 1)))


def test_a_graph_with_translations_is_a_pose_graph(file):
    assert isinstance(io.read(file(PARALLEL)).graph, Graph)


@pytest.mark.parametrize("size", [1 << 20, 30])
def test_edges_are_in_the_order_of_the_file_whatever_their_tags(monkeypatch, file, size):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", size)
    lines = ("EDGE2 0 1 1 0 0", "ODOMETRY 1 2 2 0 0", "EDGE2 1 2 3 0 0", "ODOMETRY 0 1 4 0 0")
    path = file("\n".join(lines), "mixed.txt")
    assert io.read(path, quiet=True).graph.translations[:, 0].tolist() == [1, 2, 3, 4]
    assert io.read(path, keep="last", quiet=True).graph.translations[:, 0].tolist() == [3, 4]


def test_measurements_keep_their_numbers_in_the_file_whatever_is_left_out(tmp_path):
    path = tmp_path / "parts.g2o"
    ends = [(7, 8), (0, 1), (1, 2), (0, 1), (2, 3), (3, 0), (1, 2)]
    fixed = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in (0, 1, 2, 3, 7, 8)) + "FIX 1 2\n"
    lines = "".join(f"EDGE_SE2 {i} {j} {j - i} 0 0 1 0 0 1 0 1\n" for i, j in ends)
    path.write_text(fixed + lines)
    for options in ({}, {"keep": "last"}, {"fixed": False}, {"fixed": False, "keep": "first"}):
        instance = io.read(path, quiet=True, **options)
        for part in (instance, *connected_parts(instance, "each")):
            for number, pair in zip(part.known_numbers, part.pairs, strict=True):
                assert number == -1 or tuple(pair) == ends[number]
    held = io.read(path, quiet=True)
    assert held.known_numbers.tolist() == [0, 1, 3, 4, 5, -1]
