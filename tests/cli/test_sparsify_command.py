"""certpgo sparsify and suggest: loop closures chosen, and those that are missing."""

import json

import numpy as np
import pytest

import certpgo as package
from certpgo.io.datasets.synthetic import helix


@pytest.fixture
def path(tmp_path):
    """The g2o file of a helix."""
    path = tmp_path / "helix.g2o"
    package.write(path, helix(6, np.random.default_rng(0)))
    return path


def test_the_sparse_graph_is_written_with_its_estimate(certpgo, path, tmp_path):
    out = tmp_path / "sparse.g2o"
    done = certpgo("sparsify", path, "--keep", "25%", "-o", out)
    assert done.code == 0
    assert "loop closures kept; the sparse graph is CERTIFIED. " in done.out
    again = package.read(out)
    best = package.solve(again.graph)
    assert package.PoseProblem(again.graph).cost(again.initial) == pytest.approx(best.cost)
    data = json.loads(certpgo("sparsify", path, "--keep", "0.25", "--json").out)
    assert len(data["kept"]) == round(0.25 * data["loop_closures"])
    assert data["sparse"]["cost"] == pytest.approx(best.cost)
    assert data["connectivity"] <= data["connectivity_bound"]
    assert data["cost_of_all"] >= data["whole"]["lower_bound"]
    assert len(json.loads(certpgo("sparsify", path, "--keep", "7", "--json").out)["kept"]) == 7
    data = json.loads(certpgo("sparsify", path, "--keep", "7", "--by", "spectrum", "--json").out)
    assert (data["by"], len(data["kept"])) == ("spectrum", 7)
    assert certpgo("sparsify", path, "--keep", "7", "--by", "colour").code == 2


@pytest.mark.parametrize(
    ("keep", "message"),
    [
        ("x", "'x' is not a number, a fraction or a percentage"),
        ("150%", "the fraction of loop closures must be in"),
        ("100000", "loop closures can be kept, not 100000"),
    ],
)
def test_wrong_amounts_are_one_line(certpgo, path, keep, message):
    done = certpgo("sparsify", path, "--keep", keep)
    assert done.code in (1, 2)
    assert message in " ".join(done.err.replace("│", " ").split())
    assert "Traceback" not in done.err


def test_suggestions_name_the_nodes(certpgo, path):
    data = json.loads(certpgo("suggest", path, "-n", 3, "--json").out)
    values = [data["connectivity"], *(one["connectivity"] for one in data["suggested"])]
    assert len(values) == 4
    assert values == sorted(values)
    done = certpgo("suggest", path, "-n", 3)
    i, j = data["suggested"][0]["ids"]
    assert f"{i}-{j}" in done.out
    assert "3 loop closures would raise the connectivity" in done.out
    assert certpgo("suggest", path, "--within", "1e-9").code == 1


def test_distances_are_said_not_to_count(certpgo, tmp_path):
    graph = tmp_path / "beacon.pyfg"
    poses = [f"VERTEX_SE2 {i} A{i} {6 * i} 0 0" for i in range(4)]
    steps = [f"EDGE_SE2 {i} A{i} A{i + 1} 6 0 0 1 0 0 1 0 1" for i in range(3)]
    graph.write_text("\n".join([*poses, *steps, "EDGE_RANGE 1 A0 A3 16 1"]) + "\n")
    done = certpgo("suggest", graph, "-n", 1)
    assert done.code == 0
    assert "connectivity is that of relative poses, without 1 distance\n" in done.err
