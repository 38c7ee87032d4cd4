"""Commands on a file with positions of poses."""

import json

import numpy as np
import pytest

SQUARE = """\
EDGE_SE2 0 1 1.01 0 1.57 100 0 0 100 0 100
EDGE_SE2 1 2 0.99 0 1.58 100 0 0 100 0 100
EDGE_SE2 2 3 1 0.01 1.56 100 0 0 100 0 100
EDGE_SE2 3 0 1 0 1.57 100 0 0 100 0 100
EDGE_PRIOR_SE2_XY 0 10 20 4 0 4
EDGE_PRIOR_SE2_XY 2 11.1 21.2 4 0 4
EDGE_SE2_GPS 3 10 21.2 4 0 4
"""


@pytest.fixture
def field(tmp_path):
    path = tmp_path / "field.g2o"
    path.write_text(SQUARE)
    return path


def test_solving_and_certifying_in_the_world(certpgo, field, tmp_path):
    out, table = tmp_path / "out.g2o", tmp_path / "c.csv"
    done = certpgo("solve", field, "-o", out, "--covariances", table)
    assert done.code == 0
    assert "CERTIFIED" in done.out
    assert (
        "3 priors, measured from a node that stands for the world; 3 of them positions alone"
        in done.err
    )
    assert f"covariances: {table}, in each node's frame, with the world fixed" in done.out
    lines = [line.split() for line in out.read_text().splitlines()]
    assert [int(line[1]) for line in lines] == [0, 1, 2, 3]
    there = np.array([line[2:4] for line in lines], dtype=float)
    np.testing.assert_allclose(there[[0, 2, 3]], [[10, 20], [11.1, 21.2], [10, 21.2]], atol=0.2)
    assert len(table.read_text().splitlines()) == 5
    judged = certpgo("certify", field, out)
    assert judged.code == 0
    assert "costliest edges   the world to" in judged.out
    moved = tmp_path / "moved.tum"
    moved.write_text("".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(4)))
    assert certpgo("certify", field, moved).code != 0


def test_describing_and_bounding(certpgo, field):
    done = certpgo("info", field)
    assert "world           node 4, which priors are measured from" in done.out
    assert "measurements    4 relative poses, 3 position priors" in done.out
    assert "landmarks" not in done.out
    assert "eigenvalues need edges that all measure rotations" in done.out
    assert certpgo("info", field, "--json").json["world_id"] == 4
    done = certpgo("bounds", field)
    assert done.code == 0
    assert "some edges measure no" in done.out
    done = certpgo("info", field, "--no-priors", "--json")
    assert done.json["world_id"] is None
    assert done.json["edges"] == 4


def test_converting(certpgo, field, tmp_path):
    again = tmp_path / "again.g2o"
    assert certpgo("convert", field, again).code == 0
    assert again.read_text().count("EDGE_PRIOR_SE2_XY") == 3
    packed = tmp_path / "again.npz"
    assert certpgo("convert", field, packed).code == 0
    assert certpgo("info", packed, "--json").code == 0


@pytest.mark.parametrize("command", ["solve", "certify"])
def test_proofs_with_priors(certpgo, field, tmp_path, command):
    proof, estimate = tmp_path / "p.cert", tmp_path / "e.g2o"
    for cost in ("g2o", "chordal"):
        certpgo("solve", field, "--cost", cost, "-o", estimate)
        given = [estimate] if command == "certify" else []
        assert certpgo(command, field, *given, "--cost", cost, "--proof", proof).code == 0
        done = certpgo("check", field, proof)
        assert done.code == 0
        assert "with 3 priors" in done.out
        assert ("g2o's chi2" in done.out) == (cost == "g2o")
    assert certpgo("solve", field, "--no-priors", "--proof", proof).code == 0
    assert "priors" not in certpgo("check", field, proof).out


def test_methods_that_need_whole_edges_say_so(certpgo, field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = certpgo("solve", field, "--method", "eig_se3")
    assert done.code == 1
    assert "edges that measure only a rotation or a translation" in done.err
    assert certpgo("solve", field, "--method", "newton", "--json").json["solution"]


def test_robust_and_pages(certpgo, field, tmp_path):
    wrong = tmp_path / "wrong.g2o"
    wrong.write_text(SQUARE + "EDGE_PRIOR_SE2_XY 1 90 90 4 0 4\n")
    done = certpgo("solve", wrong, "--robust", "--json")
    found = json.loads(done.out)
    assert found["solution"]["kept"] == 7
    page = tmp_path / "page.html"
    certpgo("solve", field, "--html", page)
    assert page.stat().st_size > 10_000


SEEN = SQUARE + "EDGE_SE2_XY 0 9 1 1 25 0 25\nEDGE_SE2_XY 1 9 1 0 25 0 25\n"


def test_landmarks_and_priors_together(certpgo, tmp_path):
    path, page, out = (tmp_path / name for name in ("seen.g2o", "page.html", "out.g2o"))
    path.write_text(SEEN)
    done = certpgo("info", path)
    assert "landmarks       1 point among the nodes" in done.out
    assert "--no-priors skips priors, --no-landmarks skips landmarks" in done.out
    assert "measurements    4 relative poses, 2 sightings, 3 position priors" in done.out
    found = certpgo("info", path, "--json").json
    assert (found["points"], found["sightings"], found["priors"]) == (1, 2, 3)
    done = certpgo("solve", path, "--html", page, "-o", out)
    assert done.code == 0
    text = page.read_text()
    assert "1 landmark, 2 sightings, 3 position priors" in text
    assert "the world to " in text
    assert "sightings and distances</label>" in text
    # A wrong rotation of the landmark is no distance: only poses have one.
    done = certpgo("certify", path, out, "--json")
    assert done.json["best"]["worst_deg"] < 1e-3
    assert done.json["costliest_edges"][0].keys() >= {"angle", "metres"}
    assert None in [edge["angle"] for edge in done.json["costliest_edges"]]


def test_what_is_not_determined_is_said(certpgo, tmp_path):
    graph = tmp_path / "one.g2o"
    lines = [f"EDGE_SE2 {10 * k} {10 * k + 10} 1 0 0.1 1 0 0 1 0 1" for k in (1, 2)]
    graph.write_text("\n".join([*lines, "EDGE_PRIOR_SE2_XY 20 5 0 4 0 4"]) + "\n")
    for command in ("info", "solve"):
        done = certpgo(command, graph)
        assert (
            "relative to the world, in 1 way: measurements of the rotation of node 10" in done.out
        )
        assert "node 10, node 20 and node 30 move freely" in done.out
        found = json.loads(certpgo(command, graph, "--json").out)
        said = found["undetermined"] if command == "info" else found["solution"]["undetermined"]
        assert said.startswith("node 10")
    graph.write_text("EDGE_SE2_XY 10 50 1 0 4 0 4\nEDGE_SE2_XY 30 50 0 0 4 0 4\n")
    done = certpgo("solve", graph)
    assert done.code == 1
    assert "determines the rotation of node 30" in done.err
    assert "there are no relative poses: the cost is F" in done.err
