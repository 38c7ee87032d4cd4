"""certpgo prove: solved, proven, checked; a line a graph, a badge, and exit codes."""

import gzip
import math
import re
from xml.etree import ElementTree

import pytest

import certpgo as package
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.solve import prove_files


def test_each_graph_is_proven_and_its_proof_is_kept(certpgo, square, tmp_path):
    other = tmp_path / "more" / "square.g2o"
    other.parent.mkdir()
    other.write_text(square.read_text().replace("1.01", "1.02"))
    folder, badge = tmp_path / "proofs", tmp_path / "badge.svg"
    done = certpgo("prove", square, other, "-o", folder, "--badge", badge)
    assert done.code == 0
    assert [line.partition(": PROVED: F(x) <= ")[0] for line in done.out.splitlines()] == [
        str(square),
        str(other),
    ]
    kept = sorted(folder.rglob("*.cert"))
    assert len(kept) == 2  # one name, two folders
    best = package.solve(square)
    bounds = [package.check(square, one) for one in kept if "more" not in one.parts]
    assert bounds[0].lower <= best.cost <= bounds[0].upper * (1 + 1e-12) + 1e-12
    assert "2 of 2 proven" in "".join(ElementTree.parse(badge).getroot().itertext())


def test_proofs_have_the_paths_of_their_graphs(certpgo, square, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    (tmp_path / "a_b.g2o").write_text(square.read_text())
    (tmp_path / "a" / "b.g2o").write_text(square.read_text().replace("1.01", "1.02"))
    assert certpgo("prove", "a/b.g2o", "a_b.g2o", "--out", "proofs").code == 0
    for name in ("a/b.g2o", "a_b.g2o"):
        assert certpgo("check", name, f"proofs/{name}.cert").code == 0
    outside = tmp_path / "here"
    outside.mkdir()
    monkeypatch.chdir(outside)
    (outside / "c.g2o").write_text(square.read_text())
    below = outside.joinpath(*tmp_path.parts[1:])
    below.mkdir(parents=True)
    (below / "a_b.g2o").write_text(square.read_text())
    done = certpgo("prove", below / "a_b.g2o", "../a_b.g2o", "-o", "proofs")
    assert done.code == 1
    assert "its proof would be proofs/" in done.err
    assert not (outside / "proofs").exists()


@pytest.mark.parametrize("at", ["--badge", "-o"])
def test_graphs_are_not_overwritten(certpgo, square, tmp_path, monkeypatch, at):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "proofs" / "square.g2o.cert"
    other.parent.mkdir()
    other.write_text(square.read_text())
    given = square if at == "--badge" else "proofs"
    done = certpgo("prove", "square.g2o", other, at, given)
    assert done.code == 1
    assert "is also an input, and would be overwritten" in done.err
    assert square.read_text() == other.read_text()


def test_the_document_rounds_outwards(certpgo, square):
    [(name, said)] = certpgo("prove", square, "--json").json.items()
    assert name == str(square)
    assert said["proved"]
    assert said["lower_bound"] <= said["cost_upper"] < math.inf


def test_what_is_not_proven_is_said_and_counted(certpgo, square, tmp_path):
    badge, estimate, bad = tmp_path / "b.svg", tmp_path / "e.g2o", tmp_path / "bad.g2o"
    certpgo("solve", square, "-o", estimate)
    bad.write_text("EDGE_SE2 0 1 1 0 x\n")
    done = certpgo("prove", square, estimate, bad, "--badge", badge)
    assert done.code == 1
    assert f"{estimate}: no measurements; skipped" in done.err
    assert f"{bad}: ERROR: " in done.out
    assert "1 of 2 proven" in badge.read_text()


def test_an_answer_without_a_certificate_is_not_proven(certpgo, square, monkeypatch):
    solve = package.solve

    def bounded(*given, **options):
        return solve(*given, **options, rtol=1e-300, atol=1e-300)

    monkeypatch.setattr(prove_files, "solve", bounded)
    done = certpgo("prove", square)
    assert done.code == 6
    assert ": NOT PROVED: " in done.out


def test_processes_prove_the_same_in_the_same_order(certpgo, square, tmp_path):
    graphs = [square, tmp_path / "bad.g2o", tmp_path / "cycle.g2o", tmp_path / "estimate.g2o"]
    graphs[1].write_text("EDGE_SE2 0 1 1 0 x\n")
    package.write(graphs[2], winding_cycle(5, 0.1, 0)[0])
    certpgo("solve", square, "-o", graphs[3])
    alone, together = (certpgo("prove", *graphs, "--workers", k) for k in ("1", "2"))
    assert together.out == alone.out
    assert (together.code, alone.code) == (1, 1)
    for said in ("cycle.g2o: all translations are zero", "estimate.g2o: no measurements; skipped"):
        assert said in alone.err
        assert said in together.err


@pytest.mark.parametrize("cost", ["gtsam", "no"])
def test_costs_without_proofs_are_refused(certpgo, square, cost):
    assert certpgo("prove", square, "--cost", cost).code in (1, 2)


def test_a_file_that_the_checker_does_not_read_is_refused_before_it_is_solved(
    certpgo, square, tmp_path, monkeypatch
):
    monkeypatch.setattr(prove_files, "solve", None)
    path = tmp_path / "square.g2o.gz"
    path.write_bytes(gzip.compress(square.read_bytes()))
    done = certpgo("prove", path)
    assert (done.code, "decompress it first" in done.out) == (1, True)


def test_optima_are_proven_to_be_near(certpgo, square, tmp_path):
    folder = tmp_path / "proofs"
    done = certpgo("prove", square, "--within", "0.05m,0.2deg", "-o", folder)
    said = "within 0.05 m and 0.2 degrees of every optimum: every node, seen from node "
    assert done.code == 0
    assert f"; {said}" in done.out
    [proof] = folder.rglob("*.cert")
    checked = certpgo("check", square, proof)
    assert checked.out.splitlines()[2].startswith(said)
    [claim] = certpgo("check", square, proof, "--json").json["within"]
    assert (claim["node"], claim["metres"], claim["degrees"]) == (None, 0.05, 0.2)
    [proven] = certpgo(
        "prove", square, "--within", "0.1m", "--reference", "2", "--json"
    ).json.values()
    assert proven["within"] == [{"node": None, "metres": 0.1, "degrees": None, "reference": 2}]
    [proven] = certpgo("prove", square, "--json").json.values()
    assert proven["within"] == []


@pytest.mark.parametrize("within", ["1e-12m", "1m,1e-12deg"])
def test_optima_that_may_be_further_away_fail(certpgo, square, within):
    done = certpgo("prove", square, "--within", within)
    assert done.code == 6
    said = r"NOT PROVED: within \S+ (m|degrees) of every optimum \(node \d seen from node \d"
    assert re.match(rf"{square}: {said}", done.out)
    assert "not 1e-12" in done.out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--within", "0.05"], "as in 0.05m,0.2deg, not 0.05"),
        (["--within", "m"], "as in 0.05m,0.2deg"),
        (["--within", "-1m"], "as in 0.05m,0.2deg"),
        (["--within", "200deg"], "as in 0.05m,0.2deg"),
        (["--reference", "0"], "--reference needs --within"),
        (["--within", "1m", "--reference", "77"], "node 77 is none of the poses"),
    ],
)
def test_distances_that_mean_nothing_are_refused(certpgo, square, options, said):
    done = certpgo("prove", square, *options)
    assert done.code == 1
    assert said in done.out + done.err


def test_distances_are_checked_in_integers(certpgo, square, tmp_path):
    done = certpgo("prove", square, "--cost", "chordal", "--within", "0.1m,1deg", "-o", tmp_path)
    assert done.code == 0
    [proof] = tmp_path.rglob("square.g2o.cert")
    text = certpgo("check", square, proof, "--exact").out
    assert "within 0.1 m and 1.0 degrees of every optimum: every node, seen from node" in text
    [claim] = certpgo("check", square, proof, "--exact", "--json").json["within"]
    assert (claim["metres"], claim["degrees"]) == (0.1, 1.0)


def test_distances_of_scaled_poses_are_not_proven(certpgo, tmp_path, capsys):
    path = tmp_path / "scaled.g2o"
    lines = [f"EDGE_SIM3:EXPMAP {k} {k + 1} 0 0 0.1 1 0 0 0.01" for k in range(3)]
    path.write_text("\n".join([*lines, "EDGE_SIM3:EXPMAP 0 3 0 0 0.3 3 0 0 0.03"]) + "\n")
    done = certpgo("prove", path, "--within", "1m")
    assert done.code == 1
    assert "how far optima are is not proven of poses of unknown scale" in done.out
