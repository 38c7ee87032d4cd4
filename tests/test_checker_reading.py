"""What the checker reads in a file, field by field, and what it does not take for a graph."""

import hashlib
import json
import math
import re

import numpy as np
import pytest

from certpgo import checker

CLAIM = {"keep": "all", "rotation_information": "tangent", "kappa": None, "tau": None}
#: Two edges of 3D, with information whose blocks are 2 I and 3 I.
INFORMATION = "2 0 0 0 0 0 2 0 0 0 0 2 0 0 0 3 0 0 3 0 3"
SE3 = (
    f"EDGE_SE3:QUAT 7 3 1 2 -3 0 0 0.6 0.8 {INFORMATION}\nEDGE_SE3:QUAT 3 5 4 5 6 0.5 0.5 0.5 0.5\n"
)
DSFM = "7 3 0 -1 0 1 0 0 0 0 1 0.1 0.2 0.3\n"


def read(text, component=None, **claim):
    return checker.read_graph(text.encode(), {**CLAIM, "d": 3, **claim}, component)


def turn(cosine, sine):
    """About z, in the checker's integers."""
    R = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return (R * 2.0**20).round().astype(int)


def assert_rotation(R, expected):
    """Rounded down by less than a unit each."""
    error = (expected.astype(object) << (checker.POINT - 20)) - R
    assert all(-(2 ** (checker.POINT - 20)) < x < 2 ** (checker.POINT - 20) for x in error.ravel())


def test_a_3d_edge_field_by_field():
    graph = read(SE3)
    # Ids in ascending order: 3, 5, 7.
    assert (graph.n, graph.i.tolist(), graph.j.tolist()) == (3, [2, 0], [0, 1])
    assert graph.t.tolist() == [[1.0, 2.0, -3.0], [4.0, 5.0, 6.0]]
    assert_rotation(graph.R[0], turn(0.28, 0.96))
    assert_rotation(graph.R[1], np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]) << 20)
    # About half the angle, of which half is the weight; without information 1.
    assert (graph.kappa.tolist(), graph.tau.tolist()) == ([1.5, 1.0], [2.0, 1.0])
    quaternions = read(SE3, rotation_information="quaternion")
    assert quaternions.kappa.tolist() == [0.375, 1.0]
    assert read(SE3, kappa=5.0).kappa.tolist() == [5.0, 5.0]
    assert read(SE3, kappa=5.0).tau.tolist() == [2.0, 1.0]
    assert read(SE3, tau=7).tau.tolist() == [7.0, 7.0]
    assert read(SE3, tau=7).kappa.tolist() == [1.5, 1.0]


def test_a_2d_edge_field_by_field():
    theta = 2.0 * math.atan2(3.0, 4.0)
    line = f"EDGE_SE2 4 9 1.5 -2.5 {theta!r} 4 0 0 4 0 6\n"
    graph = read(line, d=2)
    assert (graph.n, graph.i.tolist(), graph.j.tolist()) == (2, [0], [1])
    assert graph.t.tolist() == [[1.5, -2.5]]
    assert_rotation(graph.R[0], turn(0.28, 0.96)[:2, :2])
    assert (graph.kappa.tolist(), graph.tau.tolist()) == ([6.0], [4.0])
    plain = read("EDGE_SE2 4 9 1.5 -2.5 0\n", d=2)
    assert (plain.kappa.tolist(), plain.tau.tolist()) == ([1.0], [1.0])


def test_a_1dsfm_edge_field_by_field():
    graph = read(DSFM)
    assert (graph.n, graph.i.tolist(), graph.j.tolist()) == (2, [1], [0])
    assert_rotation(graph.R[0], turn(0, 1))
    assert graph.t.tolist() == [[0.0, 0.0, 0.0]]
    assert (graph.kappa.tolist(), graph.tau.tolist()) == ([1.0], [1.0])


