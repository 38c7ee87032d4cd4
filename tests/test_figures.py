"""The figures of the reports, drawn into a folder of the test."""

import importlib.util
import sys
from pathlib import Path

import pytest

FIGURE = Path(__file__).parents[1] / "reports" / "figures" / "eriksson2018_figure1.py"


@pytest.fixture
def figure():
    spec = importlib.util.spec_from_file_location("figure1", FIGURE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["figure1"] = module  # where dataclasses look it up
    spec.loader.exec_module(module)
    yield module
    del sys.modules["figure1"]


@pytest.mark.parametrize("starts", ["0", "-3"])
def test_figure_1_refuses_to_start_nowhere(figure, tmp_path, starts, capsys):
    with pytest.raises(SystemExit) as ended:
        figure.main([str(tmp_path / "figure.svg"), "--starts", starts])
    assert ended.value.code == 2
    assert f"--starts must be at least 1, not {starts}" in capsys.readouterr().err


def test_figure_1_shows_three_minima_of_which_the_lowest_is_certified(figure, tmp_path):
    out = tmp_path / "figure.svg"
    found = figure.main([str(out), "--starts", "25"])
    verdicts = [minimum.certificate.verdict.value for minimum in found]
    assert verdicts == ["CERTIFIED", "REFUTED", "REFUTED"]
    costs = [minimum.cost for minimum in found]
    assert costs == sorted(costs)
    assert costs[1] > 2 * costs[0]
    first = out.read_bytes()
    assert first.startswith(b"<?xml")
    figure.draw(found, out)
    assert out.read_bytes() == first
