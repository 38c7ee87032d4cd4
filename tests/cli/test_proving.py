"""Proofs on the command line: written, checked, refused."""

import hashlib
import json

import numpy as np
import pytest

from certpgo.certify.dual import Attempts
from certpgo.io import write
from certpgo.io.datasets import synthetic


@pytest.fixture
def proof(certpgo, square, tmp_path):
    """The proof of the square's optimum."""
    path = tmp_path / "square.cert"
    done = certpgo("solve", square, "-o", tmp_path / "best.g2o", "--proof", path)
    assert done.code == 0
    assert f"{path}: PROVED: F(x) <= " in done.out
    return path


def test_check_says_what_is_proven(certpgo, square, proof):
    done = certpgo("check", square, proof)
    assert done.code == 0
    assert done.out.startswith("PROVED: F(x) <= ")
    done = certpgo("check", square, proof, "--json")
    assert done.code == 0
    assert done.json["proved"]
    assert 0.0 < done.json["lower_bound"] <= done.json["cost_upper"]
    assert done.json["relative_gap"] < 1e-8


def test_check_in_integers_alone(certpgo, square, proof, tmp_path):
    doubles, done = certpgo("check", square, proof), certpgo("check", square, proof, "--exact")
    assert (done.code, done.out) == (0, doubles.out)
    assert "g2o's chi2" in done.out
    assert certpgo("solve", square, "--cost", "chordal", "--proof", proof).code == 0
    doubles, done = certpgo("check", square, proof), certpgo("check", square, proof, "--exact")
    assert (done.code, done.out) == (0, doubles.out)
    first = certpgo("check", square, proof, "--json").json
    exact = certpgo("check", square, proof, "--exact", "--json").json
    assert (first["checked_in"], exact["checked_in"]) == ("doubles", "integers")
    assert first["lower_bound"] <= exact["lower_bound"] <= exact["cost_upper"]
    assert exact["cost_upper"] <= first["cost_upper"]
    assert certpgo("check", square, square, "--exact").code == 1
    other = tmp_path / "other.g2o"
    other.write_text(square.read_text().replace("1.58", "1.59"))
    assert certpgo("check", other, proof, "--exact").code == 6
    assert not certpgo("check", other, proof, "--exact", "--json").json["proved"]


def test_check_refuses_another_graph(certpgo, square, proof, tmp_path):
    other = tmp_path / "other.g2o"
    other.write_text(square.read_text().replace("1.58", "1.59"))
    done = certpgo("check", other, proof)
    assert done.code == 6
    assert done.out.startswith("REFUSED: ")
    done = certpgo("check", other, proof, "--json")
    assert done.code == 6
    assert not done.json["proved"]
    assert "SHA-256" in done.json["reason"]


def test_check_names_what_it_cannot_read(certpgo, square, proof, tmp_path):
    done = certpgo("check", square, square)
    assert done.code == 1
    assert not done.out
    assert done.err.count("\n") == 1
    assert done.err.startswith("certpgo: ")
    assert "not a readable proof" in done.err
    done = certpgo("check", square, tmp_path / "nowhere.cert", "--json")
    assert done.code == 1
    assert "nowhere.cert" in done.err
    assert certpgo("check", tmp_path / "nowhere.g2o", proof).code == 1


def test_certify_proves_the_answer_as_given(certpgo, square, proof, tmp_path):
    out = tmp_path / "given.cert"
    done = certpgo("certify", square, square, "--proof", out, "--json")
    assert done.code == 3
    cost = done.json["cost"]
    assert f"{out}: PROVED" in done.err
    checked = certpgo("check", square, out, "--json").json
    assert checked["cost_upper"] == pytest.approx(cost, rel=1e-9)
    best = certpgo("check", square, proof, "--json").json
    assert checked["lower_bound"] == pytest.approx(best["lower_bound"], rel=1e-9)


