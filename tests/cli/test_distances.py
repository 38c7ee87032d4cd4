"""How far an estimate can be from every optimum, in words and JSON."""

import numpy as np
import pytest

import certpgo as package
from certpgo.io.datasets.synthetic import helix


@pytest.fixture
def files(tmp_path):
    made = helix(6, np.random.default_rng(0))
    graph, answer = tmp_path / "helix.g2o", tmp_path / "answer.g2o"
    package.write(graph, made.graph)
    package.write(answer, package.solve(made.graph).estimate)
    return graph, answer


def test_a_line_says_how_far(files, certpgo):
    done = certpgo("certify", *files, "--cost", "chordal", "--reference", "3")
    [line] = [line for line in done.out.splitlines() if line.startswith("proven distance")]
    assert "degrees of every optimum" in line
    assert line.endswith("seen from node 3)")


def test_json_has_the_numbers(files, certpgo):
    found = certpgo("certify", *files, "--json", "--reference", "3").json
    distance = package.certify(*files).distance_from(3)
    assert (found["distance_m"], found["distance_deg"]) == pytest.approx(distance.largest, rel=0.1)
    assert found["distance_reference"] == 3
    assert found["distance_node"] == distance.node


def test_references_are_poses(files, certpgo):
    done = certpgo("certify", *files, "--reference", "77")
    assert done.code == 1
    assert "node 77 is none of the poses" in done.err
    done = certpgo("certify", *files, "--reference", "3", "--csv", "rows.csv")
    assert done.code == 1
    assert "--csv" in done.err
