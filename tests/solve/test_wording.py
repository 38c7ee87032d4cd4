"""Sentences about certificates: each says what was done, of this file and this estimate."""

from dataclasses import replace

import numpy as np
import pytest

from certpgo import Quadratic, certify, io
from certpgo.certify import Verdict
from certpgo.certify.wording import meaning, numbers, trusts
from certpgo.graph import Estimate
from certpgo.graph.phrases import reading_sentence

EDGES = ("EDGE_SE2 0 1 1 0 0.1", "EDGE_SE2 1 2 1 0 0.1", "EDGE_SE2 2 0 1 0 0.1")
INFORMATION = " 2 0 0 2 0 3"


def sentence(path, lines, **options):
    path.write_text("\n".join(lines) + "\n")
    return reading_sentence(io.read(path, quiet=True, **options).options)


def test_weights_are_the_files_only_where_it_has_some(tmp_path):
    path, informed = tmp_path / "graph.g2o", [edge + INFORMATION for edge in EDGES]
    of_file = "weights from the file's information matrices"
    added = "parallel edges added"
    assert sentence(path, informed) == f"{of_file}; {added}"
    assert sentence(path, [informed[0], *EDGES[1:]]) == f"{of_file}, 1 where it has none; {added}"
    none = f"weights 1: the file has no information; {added}"
    assert sentence(path, EDGES) == none
    stated = sentence(path, informed, weights_are="covariance")
    assert stated == f"weights from the file's covariances; {added}"
    ignored = f"all weights 1, ignoring those of the file; {added}"
    assert sentence(path, informed, unit_weights=True) == ignored
    assert sentence(path, EDGES, kappa=2.0, tau=3.0) == f"weights kappa=2.0,tau=3.0; {added}"
    # Kept where the graph is converted.
    io.write(tmp_path / "graph.npz", io.read(path, quiet=True))
    assert reading_sentence(io.read(tmp_path / "graph.npz", quiet=True).options) == none


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("EGs.txt", "0 1 1 0 0 0 1 0 0 0 1 1 0 0\n"),
        ("relative.txt", "a1.jpg a2.jpg 1 0 0 0 1 0 0\n"),
    ],
)
def test_formats_without_weights_ignore_none(tmp_path, name, text):
    said = sentence(tmp_path / name, [text])
    assert said == "weights 1: the file has no information; parallel edges added"


@pytest.fixture
def shifted(tmp_path):
    """A triangle, and its best rotations with other translations."""
    path = tmp_path / "graph.g2o"
    path.write_text("\n".join(edge + INFORMATION for edge in EDGES) + "\n")
    problem = Quadratic(io.read(path).graph)
    best = certify(problem, problem.complete(np.tile(np.eye(2), (3, 1, 1)))).refined
    return problem, Estimate(best.rotations, best.translations + np.eye(3, 2))


def test_without_descent_none_is_reported(shifted):
    problem, estimate = shifted
    for refine, word in ((True, "descent"), (False, "translations")):
        certificate = certify(problem, estimate, refine=refine)
        assert certificate.basin_is_global
        assert certificate.descended == refine
        said = [meaning(certificate), certificate.reason, *map(" ".join, numbers(certificate))]
        assert any(word in line for line in said)
        assert any("descent" in line for line in said) == refine


def test_numbers_name_their_cost(shifted):
    certificate = certify(*shifted)
    assert next(iter(numbers(certificate)))[1].endswith("(chordal cost F)")
    other = replace(certificate, objective="GTSAM's error")
    assert next(iter(numbers(other)))[1].endswith("(GTSAM's error)")
    assert dict(numbers(certificate, 0.5))["largest residual"].endswith(" degrees, 0.5 m")


def test_a_proof_rests_on_something_only_where_there_is_one(shifted):
    certificate = certify(*shifted)
    assert [name for name, _ in trusts(certificate)] == ["proof rests on"]
    assert not [*trusts(replace(certificate, verdict=Verdict.UNDECIDED))]
