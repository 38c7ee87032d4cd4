"""certpgo solve --covariances."""

import csv

import numpy as np
import pytest

import certpgo as package
from certpgo.datasets import synthetic


def lines_of(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_poses_in_the_plane(certpgo, square, tmp_path):
    out = tmp_path / "c.csv"
    done = certpgo("solve", square, "--covariances", out)
    assert done.code == 0
    assert f"covariances: {out}, in each node's frame, with node 0 fixed" in done.out
    header, *rows = lines_of(out)
    assert header == ["id", "x_x", "x_y", "x_theta", "y_y", "y_theta", "theta_theta"]
    expected = package.solve(package.read(square)).marginals.covariances
    found = np.array(rows, dtype=float)
    assert found[:, 0].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found[:, 1:], expected[:, *np.triu_indices(3)], rtol=1e-9)


@pytest.mark.parametrize("method", [(), ("--method", "newton"), ("--robust",)])
def test_other_methods_and_costs(certpgo, square, tmp_path, method):
    out = tmp_path / "c.csv"
    done = certpgo("solve", square, "--covariances", out, "--json", *method)
    assert done.json
    assert len(lines_of(out)) == 5


def test_rotations(certpgo, tmp_path):
    instance, _ = synthetic.winding_cycle(6, 0.3, 0)
    path, out = tmp_path / "cycle.g2o", tmp_path / "c.csv"
    package.write(path, instance)
    certpgo("solve", path, "--covariances", out)
    assert lines_of(out)[0] == ["id", "rx_rx", "rx_ry", "rx_rz", "ry_ry", "ry_rz", "rz_rz"]


def test_where_none_are_written(certpgo, square, tmp_path):
    done = certpgo("solve", square, "--covariances", tmp_path / "missing" / "c.csv")
    assert done.code == 1
    assert "no such folder" in done.err
    done = certpgo("solve", square, "--covariances", square)
    assert done.code == 1
    assert "is also an input" in done.err
    two = tmp_path / "two.g2o"
    two.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 0 0 1 0 1\n")
    done = certpgo("solve", two, "--components", "each", "--covariances", tmp_path / "c.csv")
    assert done.code == 1
    assert "--covariances needs a connected graph" in done.err
