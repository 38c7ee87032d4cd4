"""A sample of `reports.studies.tiny_graphs`: only documented errors leave public functions."""

from collections import Counter

import pytest

pytest.importorskip("flint", reason="python-flint is not installed")


def test_tiny_graphs_get_an_answer():
    from reports.studies.tiny_graphs import outcomes

    found = sum((outcomes(seed) for seed in range(200, 225)), Counter())
    assert [outcome for outcome in found if "FAILED" in outcome] == []
    assert found["solve: CERTIFIED"] + found["solve: BOUNDED"] >= 22
