"""COLMAP's images.txt and GLOMAP's rotation averager: conventions, names and ids, malformed files.

The frames are checked against what the files' definitions say: x_cam = R x_world + t.
"""

import struct
from contextlib import suppress

import numpy as np
import pytest
from strategies import rotation_graph

from certpgo import certify, io
from certpgo.certify import Verdict
from certpgo.errors import FormatError, GraphError, InputNotice
from certpgo.graph import Instance
from certpgo.io.exact.quaternion import to_write
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic

HEADER = "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, ...\n"
LINE = "{id} 1 0 0 0 0 0 0 1 {name}\n"


def wxyz(R):
    return [" ".join(map(repr, q[[3, 0, 1, 2]].tolist())) for q in to_write(R)]


def cameras(n, seed=0):
    """World-to-camera rotations and translations, and the centres they belong to."""
    rng = np.random.default_rng(seed)
    R, centres = so.random(rng, n, 3), rng.standard_normal((n, 3))
    return R, -np.einsum("nab,nb->na", R, centres), centres


def images_text(R, t, ids, names, points="\n"):
    lines = (
        f"{k} {q} {' '.join(map(repr, s.tolist()))} 1 {name}\n{points}"
        for k, q, s, name in zip(ids, wxyz(R), t, names, strict=True)
    )
    return HEADER + "".join(lines)


def graph_with_ids(ids, names=()):
    graph, _ = rotation_graph(np.random.default_rng(1), len(ids), 3)
    return Instance("scene", graph, np.array(ids), names=tuple(names))


@pytest.mark.parametrize("points", ["\n", "1.5 2.5 -1 3 4 17\n"])
def test_images_are_camera_to_world_poses_in_the_order_of_their_ids(file, points):
    R, t, centres = cameras(3)
    names = ["b c.png", "a.png", "c.png"]
    path = file(images_text(R, t, [7, 3, 5], names, points), "images.txt")
    found = io.read_estimate(path)
    order = [1, 2, 0]
    assert np.abs(found.rotations - np.swapaxes(R, 1, 2)[order]).max() < 1e-14
    assert np.abs(found.translations - centres[order]).max() < 1e-14


def test_the_last_line_of_points_may_be_missing_and_the_header_too(file):
    R, t, _ = cameras(2)
    text = images_text(R, t, [0, 1], ["a.png", "b.png"]).removeprefix(HEADER).rstrip("\n")
    assert io.read_estimate(file(text, "poses.txt")).num_nodes == 2


def test_numbers_in_names_are_taken_where_image_ids_do_not_fit_and_this_is_said(file):
    R, t, _ = cameras(3)
    names = ["left/0012.png", "frame_10.jpg", "0011.png"]
    path = file(images_text(R, t, [1, 2, 3], names), "images.txt")
    with pytest.warns(InputNotice, match="numbers in image names are used"):
        found = io.read_estimate(path, graph_with_ids([10, 11, 12]))
    assert np.abs(found.rotations - np.swapaxes(R, 1, 2)[[1, 2, 0]]).max() < 1e-14


def test_two_ways_to_match_are_said(file):
    R, t, _ = cameras(3)
    path = file(images_text(R, t, [1, 2, 3], ["3.png", "2.png", "1.png"]), "images.txt")
    with pytest.warns(InputNotice, match="fit as well"):
        found = io.read_estimate(path, graph_with_ids([1, 2, 3]))
    assert np.abs(found.rotations - np.swapaxes(R, 1, 2)).max() < 1e-14


