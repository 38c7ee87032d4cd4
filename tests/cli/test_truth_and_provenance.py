"""--truth, and what stands in every output: averages, skipped lines, fixed nodes."""

import json

import numpy as np
import pytest

from certpgo import read, write
from certpgo.assess.metrics import trajectory_errors
from certpgo.datasets import synthetic
from certpgo.io import read_estimate

FILE = """\
FIX 0
FIX 2
EDGE_SE2 0 1 1 0 0.1 100 0 0 1 0 4
EDGE_SE2 1 2 0 1 0 100 0 0 1 0 4
EDGE_SE2 2 0 -1 -1 0 100 0 0 1 0 4
EDGE_BEARING_SE2_XY 0 1 0.3 1
"""


@pytest.fixture
def files(tmp_path):
    """A graph, and the truth of all but one of its poses."""
    made = synthetic.grid3d(3, np.random.default_rng(0))
    graph, truth = tmp_path / "graph.g2o", tmp_path / "truth.tum"
    write(graph, made.graph)
    write(truth, made.truth.subset(np.arange(1, 27)), ids=np.arange(1, 27), anchor="none")
    return graph, truth


def test_errors_stand_beside_the_cost(certpgo, files, tmp_path):
    graph, truth = files
    out = tmp_path / "out.tum"
    solved = certpgo("solve", graph, "--truth", truth, "-o", out)
    assert all(word in solved.out for word in ("\nATE ", "\nRPE ", "26 poses"))
    found = certpgo("certify", graph, out, "--truth", truth, "--json").json["accuracy"]
    estimate = read_estimate(out, read(graph)).subset(np.arange(1, 27))
    expected = trajectory_errors(estimate, read_estimate(truth))
    assert found["poses"] == 26
    assert found["ate_m"] == pytest.approx(expected.ate_m, rel=1e-12)
    assert found["rpe_deg"] == pytest.approx(expected.rpe_deg, rel=1e-12)
    methods = ("--methods", "certified,spanning_tree", "--out", tmp_path / "r")
    rows = certpgo("compare", graph, "--truth", truth, *methods, "--json").json
    assert rows[0]["accuracy"]["ate_m"] < rows[1]["accuracy"]["ate_m"]
    assert certpgo("certify", graph, out, "--json").json["accuracy"] is None


def test_truth_of_another_graph_is_refused(certpgo, files, tmp_path):
    other = tmp_path / "other.tum"
    other.write_text("99 0 0 0 0 0 0 1\n")
    done = certpgo("solve", files[0], "--truth", other)
    assert (done.code, f"certpgo: {other}: " in done.err) == (1, True)


def test_what_was_averaged_skipped_and_fixed_stands_in_every_output(certpgo, tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text(FILE)
    done = certpgo("solve", path, "--cost", "chordal")
    assert "averaged          information over directions" in done.out
    assert "factors of up to 100 in translation" in done.out
    assert "1 EDGE_BEARING_SE2_XY line skipped: landmarks" in done.out
    assert "fixed             0, 2 by the file" in done.out
    page = tmp_path / "page.html"
    assert certpgo("solve", path, "--cost", "chordal", "--html", page).code == 0
    for word in ("factors of up to 100", "line skipped: landmarks", "0, 2 by the file"):
        assert word in page.read_text()
    data = certpgo("solve", path, "--cost", "chordal", "--json").json
    assert data["averaged"] == {"translation": 100.0, "rotation": 1.0}
    assert (data["fixed_ids"], len(data["notices"])) == ([0, 2], 2)
    own = certpgo("solve", path, "--json").json
    assert own["averaged"] is None
    assert "averaged" not in certpgo("solve", path).out
    assert str(tmp_path) not in json.dumps([data, own])
    assert str(tmp_path) not in certpgo("info", path).out


def test_a_proof_says_where_weights_are_one(certpgo, tmp_path):
    path, proof = tmp_path / "graph.g2o", tmp_path / "graph.cert"
    path.write_text("EDGE_SE2 0 1 1 0 0.1\nEDGE_SE2 1 2 0 1 0\nEDGE_SE2 2 0 -1 -1 0\n")
    assert certpgo("solve", path, "--proof", proof).code == 0
    said = certpgo("check", path, proof).out
    assert "kappa of the file (1 without information), tau of the file (1 without" in said
    path.write_text(FILE)
    assert certpgo("solve", path, "--cost", "chordal", "--proof", proof).code == 0
    assert "kappa of the file, tau of the file," in certpgo("check", path, proof).out


def test_seconds_are_one_column_and_phases_another(certpgo, files, tmp_path):
    common = ("compare", files[0], "--methods", "certified,newton", "--out", tmp_path / "r")
    plain = certpgo(*common)
    assert " seconds" in plain.out
    assert "by phase" not in plain.out
    assert "by phase" in certpgo(*common, "--phases").out
    assert "graph: newton: CERTIFIED, cost " in plain.err  # told while others run


def test_a_narrow_table_leaves_columns_out_and_says_so(capsys, monkeypatch):
    from certpgo.cli._show import table

    monkeypatch.setenv("COLUMNS", "40")
    row = ["gtsam_levenberg", "1025.39806", "862.9492", "CERTIFIED"]
    table("t", ["method", "F", "f_ML", "verdict"], [row], optional=("f_ML", "F"))
    out = capsys.readouterr().out
    assert ("gtsam_levenberg " in out, "CERTIFIED" in out) == (True, True)
    assert "862.9492" not in out
    assert "Not shown at this width: f_ML, F." in out
    assert max(map(len, out.splitlines())) <= 40