@pytest.mark.parametrize(
    ("trace", "M"),
    [
        ("w", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ("x", [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ("y", [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("z", [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ("x", [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ("all", [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    ],
)
def test_matrices_of_quarter_and_half_turns(trace, M):
    q = checker.shepperd(tuple(float(x) for row in M for x in row))
    assert_rotation(checker.rotations(np.array([q]))[0], np.array(M) << 20)


def test_a_matrix_may_be_off_by_a_thousandth():
    near = np.eye(3)
    near[0, 0] += 0.0004
    checker.shepperd(tuple(near.ravel()))
    for far in (0.0006, -0.0006):
        wrong = np.eye(3)
        wrong[0, 0] += far
        with pytest.raises(ValueError, match="rotation"):
            checker.shepperd(tuple(wrong.ravel()))


PARALLEL = "".join(
    f"EDGE_SE2 {ends} {x} 0 0\n" for x, ends in enumerate(("0 1", "1 2", "1 0", "0 1", "2 1"))
)


@pytest.mark.parametrize(
    ("keep", "chosen"), [("all", [0, 1, 2, 3, 4]), ("first", [0, 1]), ("last", [3, 4])]
)
def test_which_of_parallel_edges_is_kept(keep, chosen):
    graph = read(PARALLEL, d=2, keep=keep)
    assert sorted(graph.t[:, 0].tolist()) == chosen
    assert graph.n == 3


def test_the_component_keeps_edges_with_both_ends_in_it():
    text = "".join(f"{k} {k + 1} 1 0 0 0 1 0 0 0 1 0 0 1\n" for k in range(5))
    graph = read(text, b"1 2\n3\t 5\n")
    assert (graph.n, graph.i.tolist(), graph.j.tolist()) == (3, [0, 1], [1, 2])
    with pytest.raises(checker.Unreadable, match="ids"):
        read(text, b"1 -2 3")
    with pytest.raises(checker.Unreadable, match="no measurements"):
        read(text, b"1 3 5")


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffEDGE_SE2 0 1 1 0 0\n",
        "EDGE_SE2 0 1 1 0 0",
        "\n\n  EDGE_SE2\t0  1 1 0 0 \t\r\nVERTEX_SE2 0 0 0 0\r\n",
        "# EDGE_SE2 5 6 1 0 0\nEDGE_SE2 0 1 1 0 0 # and so on\nFIX 0\n",
        "# \u00c0 \u00e9 \u20ac \U0001d40b\nEDGE_SE2 0 1 1 0 0 # \u00ff\n",
        "EDGE_SE2_XY 0 7 1 1 1 0 1\nEDGE_SE2 0 1 1 0 0\nLANDMARK2 3 4\nPARAMS_SE2OFFSET 0 0 0 0\n",
    ],
)
def test_what_surrounds_an_edge_does_not_count(text):
    graph = read(text, d=2)
    assert (graph.n, graph.t.tolist()) == (2, [[1.0, 0.0]])


@pytest.mark.parametrize(
    ("text", "d", "expected"),
    [
        (SE3 + DSFM, 3, "3D"),
        (SE3 + "EDGE_SE2 0 1 1 0 0\n", 3, "3D"),
        (SE3, 2, "2D"),
        ("EDGE_SE2\n", 2, "14 numbers"),
        ("EDGE_SE2 0 1 1 0 0\nnothing 1\n", 2, "line 2"),
        ("EDGE_SE2 0 1 1 0 0\n\n0 1 1 0 0\x07\n", 2, "line 3: plain"),
        ("EDGE_SE2 0 1 1 0 0\n0 1 1 0\r0\n", 2, "line 2: plain"),
        ("EDGE_SE2 0 1 1 0 \u0663\n", 2, "line 1: plain"),
        ("EDGE_SE2 3 3 1 0 0\n", 2, "node 3 is measured from itself"),
        ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0\n", 3, "9 or 30 numbers"),
        ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 nan\n", 3, "numbers"),
        ("0 1 1 0 0 0 1 0 0 0 1 0 0\n", 3, "14 numbers"),
    ],
)
def test_what_is_no_graph_of_this_kind(text, d, expected):
    with pytest.raises((checker.Unreadable, checker.Refused), match=expected):
        read(text, d=d)


def test_a_rotation_of_zero_is_refused():
    with pytest.raises(checker.Refused, match="zero"):
        read("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 0\n")


@pytest.mark.parametrize(
    ("theta", "passes"),
    [(1e6, True), (-1e6, True), (1000001.0, False), (-1000001.0, False), (math.nan, False)],
)
def test_angles_have_a_range(theta, passes):
    text = f"EDGE_SE2 0 1 0 0 {theta!r}\n"
    if passes:
        wanted = math.cos(theta / 2), math.sin(theta / 2)
        assert read(text, d=2).q[0].tolist() == pytest.approx(wanted, abs=1e-15)
    else:
        with pytest.raises(checker.Unreadable, match=r"line 1: .*(beyond|plain decimal)"):
            read(text, d=2)


@pytest.mark.parametrize("odd", [1, 3, 5, -1, -7])
def test_half_of_an_odd_smallest_double_is_too_close_to_call(odd):
    with pytest.raises(checker.Unreadable, match="too close"):
        checker.half_angles(np.array([1.0, odd * 2.0**-1074]))
    found = checker.half_angles(np.array([0.0, (odd + 1) * 2.0**-1074]))
    assert found.tolist() == [[1.0, 0.0], [1.0, (odd + 1) // 2 * 2.0**-1074]]


@pytest.mark.parametrize("name", ["kappa", "tau"])
@pytest.mark.parametrize(
    ("value", "passes"),
    [(2.0**-399, True), (2.0**399, True), (2.0**-401, False), (2.0**401, False), (0.0, False)],
)
def test_weights_have_a_range(name, value, passes):
    if passes:
        assert getattr(read(SE3, **{name: value}), name).tolist() == [value, value]
    else:
        with pytest.raises(checker.Unreadable, match=f"{name} must be"):
            read(SE3, **{name: value})


# --- Proofs

HEADER = {
    "format": "certpgo proof",
    "version": 1,
    "kind": "poses",
    "d": 3,
    "keep": "all",
    "rotation_information": "tangent",
    "kappa": None,
    "tau": 2,
    "pin": 1,
    "exponent": -3,
}


def claimed(**changes):
    text = json.dumps({**HEADER, **changes}).encode()
    return checker.read_claim({"claim": np.frombuffer(text, dtype=np.uint8)})


def test_a_header_is_taken_as_it_is():
    assert claimed() == HEADER
    for change in (
        {"kind": "rotations"},
        {"d": 2},
        {"d": 2, "rotation_information": "rpy"},
        {"keep": "first"},
        {"keep": "last"},
        {"rotation_information": "quaternion"},
        {"rotation_information": "rpy"},
        {"kappa": 0.5, "tau": None},
    ):
        assert claimed(**change) == {**HEADER, **change}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"format": "proof"}, "version 1"),
        ({"version": 2}, "version 1"),
        ({"version": 1.0}, "integers"),
        ({"d": 3.0}, "integers"),
        ({"pin": None}, "integers"),
        ({"exponent": True}, "integers"),
        ({"kind": "points"}, "kind must be one of"),
        ({"d": 4}, "d must be one of"),
        ({"keep": "none"}, "keep must be one of"),
        ({"rotation_information": "angle"}, "rotation_information must be one of"),
        ({"d": 2, "rotation_information": "quaternion"}, "in the plane"),
        ({"kappa": "1"}, "kappa must be a number"),
        ({"tau": True}, "tau must be a number"),
    ],
    ids=str,
)
def test_no_other_header_is_taken(change, expected):
    with pytest.raises(checker.Unreadable, match=expected):
        claimed(**change)


def arrays(d, poses, n=3):
    b = d + poses
    archive = {
        "rotations": np.ones((n, 4 if d == 3 else 2)),
        "multipliers": np.arange(n * d * (d + 1) / 2).reshape(n, -1),
        "order": np.array([2, 0, 1], dtype="<i4"),
        "delta": np.ones(n * b, dtype="<f4"),
    }
    return archive | ({"translations": np.ones((n, d))} if poses else {})


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("poses", [True, False])
def test_arrays_of_a_proof(d, poses):
    claim = {**HEADER, "d": d, "kind": "poses" if poses else "rotations"}
    archive = arrays(d, poses)
    proof = checker.read_proof(archive, claim, 3)
    assert (proof.t is not None) == poses
    assert (proof.pin, proof.exponent) == (1, -3)
    assert np.array_equal(proof.multipliers, archive["multipliers"])
    assert (proof.order.dtype, proof.delta.dtype) == (np.intp, np.float64)
    for name, array in archive.items():
        for wrong in (array[:-1], array.astype("<i8"), np.stack([array, array])):
            with pytest.raises(checker.Refused, match=name):
                checker.read_proof({**archive, name: wrong}, claim, 3)
        if name != "order":
            broken = array.copy()
            broken.flat[1] = np.nan
            with pytest.raises(checker.Refused, match=f"{name} holds"):
                checker.read_proof({**archive, name: broken}, claim, 3)
    for order in ([0, 0, 1], [1, 2, 3], [-1, 0, 1]):
        with pytest.raises(checker.Refused, match="permutation"):
            checker.read_proof({**archive, "order": np.array(order, dtype="<i4")}, claim, 3)
    for pin, exponent in ((0, 300), (2, -300)):
        checker.read_proof(archive, {**claim, "pin": pin, "exponent": exponent}, 3)
    for pin, exponent in ((-1, 0), (3, 0), (0, 301), (0, -301)):
        with pytest.raises(checker.Refused, match="range"):
            checker.read_proof(archive, {**claim, "pin": pin, "exponent": exponent}, 3)


def test_files_that_are_not_there_are_named(tmp_path):
    graph = tmp_path / "graph.g2o"
    with pytest.raises(checker.Unreadable, match=re.escape(str(graph))):
        checker.check(graph, tmp_path / "nothing.cert")
    with pytest.raises(checker.Unreadable, match=re.escape(str(tmp_path / "EGs.txt"))):
        checker.check(tmp_path, tmp_path / "nothing.cert")
    graph.write_text(SE3)
    with pytest.raises(checker.Unreadable, match=r"nothing\.cert: no such file"):
        checker.check(graph, tmp_path / "nothing.cert")


def test_a_line_that_cannot_be_read_is_named_with_its_file(tmp_path):
    graph, proof = tmp_path / "graph.g2o", tmp_path / "graph.cert"
    graph.write_text("EDGE_SE3:QUAT 1 2 3\n")
    sha = hashlib.sha256(graph.read_bytes()).hexdigest()
    text = json.dumps({**HEADER, "graph_sha256": sha, "component_sha256": None}).encode()
    with proof.open("wb") as file:
        np.savez(file, claim=np.frombuffer(text, dtype=np.uint8))
    with pytest.raises(checker.Unreadable, match=r"graph\.g2o: line 1: a measurement of"):
        checker.check(graph, proof)
    proof.write_bytes(b"nothing")
    with pytest.raises(checker.Unreadable, match=r"graph\.cert: not a readable proof"):
        checker.check(graph, proof)


def test_what_was_proven_about_is_said():
    graph = read(SE3)
    claim = {**HEADER, "component_sha256": None}
    said = "chordal cost F, the poses of 3 nodes from 2 measurements, "
    said += "kappa of the file (1 without information), tau 2, "
    said += "rotational information read as tangent, parallel edges added"
    assert checker._about(graph, claim) == said
    of_rotations = {**claim, "kind": "rotations", "kappa": 0.5, "component_sha256": "0"}
    said = "chordal cost F, the rotations of 3 nodes from 2 measurements, kappa 0.5, "
    said += "rotational information read as tangent, parallel edges added, nodes of cc.txt alone"
    assert checker._about(graph, of_rotations) == said


def test_the_component_is_the_file_that_was_proven_about(tmp_path):
    def sha(data):
        return hashlib.sha256(data).hexdigest()

    path, text, ids = tmp_path / "EGs.txt", b"edges", b"1 2 3"
    claim = {"graph_sha256": sha(text), "component_sha256": None}
    assert checker._component(path, text, claim) is None
    with pytest.raises(checker.Refused, match=r"EGs.txt is not the file"):
        checker._component(path, b"other edges", claim)
    claim["component_sha256"] = sha(ids)
    with pytest.raises(checker.Unreadable, match=r"cc.txt beside"):
        checker._component(path, text, claim)
    (tmp_path / "cc.txt").write_bytes(ids)
    assert checker._component(path, text, claim) == ids
    (tmp_path / "cc.txt").write_bytes(ids + b" 4")
    with pytest.raises(checker.Refused, match=r"cc.txt is not the file"):
        checker._component(path, text, claim)


@pytest.mark.parametrize("arguments", [[], ["graph"], ["graph", "proof", "more"]])
def test_other_than_two_arguments_are_answered_by_how_to_use_it(arguments, capsys):
    assert checker.main(arguments) == 2
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "usage: checker.py GRAPH PROOF\n")
