"""A file of the checkout that cannot be used is named, and everything else goes on."""

import pytest

REQUIRED = """
from dataclasses import dataclass

from certpgo.optimize.methods.spanning_tree import SpanningTree

@dataclass(frozen=True, kw_only=True)
class Demanding(SpanningTree):
    \"\"\"A tree with a setting.\"\"\"

    alpha: float

SOLVER = Demanding
"""


@pytest.fixture
def checkout(small_checkout, tmp_path):
    """A checkout with a method that cannot be loaded and one whose setting has no default."""
    folder = tmp_path / "checkout"
    (folder / "baselines" / "broken.py").write_text("1 / 0\n")
    (folder / "baselines" / "demanding.py").write_text(REQUIRED)
    (folder / "reports" / "tables" / "torn.py").write_text("TABLE = (\n")
    return folder


def test_lists_go_on(certpgo, checkout):
    done = certpgo("list", "methods", "tables", "--json")
    assert done.code == 0, done.err
    methods = {row["name"]: row for row in done.json["methods"]}
    said = f"{checkout}/baselines/broken.py: cannot be loaded: ZeroDivisionError: division by zero"
    assert (methods["broken"]["here"], methods["broken"]["what"]) == ("no", said)
    assert methods["mischief"]["here"] == "yes"
    assert methods["demanding"]["settings"].endswith("alpha")
    tables = {row["name"]: row["title"] for row in done.json["tables"]}
    assert tables["cycles"] == "Cycles"
    assert tables["torn"].startswith(f"{checkout}/reports/tables/torn.py: cannot be loaded: Syntax")
    assert certpgo("list").code == 0


def test_a_method_that_cannot_be_loaded_is_one_line(certpgo, checkout, square):
    done = certpgo("solve", square, "--method", "broken")
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert f"{checkout}/baselines/broken.py: cannot be loaded" in done.err
    assert certpgo("solve", square, "--method", "mischief").code in (0, 3)


def test_a_setting_without_a_default_is_asked_for(certpgo, checkout, square):
    done = certpgo("solve", square, "--method", "demanding")
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert f"{checkout}/baselines/demanding.py: demanding's setting alpha" in done.err
    assert "--set alpha=VALUE" in done.err
    assert certpgo("solve", square, "--method", "demanding", "--set", "alpha=2").code in (0, 3)


def test_an_annotation_that_does_not_resolve_is_one_line(certpgo, checkout, square):
    path = checkout / "baselines" / "demanding.py"
    path.write_text("from __future__ import annotations\n" + REQUIRED.replace("float", "Flaot"))
    done = certpgo("solve", square, "--method", "demanding", "--set", "alpha=2")
    assert (done.code, done.err.count("\n")) == (1, 1)
    assert "demanding.py: cannot be loaded: NameError" in done.err


def test_every_report_but_the_broken_one_is_run(certpgo, checkout, tmp_path):
    out = tmp_path / "results"
    done = certpgo("reproduce", "--all", "--quick", "--out", out)
    assert done.code == 0, done.err
    assert f"torn: {checkout}/reports/tables/torn.py: cannot be loaded: SyntaxError" in done.err
    assert "cycles: " in done.out