def test_proofs_about_rotations_alone(certpgo, square, tmp_path):
    out, best = tmp_path / "rotations.cert", tmp_path / "rotations.g2o"
    done = certpgo("solve", square, "--rotations", "-o", best, "--proof", out)
    assert done.code == 0
    poses = certpgo("solve", square, "--json").json["cost"]
    assert certpgo("check", square, out, "--json").json["cost_upper"] < poses


def test_the_proof_tier_says_what_it_trusts(certpgo, square, proof, tmp_path):
    done = certpgo("certify", square, tmp_path / "best.g2o", "--tier", "proof")
    assert done.code == 0
    assert "IEEE 754" in done.out


def test_proofs_about_g2os_cost_name_it(certpgo, square, tmp_path):
    out, best = tmp_path / "g2o.cert", tmp_path / "g2o.g2o"
    done = certpgo("solve", square, "--cost", "g2o", "-o", best, "--proof", out)
    assert done.code == 0
    said = "about  g2o's chi2 of EdgeSE2 with full information, the poses of 4 nodes"
    assert said in done.out
    assert "sine and arctangent" in done.out
    cost = certpgo("solve", square, "--cost", "g2o", "--json").json["cost"]
    checked = certpgo("check", square, out, "--json").json
    assert checked["lower_bound"] <= checked["cost_upper"]
    assert checked["cost_upper"] == pytest.approx(cost, rel=1e-12)
    assert checked["relative_gap"] < 1e-8
    assert checked["about"].startswith("g2o's chi2 of EdgeSE2 with full information")
    done = certpgo("certify", square, square, "--cost", "g2o", "--proof", out, "--json")
    assert done.code == 3
    assert f"{out}: PROVED" in done.err
    given = certpgo("check", square, out, "--json").json
    assert given["cost_upper"] == pytest.approx(done.json["cost"], rel=1e-12)
    assert given["lower_bound"] == pytest.approx(checked["lower_bound"], rel=1e-9)


@pytest.mark.parametrize("command", ["solve", "certify"])
def test_gtsams_cost_has_no_proofs(certpgo, square, tmp_path, command):
    out = tmp_path / "gtsam.cert"
    more = [square] if command == "certify" else []
    done = certpgo(command, square, *more, "--cost", "gtsam", "--proof", out)
    assert (done.code, out.exists()) == (1, False)
    assert done.err == "certpgo: --proof is for --cost chordal and g2o, not for --cost gtsam\n"


@pytest.mark.parametrize("command", ["solve", "certify"])
def test_what_cannot_be_proven_is_said_before_the_work(certpgo, square, tmp_path, command):
    other = tmp_path / "square.pyfg"
    certpgo("convert", square, other)
    more = [square] if command == "certify" else []
    out = tmp_path / "out.cert"
    done = certpgo(command, other, *more, "--proof", out)
    assert done.code == 1
    assert "convert it first" in done.err
    done = certpgo(command, square, *more, "--proof", tmp_path / "no" / "out.cert")
    assert done.code == 1
    assert "no folder" in done.err
    done = certpgo(command, square, *more, "--proof", square)
    assert done.code == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "last", "said"),
    [
        (["--weights-are", "covariance"], "100", "is about a file of information matrices"),
    ],
)
def test_files_that_the_checker_does_not_read_are_refused_before_the_work(
    certpgo, tmp_path, options, last, said
):
    path, out = tmp_path / "turns.g2o", tmp_path / "turns.cert"
    lines = [(0, 1, 1, "100"), (1, 2, 1, "100"), (0, 2, 2, last)]
    path.write_text("".join("EDGE_SE2 {} {} {} 0 0 9 0 0 9 0 {}\n".format(*one) for one in lines))
    done = certpgo("solve", path, *options, "--proof", out, "--json")
    assert (done.code, done.out, out.exists()) == (1, "", False)
    assert said in done.err


