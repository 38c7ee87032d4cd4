"""certpgo solve --regions, and the proven distance of its answer."""

import csv
import re

import numpy as np
import pytest
from features import having

import certpgo as package
from certpgo.io.datasets import synthetic


def lines_of(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_regions_of_all_nodes(certpgo, square, tmp_path):
    out = tmp_path / "r.csv"
    done = certpgo("solve", square, "--regions", out, "--reference", "1", "--level", "0.9")
    assert done.code == 0
    assert f"regions: {out}, seen from node 1, at a level of 0.9" in done.out
    assert "of every optimum" in done.out
    header, *rows = lines_of(out)
    assert header == ["id", "metres", "degrees"]
    expected = package.solve(package.read(square)).regions(1, level=0.9)
    found = np.array(rows, dtype=float)
    assert found[:, 0].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found[:, 1], expected.metres, rtol=1e-6)
    np.testing.assert_allclose(found[:, 2], expected.degrees, rtol=1e-6)


@pytest.mark.parametrize("method", [("--method", "newton"), ("--robust",)])
def test_other_methods(certpgo, square, tmp_path, method):
    out = tmp_path / "r.csv"
    done = certpgo("solve", square, "--regions", out, "--json", *method)
    assert done.json["distance_m"] > 0.0
    assert done.json["distance_deg"] > 0.0
    assert len(lines_of(out)) == 5


def test_rotations_have_no_metres(certpgo, tmp_path):
    instance, _ = synthetic.winding_cycle(6, 0.3, 0)
    path, out = tmp_path / "cycle.g2o", tmp_path / "r.csv"
    package.write(path, instance)
    done = certpgo("solve", path, "--regions", out, "--level", "1e-9")
    rows = lines_of(out)[1:]
    assert [metres for _, metres, _ in rows] == 6 * [""]
    assert max(float(degrees) for *_, degrees in rows) > 0.0
    assert re.search(r"proven distance +within \d\S* degrees of every optimum", done.out)


def test_where_none_are_written(certpgo, square, tmp_path):
    out = tmp_path / "r.csv"
    scaled = tmp_path / "scaled.npz"
    package.write(scaled, having("scales"))
    for given, said in (
        ((square, "--level", "0.9"), "--level needs --regions"),
        ((square, "--regions", out, "--level", "2"), "a level lies between 0 and 1"),
        ((square, "--reference", "99"), "--reference: node 99 is none of the poses"),
        ((square, "--regions", square), "is also an input"),
        ((scaled, "--regions", out), "--regions do not take"),
        ((square, "--regions", out, "--method", "newton", "--no-certify"), "--regions needs a"),
    ):
        done = certpgo("solve", *given)
        assert done.code == 1
        assert said in done.err
        assert not out.exists()
    ranged = tmp_path / "ranged.npz"
    package.write(ranged, having("distances"))
    done = certpgo("solve", ranged, "--regions", out, "--time-limit", "0")
    assert done.code != 0
    assert "no regions are written" in done.err
    assert not out.exists()
