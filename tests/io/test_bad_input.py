"""Every unusable file is one line: path, line number, what was expected."""

from pathlib import Path

import numpy as np
import pytest

from certpgo import io
from certpgo.errors import CertPGOError, FormatError, InputError, InputNotice, SpecError

BAD = Path(__file__).parent.parent / "data" / "bad"

MALFORMED = [
    ("empty.g2o", None, "empty"),
    ("too_few.g2o", 2, "2 ids and 7 numbers"),
    ("too_many.g2o", 2, "31 values found"),
    ("short_information.g2o", 4, "21 or no information numbers; 16 values found"),
    ("long_vertex.g2o", 2, "1 id and 3 numbers; 5 values found"),
    ("letters.g2o", 2, "numbers expected after the ids, not '"),
    ("underscore.g2o", 2, "numbers expected"),
    ("letters_information.g2o", 2, "decimal numbers"),
    ("nan.g2o", 2, "finite"),
    ("overflow.g2o", 2, "finite"),
    ("inf_information.g2o", 2, "decimal numbers"),
    ("exponent.g2o", 2, "out of range"),
    ("zero_quaternion.g2o", 2, "must not be zero"),
    ("self_loop.g2o", 2, "node 1 is measured from itself"),
    ("negative_information.g2o", 2, "not positive definite"),
    ("indefinite_block.g2o", 2, "translation block"),
    ("zero_information.g2o", 2, "nothing is measured"),
    ("duplicate_vertex.g2o", 3, "node 5 appears twice"),
    ("letter_id.g2o", 2, "ids must be integers"),
    ("fractional_id.g2o", 2, "ids must be integers"),
    ("huge_id.g2o", 3, "64-bit"),
    ("mixed.g2o", 2, "3D poses"),
    ("unknown_tag.g2o", 2, "EDGE_SIM3"),
    ("huge_angle.g2o", 1, "radians"),
    ("unknown_fix.g2o", None, "FIX 7"),
    ("no_edges.g2o", None, "an estimate, not a graph"),
    ("mixed_isam.txt", 2, "2D poses"),
    ("old_isam.txt", 1, "older EDGE lines"),
    ("short_vertex.graph", 2, "1 id and 3 numbers"),
    ("no_rotation.txt", 2, "rotation matrix"),
    ("loop_egs.txt", 2, "node 3 is measured from itself"),
    ("short_egs.txt", 2, "9 numbers of R_ij"),
    ("trajectory.tum", None, "no measurements"),
    ("markup.xml", None, "no known format"),
    ("picture.png", None, "no known format"),
    ("picture.g2o", None, "no known format"),
    ("truncated.mat", None, "MATLAB"),
    ("truncated.npz", None, "NumPy arrays"),
    ("absent.g2o", None, "no such file"),
    (".", None, "EGs.txt"),
]


@pytest.mark.parametrize(("name", "line", "expected"), MALFORMED)
def test_malformed_graphs(name, line, expected):
    with pytest.raises(FormatError) as caught:
        io.read(BAD / name)
    message = str(caught.value)
    assert caught.value.line == line
    assert message.startswith(str(BAD / name) + (f":{line}: " if line else ": "))
    assert expected in message
    assert "\n" not in message


def test_every_bad_file_is_tested():
    assert {path.name for path in BAD.iterdir()} <= {name for name, _, _ in MALFORMED}


def test_lines_are_counted_across_chunks(monkeypatch, file):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 64)
    good = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0\n" for k in range(50))
    path = file(good + "EDGE_SE2 3 4 1 0\n" + good)
    with pytest.raises(FormatError) as caught:
        io.read(path, quiet=True)
    assert caught.value.line == 51


def test_dimensions_must_agree_across_chunks(monkeypatch, file):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 64)
    path = file("EDGE_SE2 0 1 1 0 0\n" * 10 + "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n")
    with pytest.raises(FormatError, match="11: VERTEX_SE3:QUAT in a file of 2D poses"):
        io.read(path, quiet=True)


