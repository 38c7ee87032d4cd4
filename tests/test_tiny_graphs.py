"""A sample of ``python reports/tiny_graphs.py``: only documented errors leave public functions."""

import runpy
from collections import Counter

import pytest

from certpgo import registry

pytest.importorskip("flint", reason="python-flint is not installed")

SCRIPT = registry.repository() / "reports" / "tiny_graphs.py"


@pytest.mark.parametrize("first", range(0, 500, 50))
def test_tiny_graphs_get_an_answer(first):
    outcomes = runpy.run_path(str(SCRIPT))["outcomes"]
    found = sum((outcomes(seed) for seed in range(first, first + 50)), Counter())
    assert [outcome for outcome in found if "FAILED" in outcome] == []
    assert found["solve: CERTIFIED"] + found["solve: BOUNDED"] >= 45
