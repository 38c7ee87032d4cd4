"""Every equation, algorithm, table and figure of both papers, and how ours compare.

What a paper numbers is a line of ``reports/published/items/PAPER.csv``. Of a table or figure that
is reproduced the outcome is that of its values and claims; of others it is stated there.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from certpgo import registry
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments.claim_outcomes import ClaimStatus
from reports.harness.rendering import cells
from reports.harness.rendering.cells import CellStatus
from reports.harness.rendering.findings import in_words
from reports.harness.rendering.results import FigureResult, TableResult

FOLDER = "reports/published/items"
#: Titles of the columns of `rows`.
HEADER = ("item", "what", "outcome", "here", "remark")
OPENING = """\
Every equation, algorithm, table and figure of both papers, in the order of their numbers. An
equation is *right* where the file that is named computes or tests it as printed, and *differs,
explained* where the print has a slip, which the notes on the two papers state. Of tables and
figures that are reproduced the outcome is the worst of their values and claims."""


class ItemStatus(StrEnum):
    """How an item compares, the best first."""

    RIGHT = "right"
    EXPLAINED = "differs, explained"
    UNEXPLAINED = "differs, unexplained"
    NOT_HERE = "not here"


@dataclass(frozen=True)
class Item:
    """What a paper numbers.

    Attributes
    ----------
    paper : as its file is called
    name : such as ``"equation 4.11"``
    what : in a few words
    outcome : how it compares; None of a table or figure that is reproduced, until that is known
    here : the file that computes or tests it, or the name of the table or figure; empty for none
    remark : what differs, or why it is not here
    """

    paper: str
    name: str
    what: str
    outcome: ItemStatus | None
    here: str
    remark: str


def stated() -> tuple[Item, ...]:
    """The items as the files state them; none without a checkout that has them."""
    root = registry.checkout()
    paths = () if root is None else sorted((root / FOLDER).glob("*.csv"))
    return tuple(
        Item(
            path.stem,
            line["item"],
            line["what"],
            ItemStatus(line["outcome"]) if line["outcome"] else None,
            line["here"],
            line["remark"],
        )
        for path in paths
        for line in csv.DictReader(path.read_text(encoding="utf-8").splitlines())
    )


def items(tables: Iterable[TableResult], figures: Iterable[FigureResult]) -> tuple[Item, ...]:
    """The items, those of tables and figures with the outcomes of their results."""
    of_tables = {result.table.name: result for result in tables}
    of_figures = {result.figure.name: result for result in figures}
    decided = []
    for item in stated():
        if (table := of_tables.get(item.here)) is not None:
            decided.append(_of_table(item, table))
        elif (figure := of_figures.get(item.here)) is not None:
            decided.append(_of_figure(item, figure))
        else:
            decided.append(item)
    return tuple(decided)


def _of_table(item: Item, result: TableResult) -> Item:
    counts = cells.tally(result.cells)
    outcome = ItemStatus.NOT_HERE
    if counts[CellStatus.UNEXPLAINED]:
        outcome = ItemStatus.UNEXPLAINED
    elif counts[CellStatus.EXPLAINED]:
        outcome = ItemStatus.EXPLAINED
    elif counts[CellStatus.REPRODUCED] + counts[CellStatus.AMONG]:
        outcome = ItemStatus.RIGHT
    return replace(item, outcome=outcome, remark=_joined(in_words(result.cells), item.remark))


def _of_figure(item: Item, result: FigureResult) -> Item:
    if result.drawing is None:
        return replace(item, outcome=ItemStatus.NOT_HERE, remark=_joined("not drawn", item.remark))
    differing = [o for o in result.claims if o.found is ClaimStatus.DIFFERS]
    outcome = ItemStatus.RIGHT
    if differing:
        remarked = all(o.claim.remark for o in differing)
        outcome = ItemStatus.EXPLAINED if remarked else ItemStatus.UNEXPLAINED
    held = sum(o.found is ClaimStatus.HOLDS for o in result.claims)
    of_claims = f"{held} of {held + len(differing)} claims hold" if result.claims else "drawn"
    return replace(item, outcome=outcome, remark=_joined(of_claims, item.remark))


def _joined(*said: str) -> str:
    return "; ".join(part.rstrip(".") for part in said if part)


def counts(found: Iterable[Item]) -> str:
    """How many items have each outcome."""
    tally = Counter(item.outcome for item in found)
    return ", ".join(f"{tally[outcome]} {outcome.value}" for outcome in ItemStatus)


def rows(found: Iterable[Item]) -> list[tuple[str, ...]]:
    """Lines of a table, see `HEADER`."""
    return [(item.name, item.what, item.outcome or "", item.here, item.remark) for item in found]


def page(found: Sequence[Item]) -> str:
    """The items as Markdown, paper by paper."""
    lines = ["# Item by item", "", OPENING, ""]
    for paper in dict.fromkeys(item.paper for item in found):
        of_paper = [item for item in found if item.paper == paper]
        lines += [f"## {paper}", "", f"{counts(of_paper)}.", ""]
        lines += [*markdown_table(HEADER, rows(of_paper)), ""]
    return "\n".join(lines)