def test_unit_weights_ignore_bad_information():
    graph = io.read(BAD / "negative_information.g2o", unit_weights=True).graph
    np.testing.assert_array_equal(graph.kappa, 1.0)
    graph = io.read(BAD / "zero_information.g2o", kappa=2.0, tau=3.0).graph
    assert (graph.kappa[0], graph.tau[0]) == (2.0, 3.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kappa": 0.0}, "kappa must be positive"),
        ({"tau": np.nan}, "tau must be positive"),
        ({"kappa": 1.0, "unit_weights": True}, "exclude"),
        ({"keep": "best"}, "keep must be one of"),
        ({"rotation_information": "axis"}, "rotation_information must be one of"),
        ({"rotation_information": "quaternion"}, "is for 3D"),
    ],
)
def test_contradictory_options(file, options, message):
    path = file("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(InputError, match=message):
        io.read(path, **options)


def test_unknown_format_is_named_with_its_neighbours(file):
    path = file("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(SpecError, match="g2o"):
        io.read(path, format="g20")


def test_a_named_format_overrules_the_content(file):
    path = file("EDGE2 0 1 1 0 0 1 0 4 9 0 0\n", "ambiguous.txt")
    assert io.read(path, format="toro").graph.kappa[0] == 9.0


GRAPH = "EDGE_SE2 3 5 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 9 1 0 0 1 0 0 1 0 1\n"


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("VERTEX_SE2 3 0 0 0\n", "a.g2o", "lacks node 5 (2 of the graph's 3 nodes)"),
        (
            "".join(f"VERTEX_SE2 {k} 0 0 0\n" for k in (3, 5, 9, 10, 11)),
            "a.g2o",
            "node 10 is not in the graph (2 of 5 are not)",
        ),
        ("3 0 0 0 0 0 0 1\n5 0 0 0 0 0 0 1\n", "a.tum", "lacks node 9"),
        ("3.5 0 0 0 0 0 0 1\n", "a.tum", "provide a file of the nodes' times"),
        ("3 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n", "a.tum", "appears twice"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "a.kitti", "1 pose for the graph's 3 nodes"),
        ("3 1 0 0 0 0 -1 0 1 0\n", "a.rots", "3D poses, but the graph is 2D"),
        (
            "3 1 0 0 0 1 0 0 0 1\n5 1 0 0 0 1 0 0 0 1\n9 1 0 0 0 1 0 0 0 1\n",
            "a.rots",
            "rotations only",
        ),
        ("0 0 0 0 0 0 0 0\n", "a.tum", ":1: a quaternion must not be zero"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", "a.tum", ":2: timestamp tx ty tz"),
        ("3 1 0 0 0 1 0 0 0 1\n3 1 0 0 0 1 0 0 0 1\n", "a.rots", ":2: node 3 appears twice"),
        ("# Bundle file v0.3\n1 0\n1 0 0\n1 0 x\n", "a.out", ":4: three numbers of R"),
        ("EDGE2 0 1 1 0 0\n", "a.txt", "no estimate"),
        (GRAPH, "b.g2o", "no vertex lines"),
    ],
)
def test_estimates_that_do_not_fit(file, text, name, message):
    instance = io.read(file(GRAPH))
    path = file(text, name)
    with pytest.raises(FormatError) as caught:
        io.read_estimate(path, instance)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_partial_truth_is_refused_by_read_and_returned_by_read_truth(file):
    truth = file("VERTEX_SE2 5 1 0 0\nVERTEX_SE2 77 1 0 0\n", "truth.g2o")
    graph = file(GRAPH)
    with pytest.raises(InputError, match="truth for 1 of 3 nodes only"):
        io.read(graph, truth=truth)
    with pytest.warns(InputNotice, match="truth of 1 of 3 poses, .*; 1 other pose not used"):
        nodes, poses = io.read_truth(truth, io.read(graph))
    assert nodes.tolist() == [1]
    assert poses.translations.tolist() == [[1.0, 0.0]]
    with pytest.raises(FormatError, match="no node id is in the graph"):
        io.read_truth(file("VERTEX_SE2 77 1 0 0\n", "other.g2o"), io.read(graph))


def test_known_errors_share_one_base():
    assert issubclass(FormatError, CertPGOError)


def test_the_first_of_several_bad_lines_is_named(file):
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0 1 0 0 1 0 1\n" for k in range(40)]
    lines[17] = "EDGE_SE2 17 17 1 0 0 1 0 0 1 0 1\n"
    lines[18] = lines[33] = "EDGE_SE2 1 2 x 0 0 1 0 0 1 0 1\n"
    with pytest.raises(FormatError, match="18: node 17 is measured from itself"):
        io.read(file("".join(lines)))


def test_symbols_of_gtsam_with_letters_of_ascii_are_ids(file):
    """symbol('x', 0) is 120 2^56; beyond 2^63 are letters that are none of ASCII."""
    inside, beyond = 120 << 56, 255 << 56
    path = file(f"EDGE_SE2 {inside} {inside + 1} 1 0 0\n")
    assert io.read(path, quiet=True).ids.tolist() == [inside, inside + 1]
    with pytest.raises(FormatError, match="GTSAM do if their letters are ASCII"):
        io.read(file(f"EDGE_SE2 {inside} {beyond} 1 0 0\n"))


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ("inf 0 0 inf 0 inf", "finite numbers of information expected, not inf"),
        ("1 0 0 1 0", ".* 6 or no information numbers; 10 values found"),
        ("1 0 0 1 0 1_0", "finite numbers of information expected, not 1_0"),
    ],
)
def test_the_information_of_positions(file, numbers, said):
    lines = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1\nEDGE_SE3_XYZPRIOR 0 0 0 0 0 "
    with pytest.raises(FormatError, match=f":2: {said}"):
        io.read(file(f"{lines}{numbers}\n"))