def test_the_graphs_own_names_come_first(file):
    R, t, _ = cameras(3)
    path = file(images_text(R, t, [1, 2, 3], ["z.png", "x.png", "y.png"]), "images.txt")
    found = io.read_estimate(path, graph_with_ids([1, 2, 3], ["x.png", "y.png", "z.png"]))
    assert np.abs(found.rotations - np.swapaxes(R, 1, 2)[[1, 2, 0]]).max() < 1e-14
    with pytest.raises(FormatError, match=r"z.png is not in the graph \(1 of 3 are not\)"):
        io.read_estimate(path, graph_with_ids([1, 2, 3], ["x.png", "y.png", "w.png"]))


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        (LINE.format(id=1, name=""), 3, "CAMERA_ID NAME"),
        (LINE.format(id="one", name="a.png"), 3, "CAMERA_ID NAME"),
        (LINE.format(id=1, name="a.png").replace("1 1", "1 nan"), 3, "CAMERA_ID NAME"),
        (LINE.format(id=1, name="a.png").replace("1 1", "1 0"), 3, "not zero"),
        (LINE.format(id=1, name="a.png") + LINE.format(id=2, name="b.png"), 4, "POINT3D_ID"),
        (LINE.format(id=1, name="a b c.png") * 2, 4, "POINT3D_ID"),
        (LINE.format(id=1, name="a.png") + "1 2\n", 4, "POINT3D_ID"),
        ((LINE.format(id=1, name="a.png") + "\n") * 2, 5, "image 1 appears twice"),
        (LINE.format(id=2**70, name="a.png"), 3, "64-bit"),
        ("\n", None, "no images (IMAGE_ID"),
    ],
)
def test_malformed_images(file, text, line, expected):
    path = file(HEADER + text, "images.txt")
    with pytest.raises(FormatError) as caught:
        io.read_estimate(path)
    assert expected in str(caught.value)
    assert caught.value.line == line
    assert "\n" not in str(caught.value)


def relative_text(R, edges, names):
    pose = (R[j] @ R[i].T for i, j in edges)  # 2R1 of world-to-camera rotations
    return "".join(
        f"{names[i]} {names[j]} {q} 0 0 1\n"
        for (i, j), q in zip(edges, wxyz(np.array(list(pose))), strict=True)
    )


@pytest.mark.parametrize("named", ["img_{}.png", "{}/img.png"])
def test_glomap_in_and_out(file, named):
    # Global rotations that fit the relative ones exactly cost nothing: the frames agree.
    R, _, _ = cameras(5)
    names = [named.format(k) for k in (4, 0, 3, 1, 2)]
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2)]
    instance = io.read(file(relative_text(R, edges, names), "relpose.txt"), quiet=True)
    assert (instance.graph.num_nodes, instance.graph.num_edges) == (5, 6)
    assert (instance.graph.kappa == 1.0).all()
    lines = [f"{name} {q}\n" for name, q in zip(names, wxyz(R), strict=True)]
    path = file("".join(reversed(lines)), "rotations.txt")
    estimate = io.read_estimate(path, instance)
    problem = Quadratic(instance.graph)
    assert problem.cost(estimate) < 1e-25
    certificate = certify(problem, estimate)
    assert certificate.verdict is Verdict.CERTIFIED
    # Other names, other ids: matched with this file's names alone, the order tells.
    k = names.index(named.format(3))
    assert np.abs(estimate.rotations[3] - R[k].T).max() < 1e-14
    again = file("", "graph.npz")
    io.write(again, instance)
    assert io.read(again, quiet=True).names == instance.names


