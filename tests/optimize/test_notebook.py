"""A line below the cell of a notebook says how far a long search is, and is gone at its end."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import certpgo
from certpgo.io.datasets.synthetic import grid3d
from certpgo.optimize import notebook
from certpgo.optimize.monitor import silent


@pytest.fixture
def shown(monkeypatch):
    """What a kernel displays, in order."""
    lines = []

    def display(data, *, raw, display_id):
        assert raw
        assert display_id
        lines.append(data["text/plain"])
        return SimpleNamespace(update=lambda data, raw: lines.append(data["text/plain"]))

    kernel = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", kernel)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    return lines


@pytest.mark.parametrize("call", ["solve", "solve_robustly", "certify"])
def test_a_long_search_is_shown_and_the_line_is_removed(shown, monkeypatch, call):
    monkeypatch.setattr(notebook, "PATIENCE", 0.0)
    monkeypatch.setattr(notebook, "PACE", 0.0)
    made = grid3d(3, np.random.default_rng(0))
    more = (made.truth,) if call == "certify" else ()
    getattr(certpgo, call)(made, *more)
    assert len(shown) > 2
    assert shown[0].startswith("iteration 0: cost ")
    assert shown[-1] == ""


def test_a_short_search_and_a_given_monitor_show_nothing(shown):
    made = grid3d(3, np.random.default_rng(0))
    certpgo.solve(made)
    seen = []
    certpgo.solve(made, monitor=lambda iteration: bool(seen.append(iteration)))
    assert not shown
    assert seen


def test_elsewhere_nothing_is_shown(monkeypatch):
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    with notebook.watched(None) as monitor:
        assert monitor is silent
    monkeypatch.delitem(sys.modules, "IPython")
    assert not notebook.in_notebook()
