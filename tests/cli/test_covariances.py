"""certpgo solve --covariances."""

import csv

import numpy as np
import pytest

import certpgo as package
from certpgo.io.datasets import synthetic


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
    assert "no folder" in done.err
    done = certpgo("solve", square, "--covariances", square)
    assert done.code == 1
    assert "is also an input" in done.err
    two = tmp_path / "two.g2o"
    two.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 0 0 1 0 1\n")
    done = certpgo("solve", two, "--components", "each", "--covariances", tmp_path / "c.csv")
    assert done.code == 1
    assert "--covariances needs a connected graph" in done.err


LANDMARKS = """\
EDGE_SE2 0 1 1 0 1.57 100 0 0 100 0 100
EDGE_SE2 1 2 1 0 1.58 100 0 0 100 0 100
EDGE_SE2_XY 0 7 2 1 25 0 25
EDGE_SE2_XY 1 7 1 -1 25 0 25
EDGE_SE2_XY 2 7 0 -1 25 0 25
"""


@pytest.mark.parametrize("method", [(), ("--cost", "chordal"), ("--robust",)])
def test_landmarks(certpgo, tmp_path, method):
    path, out = tmp_path / "seen.g2o", tmp_path / "c.csv"
    path.write_text(LANDMARKS)
    done = certpgo("solve", path, "--covariances", out, *method)
    assert done.code == 0
    assert "in each pose's frame, and of points in the world's, with node 0 fixed" in done.out
    header, *rows = lines_of(out)
    assert header == ["id", "x_x", "x_y", "x_theta", "y_y", "y_theta", "theta_theta"]
    assert [row[0] for row in rows] == ["0", "1", "2", "7"]
    seen = rows[-1]
    assert [bool(cell) for cell in seen[1:]] == [True, True, False, True, False, False]
    if method != ("--robust",):
        cost = None if not method else "chordal"
        answer = package.solve(package.read(path, quiet=True), cost=cost)
        # In the frame of the written estimate, whose first pose is the identity.
        marginals = package.Marginals(answer.problem, answer.estimate.anchored(0))
        expected = marginals.covariance(3)[*np.triu_indices(2)]
        found = np.array([seen[1], seen[2], seen[4]], dtype=float)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
