"""The papers item by item: nothing that they number is left out, and every outcome has its file."""

import os
import re
from pathlib import Path

import pytest

from certpgo import registry
from reports.harness.experiments import scan
from reports.harness.rendering import items
from reports.harness.rendering.items import ItemStatus
from reports.harness.rendering.results import gather

ROOT = registry.repository()
STATED = items.stated()
#: The papers' text, and how their equations are numbered.
PAPERS = {
    "eriksson2018": ("eriksson2018_strong_duality.txt", r"\((\d+[ab]?)\)[\s$]*$"),
    "moreira2020": ("moreira2020_thesis.txt", r"\(((?:[2-5]|[AB])\.\d+[ab]?)\)"),
}
#: In the first paper numbers in brackets up to here are equations, when one line ends with them.
LAST = 47
STATEMENTS = (
    r"^((?:Algorithm|Conjecture|Corollary|Definition|Hypothesis|Lemma|Proposition|Theorem)"
    r" [A-Z\d.]*\d)"
)
CAPTIONS = r"((?:Table|Figure) (?:[1-5A-D]\.)?\d+):"


def numbered(paper):
    """What the text of a paper numbers."""
    file, equations = PAPERS[paper]
    path = Path(os.environ.get("CERTPGO_DATA", ".")).parent / "papers" / file
    if not path.is_file():
        pytest.skip(f"no {file} in a folder papers beside that of the data")
    text = path.read_text(encoding="utf-8").replace("**", "").replace("*", "")
    if paper == "eriksson2018":
        found = re.findall(equations, text, re.MULTILINE)
        found = [number for number in found if int(number.rstrip("ab")) <= LAST]
    else:
        found = re.findall(equations, text)
    names = {f"equation {number}" for number in found}
    names |= {*re.findall(STATEMENTS, text, re.MULTILINE), *re.findall(CAPTIONS, text)}
    return names


@pytest.mark.parametrize("paper", PAPERS)
def test_nothing_that_a_paper_numbers_is_left_out(paper):
    known = {item.name for item in STATED if item.paper == paper}
    assert len(known) == sum(item.paper == paper for item in STATED)
    assert numbered(paper) - known == set()


def test_every_outcome_is_of_a_file_or_says_why_there_is_none():
    reproduced = {*scan.table_names(), *scan.figure_names()}
    for item in STATED:
        if item.outcome is None:
            assert item.here in reproduced, item
        elif item.outcome is ItemStatus.NOT_HERE:
            assert item.remark
        else:
            assert (ROOT / item.here).is_file(), item
            assert item.remark or item.outcome is ItemStatus.RIGHT, item


def test_every_table_and_figure_of_the_papers_is_an_item():
    here = {item.here for item in STATED}
    of_papers = [
        name
        for name in (*scan.table_names(), *scan.figure_names())
        if name.startswith(tuple(PAPERS)) and not name.endswith("_ratios")
    ]
    assert set(of_papers) <= here


def test_items_take_the_outcomes_of_the_committed_results():
    report = gather(ROOT / "reports" / "results")
    found = items.items(report.tables, report.figures)
    assert all(item.outcome is not None and (item.remark or item.here) for item in found)
    outcomes = {item.name: item.outcome for item in found if item.paper == "moreira2020"}
    assert outcomes["Table 5.4"] is ItemStatus.UNEXPLAINED
    assert outcomes["Figure 3.1"] is ItemStatus.EXPLAINED
    assert outcomes["equation 4.11"] is ItemStatus.RIGHT
    assert outcomes["Figure 5.5"] is ItemStatus.NOT_HERE
    text = items.page(found)
    assert "| equation 4.11 | translations as a null space | right |" in text
    assert (ROOT / "reports/results/items.md").read_text(encoding="utf-8") == text
