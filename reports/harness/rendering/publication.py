"""The report: every table and figure rendered from its records, and an index of what was found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from certpgo import registry
from certpgo.io.writing import folder_to_write, write_whole
from reports.harness.experiments.claim_outcomes import ClaimOutcome
from reports.harness.experiments.figure import VIEWS
from reports.harness.rendering import cells, citations, items
from reports.harness.rendering.cells import Cell
from reports.harness.rendering.findings import DIFFERING, differing
from reports.harness.rendering.formats import csv, forms
from reports.harness.rendering.index import OPENING, headline, index, summary
from reports.harness.rendering.render import Section
from reports.harness.rendering.report_page import (
    ClaimPart,
    FigurePart,
    SceneView,
    TablePart,
    report_page,
)
from reports.harness.rendering.results import Report


def report_files(report: Report) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the report's files, the same bytes every time."""
    for result in report.tables:
        for form in forms().values() if result.records else ():
            text = form.render(result.table, result.records)
            yield f"{result.table.name}.{form.suffix}", text.encode()
    for drawn in report.figures:
        if drawn.drawing is not None:
            yield f"{drawn.figure.name}.svg", drawn.drawing
    if numbered := items.items(report.tables, report.figures):
        yield "items.md", items.page(numbered).encode()
    sources = _sources()
    if sources:
        yield "sources.bib", sources
    yield "index.md", index(report.tables, report.figures).encode()


def write_report(report: Report, folder: Path) -> Path:
    """Write the report's files, each whole or not at all; returns the index's path.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    folder_to_write(folder)
    for name, content in report_files(report):
        write_whole(folder / name, content)
    return folder / "index.md"


def report_html(report: Report) -> str:
    """The report as one HTML page, the same bytes every time."""
    tables = [
        TablePart(
            result.table,
            result.records,
            csv=csv.FORM.render(result.table, result.records) if result.records else "",
            bibtex=citations.citation(result.table.published or result.table.name),
            claims=_claim_parts(result.claims),
            cells={kind.value: n for kind, n in cells.tally(result.cells).items() if n},
            findings=_differing(result.cells),
        )
        for result in report.tables
    ]
    figures = [
        FigurePart(
            result.document,
            result.drawing.decode(),
            bibtex=citations.citation(result.figure.name),
            claims=_claim_parts(result.claims),
        )
        for result in report.figures
        if result.document is not None and result.drawing is not None
    ]
    views = [
        SceneView(view["title"], view["scene"])
        for figure in figures
        for view in figure.document["data"].get(VIEWS, ())
    ]
    said = [summary(report.tables, report.figures)]
    return report_page(
        tables,
        figures,
        summary=said,
        headline=headline(report.tables, report.figures),
        opening=OPENING,
        views=views,
    )


def _differing(found: Iterable[Cell]) -> tuple[Section, ...]:
    rows = differing(found)
    title = "Published values that ours differ from"
    return (Section(title, "", DIFFERING, rows),) if rows else ()


def _claim_parts(outcomes: Iterable[ClaimOutcome]) -> list[ClaimPart]:
    return [ClaimPart(o.claim.text, o.found.value, o.in_full, o.claim.source) for o in outcomes]


def _sources() -> bytes:
    root = registry.checkout()
    path = None if root is None else root / citations.SOURCES
    return path.read_bytes() if path is not None and path.is_file() else b""
