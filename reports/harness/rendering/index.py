"""The report's first page: what was reproduced, in numbers, and where to find it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from certpgo.graph.phrases import counted
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments import claim_outcomes
from reports.harness.experiments.claim_outcomes import ClaimOutcome
from reports.harness.experiments.spec import Table
from reports.harness.rendering import cells
from reports.harness.rendering.cells import Cell, CellStatus
from reports.harness.rendering.citations import citation
from reports.harness.rendering.findings import among, different
from reports.harness.rendering.items import counts, items
from reports.harness.rendering.results import FigureResult, TableResult

#: Figures that the page opens with.
OPENING = ("gallery_trajectories", "gallery_zoo", "gallery_bounds")
#: The groups of printed values that are added up, and whether a cell of a table is in it.
GROUPS: Mapping[str, Callable[[Table, Cell], bool]] = {
    "the two papers, of their own methods": lambda table, cell: table.paper and not cell.of_other,
    "the two papers, of other programs": lambda table, cell: table.paper and cell.of_other,
    "other sources": lambda table, cell: not table.paper,
}
OWN = next(iter(GROUPS))
RULES = """\
Rendered by `certpgo report`, a pure function of the records; it also writes each table as CSV and
LaTeX.

Each statistic has one rule, the same in every table:

- **A single number** of ours reproduces a printed one when it rounds to the printed digits.
- **A mean** over seeds is compared where the paper prints a mean: it reproduces what rounds to the
  same digits or lies within two of its standard errors, each at most half of it.
- **A median** over seeds is compared where the paper prints one number and does not say of how many
  draws: it reproduces what rounds to the same digits. Another printed value that lies between our
  lowest and highest draw is *among our draws*: it may be a single draw like ours. No more is known
  of it, and it does not count as reproduced.

A value that differs is *explained* only by a cause that an experiment here shows, on the page that
is named; otherwise it is *unexplained*, with what was tried. Better means that lower or higher
numbers are better, and ours is; it does not count as reproduced either. Where several of our
readings correspond to one value, the best outcome counts, and of equal ones the nearest; each table
names the reading.

The headline counts what Moreira 2020 and Eriksson et al. 2018 print of their own methods. What they
print of other programs is counted apart, and so are the tables of other sources: certified_factors
(SE-Sync's costs) and own_cost (a prototype's). Every value is counted, whether or not it could be
run, except times and what says what a row is of: for times the claimed order is checked, among the
claims. Where a claim names no tolerance, the one in its sentence is ours."""


def index(tables: Sequence[TableResult], figures: Sequence[FigureResult]) -> str:
    """The page as Markdown."""
    lines = ["# Tables and figures: the papers' numbers and ours", ""]
    lines += [f"**{summary(tables, figures)}**", "", *_opening(figures)]
    if any(getattr(r, "profile", "") == "quick" for t in tables for r in t.records):
        lines += ["**Results of the quick profile: of a part of the rows alone.**", ""]
    if numbered := items(tables, figures):
        lines += ["## Item by item", "", f"Of {counted(len(numbered), 'item{s}')} that the papers "]
        lines[-1] += "number (equations, statements, algorithms, tables and figures) "
        lines[-1] += f"{counts(numbered)}: [the list](items.md)."
        lines += [""]
    lines += ["## Claims", "", *_claims(tables, figures), ""]
    lines += ["## Printed values by table", "", *_by_table(tables), ""]
    for found in (CellStatus.EXPLAINED, CellStatus.UNEXPLAINED):
        lines += [f"## Printed values: {found.value}", "", *_reasons(tables, found), ""]
    lines += ["## Tables", "", *_tables(tables), ""]
    lines += ["## Figures", "", *_figures(figures), ""]
    lines += ["## How values are counted", "", RULES, ""]
    lines += ["## Printed values not run", "", *_reasons(tables, CellStatus.NOT_RUN), ""]
    lines += ["## Environment", "", *_environment(tables, figures), ""]
    return "\n".join(lines)


def summary(tables: Sequence[TableResult], figures: Sequence[FigureResult]) -> str:
    """The outcomes of the papers' printed values and claims, in a few sentences."""
    found = _of_group(tables, OWN)
    outcomes = [outcome for _, about in _named(tables, figures) for outcome in about]
    open_ = cells.tally(found)[CellStatus.NOT_RUN], _tally(outcomes)[2]
    values, claims = counted(open_[0], "printed value{s}"), counted(open_[1], "claim{s}")
    return f"{_of_cells(found)} {_of_claims(outcomes)} Not run: {values} and {claims}."


def headline(
    tables: Sequence[TableResult], figures: Sequence[FigureResult]
) -> list[tuple[str, str, str]]:
    """The outcomes in numbers, with their names and what they mean."""
    counts = cells.tally(_of_group(tables, OWN))
    held, differ, _ = _tally([o for _, about in _named(tables, figures) for o in about])
    return [
        (
            "printed values",
            f"{counts[CellStatus.REPRODUCED]} of {_ran(counts)}",
            "of the papers' own methods that were run are reproduced",
        ),
        ("claims", f"{held} of {held + differ}", "that were tried hold"),
    ]


