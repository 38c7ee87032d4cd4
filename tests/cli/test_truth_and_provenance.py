"""--truth, and what stands in every output: averages, skipped lines, fixed nodes."""

import json

import numpy as np
import pytest

from certpgo import read, write
from certpgo.io import read_estimate
from certpgo.io.datasets import synthetic
from certpgo.solve.metrics import trajectory_errors

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
    assert "kappa and tau average over directions (anisotropy up to 100 in transl" in done.out
    assert (done.out + done.err).count("1 EDGE_BEARING_SE2_XY line skipped: landmarks") == 1
    assert "fixed             0, 2 by the file" in done.out
    page = tmp_path / "page.html"
    assert certpgo("solve", path, "--cost", "chordal", "--html", page).code == 0
    assert "0, 2 by the file, not held here\n" in done.out  # there are no values to hold them at
    for word in ("anisotropy up to 100", "line skipped: landmarks", "0, 2 by the file"):
        assert word in page.read_text()
    data = certpgo("solve", path, "--cost", "chordal", "--json").json
    assert data["averaged"] == {"translation": 100.0, "rotation": 1.0}
    assert (data["fixed_ids"], len(data["notices"])) == ([0, 2], 2)
    own = certpgo("solve", path, "--json").json
    assert own["averaged"] is None
    assert "anisotropy" not in certpgo("solve", path).out
    assert str(tmp_path) not in json.dumps([data, own])
    assert str(tmp_path) not in certpgo("info", path).out


def test_which_nodes_are_held_and_which_released_is_said(certpgo, tmp_path):
    path, values = tmp_path / "graph.g2o", ["0 0 0 0", "1 1 0 0.1", "2 1 1 0"]
    skipped = FILE.rindex("EDGE_BEARING")
    path.write_text("".join(f"VERTEX_SE2 {x}\n" for x in values) + FILE[:skipped])
    assert "0, 2 by the file\n" in certpgo("solve", path).out
    assert "0, 2 by the file, not held here\n" in certpgo("solve", path, "--no-fixed").out
    assert f"{path}: ERROR: the checker holds no nodes" in certpgo("prove", path).out


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
    methods = ("--methods", "certified,newton", "--cost", "chordal")
    common = ("compare", files[0], *methods, "--out", tmp_path / "r")
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


def test_a_table_may_have_an_empty_column(capsys):
    from certpgo.cli._show import table

    table("t", ["nodes", ""], [["1-2", ""]])
    assert "1-2" in capsys.readouterr().out


#: Eight planar poses in space, one a second, without noise.
STEPS = [(1.0, -0.2), (1.4, 0.1), (0.6, -0.9), (1.5, 0.5), (0.8, 0.1), (0.9, -0.3), (1.3, 0.6)]
WHERE = np.concatenate([[(0.0, 0.0)], np.cumsum(STEPS, axis=0)])


@pytest.fixture
def walk(tmp_path):
    """A graph of the ids 0 to 7, and the times of its nodes from 3 s on."""
    path, times = tmp_path / "walk.g2o", tmp_path / "times.txt"
    edge = "EDGE_SE3:QUAT {} {} {} {} 0 0 0 0 1 " + "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n"
    pairs = [*((k, k + 1) for k in range(7)), (0, 3), (2, 6), (1, 7)]
    path.write_text("".join(edge.format(i, j, *(WHERE[j] - WHERE[i]).tolist()) for i, j in pairs))
    times.write_text("".join(f"{k + 3}.0\n" for k in range(8)))
    return path, times


def trajectory(path, stamps, places):
    """A TUM file with a pose that looks ahead at each place."""
    rows = zip(stamps, np.asarray(places).tolist(), strict=True)
    path.write_text("".join(f"{stamp} {x} {y} 0 0 0 0 1\n" for stamp, (x, y) in rows))
    return path


def test_whole_seconds_are_times_where_the_nodes_have_times(certpgo, walk, tmp_path):
    graph, times = walk
    other = [(9.0, k) for k in range(1, 4)]
    whole = trajectory(tmp_path / "truth.tum", range(15), [*other, *WHERE, *other, (0, 0)])
    for command in (("solve", graph), ("compare", graph, "--methods", "certified")):
        out = ("--out", tmp_path / "r") if command[0] == "compare" else ()
        given = (*command, *out, "--truth", whole, "--json")
        done = certpgo(*given, "--timestamps", times)
        accuracy = (done.json[0] if isinstance(done.json, list) else done.json)["accuracy"]
        assert (accuracy["poses"], accuracy["ate_m"] < 1e-6) == (8, True)
        assert "truth of 8 of 8 poses, matched by time; 7 other poses not used" in done.err
        assert "taken for node ids; 7 other poses not used" in certpgo(*given).err
        late = certpgo(*given, "--timestamps", times, "--truth-offset", 0.02)
        assert (late.code, "no pose is within 0.01 s of a node" in late.err) == (1, True)
        assert certpgo(
            *given, "--timestamps", times, "--truth-offset", 0.02, "--max-difference", 0.03
        ).json


