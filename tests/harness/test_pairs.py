"""A sample of `reports.studies.pairs`: cells are what they are said to be, and faults are seen."""

import pytest

from reports.studies.pairs import asking
from reports.studies.pairs.__main__ import asked, table
from reports.studies.pairs.asking import Answer, Asked, answered
from reports.studies.pairs.graphs import KINDS, NOTHING

CELLS = {
    "certified": [
        (("distances",), "outliers", ""),
        (("distances", "landmarks"), "robust follow", "g2o"),
        (("directions",), "solve", ""),
        (("held nodes",), "proof", ""),
    ],
    "refused": [(("relative poses",), "robust proof", "g2o")],
}


@pytest.mark.parametrize(
    ("how", "cell"), [(how, cell) for how, cells in CELLS.items() for cell in cells]
)
def test_cells_are_answered_or_refused(how, cell, tmp_path):
    kinds, operation, cost = cell
    found = answered(Asked("sample", kinds, operation, cost), tmp_path, 0)
    assert found.how == how, found.said
    assert bool(found.said) is (how == "refused")


def test_what_ends_without_an_answer_is_broken(tmp_path, monkeypatch):
    def fails(words):
        raise ZeroDivisionError("no answer")

    monkeypatch.setattr(asking, "main", fails)
    found = answered(Asked("sample", ("relative poses",), "solve"), tmp_path, 0)
    assert (found.how, "no answer" in found.said) == ("broken", True)


def test_every_pair_is_asked_once_and_counted():
    cells = list(asked())
    assert len(set(cells)) == len(cells)
    of_kinds = [cell for cell in cells if cell.group == "kind and kind"]
    others = len(KINDS) - 1
    pairs = [pair for pair in NOTHING if len(pair) == 2]
    assert len(of_kinds) == others * (others - 1) // 2 - len(pairs)
    hows = ("refused" if k % 4 == 0 else "certified" for k in range(len(cells)))
    found = [(cell, Answer(how)) for cell, how in zip(cells, hows, strict=True)]
    [whole] = [line for line in table(found) if line.startswith("| all ")]
    assert f"| {len(cells)} |" in whole
    assert "25." in whole
