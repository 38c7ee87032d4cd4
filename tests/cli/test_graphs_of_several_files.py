"""Commands that read several files as one graph."""

import pytest

A = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5 100 0 0 100 0 400
"""
B = """VERTEX_SE2 2 2 0 1.5
VERTEX_SE2 3 2 1 3
EDGE_SE2 2 3 1 0 1.5 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5 100 0 0 100 0 400
EDGE_SE2 3 0 2 1 -3 100 0 0 100 0 400
"""


@pytest.fixture
def files(tmp_path):
    """Two robots' files, which share a measurement."""
    for name, text in (("a.g2o", A), ("b.g2o", B)):
        (tmp_path / name).write_text(text)
    return tmp_path / "a.g2o", tmp_path / "b.g2o"


def test_commands_take_several_files(certpgo, files, tmp_path):
    run, (a, b) = certpgo, files
    out = tmp_path / "out.g2o"
    solved = run("solve", a, b, "--json", "-o", out)
    assert solved.code == 0
    assert run("info", a, b, "--json").json["edges"] == 4
    judged = run("certify", a, out, "--also", b, "--json").json
    assert judged["cost"] == pytest.approx(solved.json["cost"], rel=1e-9)
    refused = run("solve", a, b, "--proof", tmp_path / "x.cert")
    assert "a proof is about one file: certpgo convert with --also writes one" in refused.err
    assert "is also an input" in run("solve", a, b, "-o", b).err
    assert run("convert", a, tmp_path / "one.g2o", "--also", b).code == 0
    one = run("solve", tmp_path / "one.g2o", "--json").json
    assert one["cost"] == pytest.approx(solved.json["cost"], rel=1e-9)
