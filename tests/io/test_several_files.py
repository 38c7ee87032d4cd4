"""Several files that are read as one graph."""

from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo.errors import FormatError, InputError, InputNotice
from certpgo.io.datasets.synthetic import helix

A = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
FIX 0
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5 100 0 0 100 0 400
"""
B = """# another robot
VERTEX_SE2 1 1.1 0 0
VERTEX_SE2 2 2 0 1.5
VERTEX_SE2 3 2 1 3
EDGE_SE2 2 3 1 0 1.5 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5 100 0 0 100 0 400
EDGE_SE2 3 0 2 1 -3 100 0 0 100 0 400
"""


@pytest.fixture
def files(tmp_path):
    """Two robots' files, which share node 1 and a measurement between 1 and 2."""
    for name, text in (("a.g2o", A), ("b.g2o", B)):
        (tmp_path / name).write_text(text)
    return tmp_path / "a.g2o", tmp_path / "b.g2o"


def test_ids_are_shared_and_what_two_files_have_counts_once(files):
    instance = certpgo.read(files, quiet=True)
    assert instance.name == "a+b"
    assert instance.source == f"{files[0]}, {files[1]}"
    assert instance.ids.tolist() == [0, 1, 2, 3]
    # Parallel measurements of one file are two; that from 1 to 2 is in both.
    assert instance.graph.edges.tolist() == [[0, 1], [0, 1], [1, 2], [2, 3], [3, 0]]
    assert instance.initial.translations[1].tolist() == [1.0, 0.0]
    assert instance.notices == (
        "1 node with values in several files: the first one's are used",
        "1 measurement in several files, in the same numbers: counted once",
    )
    with pytest.warns(InputNotice, match="several files"):
        answer = certpgo.solve([str(f) for f in files])
    assert answer.cost == certpgo.solve(instance).cost


def test_a_node_that_both_fix_is_fixed_once(files):
    files[1].write_text(B.replace("VERTEX_SE2 2", "FIX 0\nVERTEX_SE2 2"))
    assert certpgo.read(files, quiet=True).fixed == (0,)


@pytest.mark.parametrize("seed", range(4))
def test_however_a_graph_is_split_the_files_together_are_it(tmp_path, seed):
    rng = np.random.default_rng(seed)
    made = helix(5, rng)
    whole = replace(made, initial=made.truth)
    certpgo.write(tmp_path / "whole.g2o", whole)
    lines = (tmp_path / "whole.g2o").read_text().splitlines(keepends=True)
    in_file = rng.integers(1, 8, len(lines))  # one of three, two, or all of them
    paths = [tmp_path / f"{k}.g2o" for k in range(3)]
    for k, path in enumerate(paths):
        own = np.flatnonzero(in_file & (1 << k))
        path.write_text("".join(lines[row] for row in own))
    together = certpgo.read(paths, quiet=True)
    expected = certpgo.read(tmp_path / "whole.g2o", quiet=True)
    assert together.graph.num_edges == expected.graph.num_edges
    assert (together.initial.rotations == expected.initial.rotations).all()
    found, known = (certpgo.solve(one, cost="chordal").cost for one in (together, expected))
    assert found == pytest.approx(known, rel=1e-9)


@pytest.mark.parametrize(
    ("added", "line", "said"),
    [
        ("EDGE_SE2 3 4 x 0 0\n", 8, "numbers expected after the ids, not 'x'"),
        ("VERTEX_SE2 3 2 1 3\n", 8, "node 3 appears twice"),
        ("VERTEX_SE2 0 5 0 0\n", 8, "node 0 is fixed, and has another pose here"),
        ("FIX 9\n", None, "FIX 9: no such node"),
    ],
)
def test_errors_name_the_file_and_its_own_line(files, added, line, said):
    files[1].write_text(B + added)
    with pytest.raises(FormatError, match=said) as error:
        certpgo.read(files)
    assert error.value.line == line
    assert (error.value.path == files[1]) is (line is not None)


def test_files_of_other_kinds_are_refused(files, tmp_path):
    certpgo.write(tmp_path / "a.npz", certpgo.read(files[0], quiet=True))
    with pytest.raises(FormatError, match=r"a\.g2o is a g2o file, and this one npz"):
        certpgo.read([files[0], tmp_path / "a.npz"])
    with pytest.raises(FormatError, match="several npz files are not read as one graph"):
        certpgo.read([tmp_path / "a.npz", files[0]])


def test_nothing_is_no_graph():
    with pytest.raises(InputError, match="a file is expected"):
        certpgo.read([])


def test_the_order_of_files_changes_no_measurement(tmp_path):
    """One file has a measurement twice, the other the same once: it counts twice."""
    line = "EDGE_SE2 {} {} {} 0 {} 1 0 0 1 0 1\n".format
    once, twice = tmp_path / "once.g2o", tmp_path / "twice.g2o"
    twice.write_text(2 * line(0, 1, 1, 0) + line(1, 2, 1, 0.5))
    once.write_text(line(0, 1, "1.0", "-0.0") + 2 * line(2, 0, -2, 0) + line(0, 2, 2, 0))
    found = []
    for files in ([twice, once], [once, twice], [once, twice, once], [twice, twice, once]):
        graph = certpgo.read(files, quiet=True).graph
        assert sorted(graph.edges.tolist()) == [[0, 1], [0, 1], [0, 2], [1, 2], [2, 0], [2, 0]]
        found.append(certpgo.solve(graph, cost="chordal").cost)
    # SciPy's least squares over three poses.
    assert found == pytest.approx(4 * [0.31300116412957807], rel=1e-9)