def test_the_times_of_an_estimate_are_its_nodes_times(certpgo, walk, tmp_path):
    graph, _ = walk
    estimate = trajectory(tmp_path / "e.tum", [100.25 + k for k in range(8)], WHERE)
    truth = trajectory(tmp_path / "t.tum", [100.251 + k for k in range(4)], WHERE[:4])
    done = certpgo("certify", graph, estimate, "--truth", truth)
    assert "truth of 4 of 8 poses, matched by time, off by at most 0.001 s" in done.err
    assert "4 poses, after alignment" in done.out
    best = tmp_path / "best.tum"
    assert certpgo("certify", graph, estimate, "--best", best).code == 0
    assert best.read_text().splitlines()[7].startswith("107.25 ")


def test_a_truth_that_was_converted_keeps_its_nodes(certpgo, walk, tmp_path):
    source = tmp_path / "truth.g2o"
    vertex = "VERTEX_SE3:QUAT {} {} {} 0 0 0 0 1\n"
    source.write_text("".join(vertex.format(k, *WHERE[k].tolist()) for k in range(2, 7)))
    for suffix in ("tum", "g2o", "npz", "pyfg"):
        truth = tmp_path / f"converted.{suffix}"
        assert certpgo("convert", source, truth).code == 0
        done = certpgo("solve", walk[0], "--truth", truth, "--json")
        assert done.json["accuracy"]["ate_m"] < 1e-6
        assert "truth of 5 of 8 poses, matched by" in done.err


def test_convert_keeps_the_ids_of_an_estimate_beside_measurements(certpgo, tmp_path):
    both, out = tmp_path / "both.g2o", tmp_path / "b.tum"
    both.write_text("VERTEX_SE2 10 0 0 0\nVERTEX_SE2 30 2 0 0\nEDGE_SE2 10 30 2 0 0 1 0 0 1 0 1\n")
    assert certpgo("convert", both, out, "--estimate").code == 0
    assert [line.split()[0] for line in out.read_text().splitlines()] == ["10", "30"]
    assert certpgo("convert", both, out, "--estimate", "--timestamps", "index").code == 0
    assert [line.split()[0] for line in out.read_text().splitlines()] == ["0", "1"]


def test_a_partial_estimate_is_judged_on_what_it_covers(certpgo, walk, tmp_path):
    graph, times = walk
    part = trajectory(tmp_path / "part.tum", range(6), WHERE[:6] * 1.1)
    done = certpgo("certify", graph, part, "--cost", "chordal", "--json")
    assert done.json["graph"] == "walk [6 of 8 nodes]"
    said = "poses of 6 of 8 nodes: judged by the 6 measurements between these"
    assert (said in done.err, done.json["notices"][-1]) == (True, said)
    lines = graph.read_text().splitlines()
    inside = [line for line in lines if max(map(int, line.split()[1:3])) < 6]
    alone = tmp_path / "alone.g2o"
    alone.write_text("\n".join(inside))
    whole = certpgo("certify", alone, part, "--cost", "chordal", "--json").json
    assert done.json["cost"] == whole["cost"]
    by_time = trajectory(tmp_path / "late.tum", [k + 3 for k in range(6)], WHERE[:6] * 1.1)
    timed = certpgo("certify", graph, by_time, "--timestamps", times, "--cost", "chordal", "--json")
    assert timed.json["cost"] == whole["cost"]
    table = tmp_path / "rows.csv"
    assert certpgo("certify", graph, part, part, "--csv", table).code != 1
    assert "walk [6 of 8 nodes]" in table.read_text()
    apart = trajectory(tmp_path / "apart.tum", [0, 1, 4, 5], WHERE[[0, 1, 4, 5]])
    refused = certpgo("certify", graph, apart)
    assert (refused.code, "--components largest" in refused.err) == (1, True)
    proof = certpgo("certify", graph, part, "--proof", tmp_path / "x.cert")
    assert (proof.code, "--proof needs an estimate of all nodes" in proof.err) == (1, True)
