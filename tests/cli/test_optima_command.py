"""certpgo optima, and what other commands say of graphs that the register knows."""

import json

import pytest

from certpgo.optima import Register, recognition, register

COSTS = {"chordal", "g2o", "gtsam"}


@pytest.fixture
def folder(tmp_path, square, certpgo):
    """A register that knows the square."""
    folder = tmp_path / "register"
    folder.mkdir()
    added = certpgo("optima", "--add", square, "--register", folder, "--source", "o/r@c:s.g2o")
    assert added.code == 0, added.err
    assert added.out.count("new: square") == 3
    return folder


@pytest.fixture
def public(folder, monkeypatch):
    """The same, as the one that the package carries."""
    monkeypatch.setattr(recognition, "shipped", lambda sizes: Register(folder, sizes))


def test_a_graph_is_added_listed_recognised_and_checked(certpgo, folder, square):
    again = certpgo("optima", "--add", square, "--register", folder)
    assert again.out.count("unchanged: square") == 3
    listed = certpgo("optima", "--register", folder)
    assert "3 certified optima of 1 public graph" in listed.out
    assert listed.out.count("CERTIFIED") == 3
    shown = certpgo("optima", square, "--register", folder)
    assert shown.out.count("this is the public square") == 3
    assert "o/r@c:s.g2o" in shown.out
    one = certpgo("optima", square, "--register", folder, "--cost", "g2o", "--json").json
    assert [(o["cost"], o["is_exact"]) for o in one] == [("g2o", True)]
    # The files of datasets are searched, and the square is none.
    checked = certpgo("optima", "--verify", "--register", folder)
    assert checked.code == 0
    assert "2 graph not here" in checked.out
    assert {o["cost"] for o in certpgo("optima", "--json", "--register", folder).json} == COSTS


def test_a_graph_that_is_not_known_is_said_to_be(certpgo, folder, tmp_path):
    path = tmp_path / "other.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    done = certpgo("optima", path, "--register", folder)
    assert (done.code, done.out.count("\n")) == (0, 1)
    assert "not in the register" in done.out


def test_a_bad_proof_in_the_register_fails(certpgo, folder):
    (proof,) = folder.glob("proofs/square.chordal.cert")
    proof.write_bytes(b"")
    done = certpgo("optima", "--verify", "--register", folder)
    assert done.code == 6
    assert "REFUSED: square, chordal" in done.out
    rows = certpgo("optima", "--verify", "--register", folder, "--json").json
    assert {(row["cost"], row["result"]) for row in rows} >= {("chordal", "REFUSED")}


def test_an_estimate_is_judged_by_the_register_alone(certpgo, folder, square, tmp_path):
    poor = tmp_path / "poor.g2o"
    assert certpgo("solve", square, "--method", "spanning_tree", "-o", poor).code in (0, 3, 4)
    done = certpgo("optima", square, "--estimate", poor, "--register", folder, "--cost", "chordal")
    assert done.code == 0
    assert "This estimate is at most" in done.out
    # Submitted, it does not replace what is better; bounds under other costs differ by rounding.
    submitted = ("optima", "--add", square, "--estimate", poor, "--cost", "chordal")
    added = certpgo(*submitted, "--register", folder)
    assert "new" not in added.out
    assert "improved" not in added.out


def test_info_solve_certify_and_compare_recognise_it(certpgo, public, square, tmp_path):
    said = "this is the public square: the optimum of"
    assert certpgo("info", square).out.count(said) == 3
    assert {one["cost"] for one in certpgo("info", square, "--json").json["register"]} == COSTS
    out = tmp_path / "out.g2o"
    solved = certpgo("solve", square, "-o", out)
    assert f"{said} the cost of g2o is proven to be between" in solved.out
    certified = certpgo("certify", square, out, "--cost", "chordal")
    assert f"{said} F is proven to be between" in certified.out
    assert "this estimate is at most" in certified.out
    report = certpgo("certify", square, out, "--json").json["register"]
    assert (report["name"], report["cost"]) == ("square", "g2o")
    compared = certpgo("compare", square, "--methods", "certified", "-o", tmp_path / "compare")
    assert said.replace("this", "This", 1) in compared.out


@pytest.mark.parametrize(
    "options",
    [("--unit-weights",), ("--kappa", "3"), ("--tau", "3"), ("--weights-are", "covariance")],
    ids=" ".join,
)
def test_other_weights_are_not_recognised(certpgo, public, square, options):
    assert "public" not in certpgo("solve", square, "--cost", "chordal", *options).out
    assert "public" not in certpgo("info", square, *options).out


def test_other_measurements_are_not_recognised(certpgo, public, square, tmp_path):
    more = tmp_path / "more.g2o"
    more.write_text("EDGE_SE2 0 2 1 1 3.1 1 0 0 1 0 1\n")
    assert "public" not in certpgo("solve", square, "--also", more).out
    text = square.read_text() + "EDGE_BEARING 0 2 0.7 1\n"
    more.write_text(text + "EDGE_SE2 0 2 1 1 3.1 1 0 0 1 0 1\n")
    assert "public" not in certpgo("info", more, "--skip", "EDGE_BEARING").out
    assert "public" not in certpgo("info", square, "--rotations").out


def test_rejections_are_another_cost(certpgo, public, square, tmp_path):
    robust = certpgo("solve", square, "--robust", "-o", tmp_path / "out.g2o", "--json").json
    kept = robust["solution"]["kept"]
    assert (robust["register"] is None) == (kept is not None)
    csv = tmp_path / "rejected.csv"
    csv.write_text("edge,i,j\n0,0,1\n")
    done = certpgo(
        "certify", square, tmp_path / "out.g2o", "--cost", "chordal", "--rejected", csv, "--json"
    )
    assert done.json["register"] is None


MIXTURES = {
    "--add and --verify": ("--add", "--verify"),
    "--add needs a GRAPH": ("--add",),
    "--exact needs": ("--exact",),
    "--name needs --add": ("{g}", "--name", "x"),
    "--source needs --add": ("{g}", "--source", "x"),
    "--proof needs --add": ("{g}", "--proof", "x"),
    "without GRAPH": ("{g}", "--verify"),
    "--estimate needs a GRAPH": ("--estimate", "{g}"),
    "no such folder": ("--register", "nowhere"),
    "no such file or dataset": ("--add", "nowhere.g2o"),
    "not in the register of public graphs: --source says": ("--add", "{g}"),
    "OWNER/REPOSITORY@COMMIT:PATH expected": ("--add", "{g}", "--source", "here"),
    "without --cost": ("--verify", "--cost", "g2o"),
    "of its own": ("--add", "{g}", "--proof", "x", "--estimate", "{g}"),
}


@pytest.mark.parametrize("said", MIXTURES)
def test_mixtures_are_refused_in_one_line(certpgo, square, said):
    done = certpgo("optima", *(word.format(g=square) for word in MIXTURES[said]))
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert said in done.err


def test_a_malformed_register_is_refused_in_one_line(certpgo, folder, square):
    path = folder / register.FILE
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], json.dumps({"names": ["x"]})]) + "\n")
    for words in ((), (square,), ("--verify",), ("--add", square)):
        done = certpgo("optima", *words, "--register", folder)
        assert (done.code, done.err.count("\n")) == (1, 1)
        assert f"{register.FILE}:2: expected an optimum" in done.err