def _opening(figures: Sequence[FigureResult]) -> Iterator[str]:
    """The pictures that the page opens with, where they were made."""
    made = {result.figure.name: result for result in figures if result.drawing is not None}
    for name in OPENING:
        if name in made:
            yield f"![{made[name].figure.title}]({name}.svg)"
            yield ""


def _of_group(tables: Iterable[TableResult], name: str) -> list[Cell]:
    is_in = GROUPS[name]
    return [cell for result in tables for cell in result.cells if is_in(result.table, cell)]


def _ran(counts: Mapping[CellStatus, int]) -> int:
    return sum(counts.values()) - counts[CellStatus.NOT_RUN]


def _of_cells(found: Sequence[Cell]) -> str:
    counts = cells.tally(found)
    reproduced, ran = counts[CellStatus.REPRODUCED], _ran(counts)
    share = f" ({100 * reproduced / ran:.0f} %)" if ran else ""
    return (
        f"Of {counted(ran, 'value{s}')} that the papers print of their own methods and that were "
        f"run, {reproduced} are reproduced{share}, {among(counts)}"
        f"{counts[CellStatus.BETTER]} better, {different(counts)}."
    )


def _of_claims(outcomes: Sequence[ClaimOutcome]) -> str:
    held, differ, _ = _tally(outcomes)
    return f"Of {counted(held + differ, 'claim{s}')} tried, {held} hold and {differ} differ."


def _tally(outcomes: Iterable[ClaimOutcome]) -> tuple[int, int, int]:
    found = [outcome.found for outcome in outcomes]
    holds, differs, not_run = (found.count(kind) for kind in claim_outcomes.ClaimStatus)
    return holds, differs, not_run


def _by_table(tables: Sequence[TableResult]) -> list[str]:
    rows = [
        (_link(result), *_numbers(cells.tally(result.cells))) for result in tables if result.cells
    ]
    rows += [(f"all of {name}", *_numbers(cells.tally(_of_group(tables, name)))) for name in GROUPS]
    return markdown_table(("table", "printed", *(kind.value for kind in CellStatus)), rows)


def _numbers(counts: Mapping[CellStatus, int]) -> tuple[str, ...]:
    return str(sum(counts.values())), *(str(count) for count in counts.values())


def _reasons(tables: Iterable[TableResult], found: CellStatus) -> list[str]:
    """Why values differ or were not run, or what was tried, and how many of each table."""
    counts = Counter(
        (result.table.name, cell.reason or "nothing was tried")
        for result in tables
        for cell in result.cells
        if cell.found is found
    )
    rows = [(name, str(count), reason) for (name, reason), count in counts.items()]
    said = "what was tried" if found is CellStatus.UNEXPLAINED else "because"
    return markdown_table(("table", "values", said), rows) if rows else ["None."]


def _claims(tables: Iterable[TableResult], figures: Iterable[FigureResult]) -> list[str]:
    rows = [
        (name, outcome.claim.text, outcome.claim.source, outcome.in_full)
        for name, outcomes in _named(tables, figures)
        for outcome in outcomes
    ]
    return markdown_table(("of", "claim", "where", "found"), rows) if rows else ["None."]


def _named(
    tables: Iterable[TableResult], figures: Iterable[FigureResult]
) -> Iterator[tuple[str, tuple[ClaimOutcome, ...]]]:
    yield from ((result.table.name, result.claims) for result in tables)
    yield from ((result.figure.name, result.claims) for result in figures)


def _tables(tables: Iterable[TableResult]) -> list[str]:
    rows = []
    for result in tables:
        file = f"[Markdown]({result.table.name}.md)" if result.records else "not run"
        cited = result.table.published or result.table.name
        rows.append((result.table.name, result.table.title, file, _cite(cited)))
    return markdown_table(("table", "title", "file", "cite"), rows)


def _figures(figures: Iterable[FigureResult]) -> list[str]:
    rows = []
    for result in figures:
        name = result.figure.name
        file = "not made" if result.drawing is None else f"[SVG]({name}.svg)"
        rows.append((name, result.figure.title, file, _cite(name)))
    return markdown_table(("figure", "title", "file", "cite"), rows)


def _cite(name: str) -> str:
    return f"`{name.partition('_')[0]}` in [sources.bib](sources.bib)" if citation(name) else ""


def _link(result: TableResult) -> str:
    name = result.table.name
    return f"[{name}]({name}.md)" if result.records else name


def _environment(tables: Iterable[TableResult], figures: Iterable[FigureResult]) -> Iterator[str]:
    origins = [r.provenance for t in tables for r in t.records if r.provenance]
    origins += [f.document.get("provenance", {}) for f in figures if f.document is not None]
    for key in sorted({key for origin in origins for key in origin}):
        values = dict.fromkeys(sorted(str(origin[key]) for origin in origins if key in origin))
        if key == "date" and len(values) > 1:
            first, *_, last = values
            yield f"- {key}: {first} to {last}"
        else:
            yield f"- {key}: {' | '.join(values)}"