def test_glomap_rotations_for_a_graph_without_names(file):
    R, _, _ = cameras(3)
    lines = [f"f{k}.png {q}\n" for k, q in zip((5, 3, 4), wxyz(R), strict=True)]
    path = file("".join(lines), "rotations.txt")
    with pytest.warns(InputNotice, match="numbers in names"):
        found = io.read_estimate(path, graph_with_ids([3, 4, 5]))
    assert np.abs(found.rotations - np.swapaxes(R, 1, 2)[[1, 2, 0]]).max() < 1e-14
    path = file("".join(line.replace("f", "g1/f") for line in lines[:2]), "rotations.txt")
    with pytest.raises(FormatError, match="lacks node 4"):
        io.read_estimate(path, graph_with_ids([3, 4, 5]))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.png b.png 1 0 0 0 0 0 1\na.png c.png 1 0 0 0 0 0\n", ":2: NAME_1 NAME_2"),
        ("a.png b.png 1 0 0 0 0 0 1\na.png a.png 1 0 0 0 0 0 1\n", ":2: an image is measured from"),
        ("a.png b.png 0 0 0 0 0 0 1\n", ":1: a quaternion must not be zero"),
        ("a.png b.png 1 0 inf 0 0 0 1\n", ":1: NAME_1 NAME_2"),
    ],
)
def test_malformed_relative_poses(file, text, expected):
    with pytest.raises(FormatError) as caught:
        io.read(file(text, "relpose.txt"))
    assert expected in str(caught.value)


def test_malformed_global_rotations(file):
    instance = graph_with_ids([0, 1])
    twice = file("a.png 1 0 0 0\na.png 1 0 0 0\n", "rotations.txt")
    with pytest.raises(FormatError, match=r"image a.png appears twice"):
        io.read_estimate(twice, instance)
    nameless = file("a.png 1 0 0 0\nb.png 1 0 0 0\n", "rotations.txt")
    with pytest.raises(FormatError, match="no distinct numbers"):
        io.read_estimate(nameless, instance)


def test_names_are_one_a_node():
    graph, _ = rotation_graph(np.random.default_rng(1), 3, 3)
    with pytest.raises(GraphError, match="3 distinct strings"):
        Instance("scene", graph, np.arange(3), names=("a", "b", "a"))


def images_binary(R, t, ids, names, points=0):
    q = to_write(R)[:, [3, 0, 1, 2]]
    out = struct.pack("<Q", len(ids))
    for k, turn, step, name in zip(ids, q, t, names, strict=True):
        out += struct.pack("<I7dI", k, *turn, *step, 1) + name.encode() + b"\0"
        out += struct.pack("<Q", points) + struct.pack("<ddq", 1.5, 2.5, -1) * points
    return out


def test_models_are_read_from_their_folder_and_from_their_binary(tmp_path):
    R, t, centres = cameras(3)
    ids, names = [7, 3, 5], ["b.png", "a/\u00e9.png", "c.png"]
    (tmp_path / "images.txt").write_text(images_text(R, t, ids, names))
    text = io.read_estimate(tmp_path)
    (tmp_path / "images.bin").write_bytes(images_binary(R, t, ids, names, points=2))
    for path in (tmp_path, tmp_path / "images.bin"):
        found = io.read_estimate(path)
        assert found.keys.ids.tolist() == [3, 5, 7]
        assert found.keys.names == ("a/\u00e9.png", "c.png", "b.png")
        np.testing.assert_array_equal(found.rotations, text.rotations)
        np.testing.assert_allclose(found.translations, centres[[1, 2, 0]], atol=1e-12)


def test_damaged_binaries(tmp_path):
    R, t, _ = cameras(2)
    whole = images_binary(R, t, [1, 2], ["a.png", "b.png"], points=1)
    path = tmp_path / "images.bin"
    wrong = [
        (whole[:-1], "ends early"),
        (whole + b"x", "nothing after them"),
        (struct.pack("<Q", 2**63), "ends early"),
        (struct.pack("<Q", 0), "no images"),
        (images_binary(R, t, [1, 1], ["a", "b"]), "image 1 appears twice"),
        (images_binary(R, np.full((2, 3), np.nan), [1, 2], ["a", "b"]), "QW QX"),
    ]
    for content, said in wrong:
        path.write_bytes(content)
        with pytest.raises(FormatError, match=said):
            io.read_estimate(path)
    rng = np.random.default_rng(2)
    for _ in range(200):
        damaged = bytearray(whole)
        damaged[rng.integers(0, len(damaged))] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        with suppress(FormatError):
            io.read_estimate(path)
