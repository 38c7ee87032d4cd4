"""certpgo bounds: words on a terminal, radians in JSON."""

import json

import numpy as np
import pytest

from certpgo.graph import Estimate
from certpgo.io import write
from certpgo.io.datasets import synthetic

TWO_PARTS = """\
EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1
EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1
EDGE_SE2 5 6 1 0 0 1 0 0 1 0 1
"""


@pytest.fixture
def wound(tmp_path):
    """A cycle of 12 and an estimate that winds around it, as files."""
    instance, point = synthetic.winding_cycle(12, 0.7, 1)
    graph, estimate = tmp_path / "cycle.npz", tmp_path / "estimate.npz"
    write(graph, instance.graph)
    write(estimate, Estimate(point.rotations))
    return graph, estimate


def test_bounds_in_words(certpgo, wound):
    done = certpgo("bounds", wound[0])
    assert done.code == 0
    assert "of the best estimate found: CERTIFIED" in done.out
    for words in (
        "half a turn over the number of nodes",
        "15 deg",
        "not requested",
        "proven: this estimate is optimal",
    ):
        assert words in done.out


def test_bounds_of_a_g2o_file_name_their_cost(certpgo, square):
    """Its default cost is g2o's, which the bounds are not about."""
    done = certpgo("bounds", square)
    assert "about the chordal cost F, not the default cost of g2o" in done.err


def test_bounds_of_an_estimate_given(certpgo, wound):
    found = certpgo("bounds", *wound, "--json").json
    assert found["given"] is True
    assert found["verdict"] == "REFUTED"
    assert found["angles"] == "radians"
    by_key = {rung["key"]: rung for rung in found["bounds"]}
    assert by_key["cycle"]["value"] == pytest.approx(np.pi / 12)
    assert by_key["cycle"]["against"] == pytest.approx((0.7 + 2 * np.pi) / 12)
    assert by_key["sdp"]["value"] is None
    assert not any(rung["holds"] for rung in found["bounds"])


def test_a_program_too_large_for_memory_says_how_to_force_it(certpgo, wound, monkeypatch):
    monkeypatch.setattr("certpgo.optimize.methods._memory.available_bytes", lambda: 1000.0)
    refused = certpgo("bounds", wound[0], "--sdp", "--json").json["bounds"]
    [rung] = [rung for rung in refused if rung["key"] == "sdp"]
    assert rung["value"] is None
    assert rung["says"].endswith("bounds --force")
    forced = certpgo("bounds", wound[0], "--sdp", "--force", "--json").json["bounds"]
    [rung] = [rung for rung in forced if rung["key"] == "sdp"]
    assert rung["holds"] is True


def test_a_graph_that_is_not_connected_is_refused_or_taken_apart(certpgo, tmp_path):
    path = tmp_path / "parts.g2o"
    path.write_text(TWO_PARTS)
    done = certpgo("bounds", path)
    assert done.code == 1
    assert "--components" in done.err
    found = certpgo("bounds", path, "--components", "each", "--json").json
    assert len(found) == 2


def test_a_proof_by_cycles_is_written_and_checked(certpgo, square, tmp_path):
    proof = tmp_path / "square.cycles"
    done = certpgo("bounds", square, "--cycles", proof)
    assert done.code == 0
    assert "proven by cycles: the stationary" in done.out
    assert f"{proof}: PROVED: " in done.err
    checked = certpgo("check", square, proof)
    assert checked.out.startswith("PROVED: F(x) <= ")
    found = certpgo("check", square, proof, "--json").json
    assert (found["proved"], found["checked_in"], found["within"]) == (True, "fractions", [])
    assert "the graph comes first" in certpgo("check", proof, square).err
    document = json.loads(proof.read_text())
    document["cycles"][0][0][0] *= 10**9
    proof.write_text(json.dumps(document))
    assert certpgo("check", square, proof).code == 6
    assert certpgo("check", square, proof, "--json").json["proved"] is False


def test_cycles_in_json(certpgo, wound, square):
    found = certpgo("bounds", square, "--json").json["cycles"]
    assert found["proven"] is True
    assert found["reason"] == ""
    assert 0.0 < found["ratio"] < 1.0
    assert found["lower_bound"] > 0.0
    assert found["number"] == 1
    found = certpgo("bounds", *wound, "--json").json["cycles"]
    assert found["proven"] is False
    assert found["ratio"] > 1.0


@pytest.mark.parametrize(
    ("options", "line", "reason"),
    [
        (["--keep", "last"], "", "without --keep last"),
        ([], "EDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1\n", "without landmarks and priors"),
        ([], "LANDMARK2 0 7 1 0 1 0 1\n", "without landmarks and priors"),
    ],
)
def test_files_that_a_proof_by_cycles_is_not_about(
    certpgo, square, tmp_path, options, line, reason
):
    square.write_text(square.read_text() + line)
    done = certpgo("bounds", square, "--cycles", tmp_path / "proof", *options)
    assert done.code == 1
    assert reason in done.err
    assert not (tmp_path / "proof").exists()


def test_a_proof_by_cycles_of_an_archive_is_refused(certpgo, wound, tmp_path):
    done = certpgo("bounds", wound[0], "--cycles", tmp_path / "proof")
    assert (done.code, "not npz" in done.err) == (1, True)
