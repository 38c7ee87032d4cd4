"""What the command line says of methods that reject measurements."""

import numpy as np
import pytest

from certpgo.datasets import thesis
from certpgo.io import write


@pytest.fixture
def wrong(tmp_path):
    instance = thesis.langevin_graph(40, 8.0, 1.0, np.random.default_rng(1), outliers=0.1)
    path = tmp_path / "wrong.g2o"
    write(path, instance.graph)
    return path


def flat(text):
    """The text with its lines joined."""
    return " ".join(text.split())


def test_a_verdict_is_said_to_be_of_what_was_kept(certpgo, wrong):
    done = certpgo("solve", wrong, "--method", "adaptive_trimming")
    assert done.code == 0
    assert "measurements" in flat(done.out)
    assert "as if there were no others" in flat(done.out)
    assert "without --method" not in done.err
    report = certpgo("solve", wrong, "--method", "adaptive_trimming", "--json").json
    assert report["kept"] > 200
    assert report["certificate_of"] == "those kept"
    assert report["certificate"]["cost"] < 0.5 * report["cost"]
    assert certpgo("solve", wrong, "--method", "eigen_ra", "--json").json["kept"] is None


def test_no_proof_is_written_of_a_part_of_the_measurements(certpgo, wrong, tmp_path):
    proof = tmp_path / "p.npz"
    done = certpgo("solve", wrong, "--method", "adaptive_trimming", "--proof", proof)
    assert done.code == 6
    assert "no proof is written" in flat(done.err)
    assert not proof.exists()


def test_a_threshold_that_rejects_nothing_is_said(certpgo, wrong):
    done = certpgo("solve", wrong, "--method", "graduated_non_convexity", "--set", "scale=100")
    assert "set scale" in flat(done.out)
    assert "no measurement was rejected" in flat(done.out)
