"""Figures on the command line."""

import json

import pytest

from certpgo import registry

FIGURE = """\
from reports.harness.experiments.absence import Absence, NotRun
from reports.harness.experiments.figure import Figure

def compute(quick, data):
    if data is not None:
        raise NotRun(Absence.NOT_HERE, "file not here")
    return {"height": 1 if quick else 2}

def draw(figure, record):
    figure.add_subplot().bar([0], [record["height"]])

FIGURE = Figure("paper_figure1", "A bar", "nobody", compute, draw, "{height} m", ("A note.",))
"""


@pytest.fixture(autouse=True)
def checkout(tmp_path, monkeypatch):
    (tmp_path / "baselines").mkdir()
    (tmp_path / "reports" / "figures").mkdir(parents=True)
    (tmp_path / "reports" / "figures" / "paper_figure1.py").write_text(FIGURE)
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path))


def test_reproduce_writes_a_figure_and_prints_its_caption(certpgo, tmp_path):
    done = certpgo("reproduce", "paper-figure1", "--out", tmp_path / "out")
    assert done.code == 0
    assert done.out == "A bar\n2 m\nA note.\n"
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["paper_figure1.json", "paper_figure1.svg"]
    kept = json.loads((tmp_path / "out" / "paper_figure1.json").read_text())
    assert (kept["figure"], kept["caption"], kept["data"]) == (
        "paper_figure1",
        "2 m",
        {"height": 2},
    )


def test_a_quick_figure_is_written_elsewhere(certpgo, tmp_path):
    done = certpgo("reproduce", "paper-figure1", "--quick", "--out", tmp_path / "out", "--json")
    assert done.json["data"] == {"height": 1}
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["quick"]


def test_a_figure_whose_file_is_not_here_says_so_and_writes_nothing(certpgo, tmp_path):
    done = certpgo("reproduce", "paper-figure1", "--out", tmp_path / "out", "--data", tmp_path)
    assert done.code == 1
    assert "not run: file not here" in done.err
    assert not (tmp_path / "out").exists()


def test_a_figure_has_no_seeds_to_choose(certpgo, tmp_path):
    done = certpgo("reproduce", "paper-figure1", "--seeds", "3", "--out", tmp_path / "out")
    assert done.code == 1
    assert "--seeds is for tables" in done.err


def test_figures_are_listed(certpgo):
    listed = certpgo("list", "figures", "--json").json
    assert listed == {"figures": [{"name": "paper_figure1", "title": "A bar"}]}


def test_a_wrong_name_is_completed(certpgo):
    done = certpgo("reproduce", "paper-figure2")
    assert done.code == 1
    assert "did you mean paper_figure1?" in done.err