def test_a_proof_is_about_one_answer(certpgo, square, tmp_path):
    out = tmp_path / "out.cert"
    done = certpgo("certify", square, square, "--csv", tmp_path / "all.csv", "--proof", out)
    assert done.code == 1
    done = certpgo("solve", square, "--method", "eigen_ma", "--no-certify", "--proof", out)
    assert done.code == 1
    assert not out.exists()


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_carriage_return_within_a_line_is_the_graphs_fault(
    certpgo, square, proof, tmp_path, more
):
    # The checker takes the file for unreadable, so the reader must, and both say where.
    square.write_bytes(square.read_bytes().removesuffix(b"\n") + b"\r")
    out = tmp_path / "out.cert"
    done = certpgo("solve", square, "--proof", out, *more)
    assert (done.code, done.out, out.exists()) == (1, "", False)
    assert (
        done.err == f"certpgo: {square}:8: a carriage return within a line: LF or CRLF end lines\n"
    )
    about_it = tmp_path / "about.cert"
    arrays = dict(np.load(proof))
    claim = json.loads(bytes(arrays["claim"]))
    claim["graph_sha256"] = hashlib.sha256(square.read_bytes()).hexdigest()
    arrays["claim"] = np.frombuffer(json.dumps(claim).encode(), dtype=np.uint8)
    with about_it.open("wb") as file:
        np.savez(file, **arrays)
    done = certpgo("check", square, about_it, *more)
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert f"{square}: line 8: plain text expected" in done.err
    assert str(about_it) not in done.err


def test_lines_may_end_in_crlf(certpgo, square, tmp_path):
    square.write_bytes(square.read_bytes().replace(b"\n", b"\r\n"))
    out = tmp_path / "out.cert"
    assert certpgo("solve", square, "--proof", out).code == 0
    assert certpgo("check", square, out).code == 0


def test_a_proof_and_its_verdict_say_one_thing(certpgo, tmp_path, monkeypatch):
    """Costs of 1e-10 of the weights: too little for shifts, but not for a proof."""
    monkeypatch.setattr(Attempts, "loses_to_rounding", lambda self: False)
    graph, proof = tmp_path / "corridor.g2o", tmp_path / "corridor.cert"
    write(graph, synthetic.corridor(400, np.random.default_rng(0)))
    done = certpgo("solve", graph, "--json")
    assert (done.json["tier"], done.code) == ("proof", 0)  # asked by itself
    done = certpgo("solve", graph, "--proof", proof)
    assert done.code == 0
    assert "CERTIFIED" in done.out
    assert "BOUNDED" not in done.out
    bound = float(done.out.split("F* >= ")[1].split(",")[0])
    said = float(done.out.split("lower bound")[1].split()[0])
    assert bound == pytest.approx(said, rel=1e-2)
    estimate = tmp_path / "best.g2o"
    certpgo("solve", graph, "-o", estimate)
    done = certpgo("certify", graph, estimate, "--json", "--proof", tmp_path / "again.cert")
    assert (done.json["tier"], done.json["verdict"]) == ("proof", "CERTIFIED")


def test_unknown_tiers_are_refused_with_the_known_ones(certpgo, square):
    done = certpgo("solve", square, "--tier", "prof")
    assert done.code == 1
    assert "proof" in done.err


def test_a_weaker_proof_of_a_long_bridge_is_said_to_be(certpgo, tmp_path):
    rng, information = np.random.default_rng(0), "1 0 0 1 0 1"
    turns = 2.0 * np.pi / 6 + 1e-4 * rng.standard_normal(12)
    lines = [f"EDGE_SE2 {k} {(k + 1) % 6} 1 0 {turns[k]} {information}" for k in range(6)]
    lines += [
        f"EDGE_SE2 {6 + k} {6 + (k + 1) % 6} 1 0 {turns[6 + k]} {information}" for k in range(6)
    ]
    lines.append(f"EDGE_SE2 0 6 1e8 0 0.5 {information}")
    graph = tmp_path / "rings.g2o"
    graph.write_text("\n".join(lines) + "\n")
    done = certpgo("solve", graph, "--cost", "chordal", "--proof", tmp_path / "rings.cert")
    assert done.code == 0
    assert "weaker than the certificate's" in done.err
