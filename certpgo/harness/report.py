"""The report: every table and figure rendered from its records, and an index of what was found."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from certpgo import registry
from certpgo.errors import FormatError, InputError
from certpgo.harness import cells, citations, claims
from certpgo.harness.cells import Cell
from certpgo.harness.claims import Outcome
from certpgo.harness.figure import VIEWS, Data, Figure
from certpgo.harness.findings import our_number
from certpgo.harness.formats import csv, forms
from certpgo.harness.html.report import ClaimPart, FigurePart, TablePart, View, report_page
from certpgo.harness.index import index, summary
from certpgo.harness.records import Record, latest, read_records
from certpgo.harness.render import Section
from certpgo.harness.spec import Table
from certpgo.io.writing import folder_to_write, write_whole


@dataclass(frozen=True)
class TableResult:
    """A table with its records, and what they say of the paper.

    Attributes
    ----------
    records : the current ones, see `latest`; none where it was not run
    cells, claims : what became of the printed values and of the claims
    """

    table: Table
    records: tuple[Record, ...]
    cells: tuple[Cell, ...]
    claims: tuple[Outcome, ...]


@dataclass(frozen=True)
class FigureResult:
    """A figure with its document and drawing, or without where it was not made.

    Attributes
    ----------
    document : what stands in ``NAME.json``, or None
    drawing : the SVG's bytes, or None
    claims : what became of its claims
    """

    figure: Figure
    document: Data | None
    drawing: bytes | None
    claims: tuple[Outcome, ...]


@dataclass(frozen=True)
class Report:
    """Every table and figure of the checkout, in the order of their names."""

    tables: tuple[TableResult, ...]
    figures: tuple[FigureResult, ...]


def gather(results: Path) -> Report:
    """Read the results of a folder.

    Raises
    ------
    InputError
        There is no such folder, or nothing in it is of a table or figure.
    FormatError
        A file of results holds something else.
    """
    if not results.is_dir():
        raise InputError(f"{results}: no such folder; certpgo reproduce writes one")
    tables = tuple(_table(registry.get_table(n), results) for n in registry.table_names())
    figures = tuple(_figure(registry.get_figure(n), results) for n in registry.figure_names())
    if not any(t.records for t in tables) and not any(f.document for f in figures):
        raise InputError(f"{results}: no results; certpgo reproduce makes some")
    return Report(tables, figures)


def rendered(report: Report) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the report's files, the same bytes every time."""
    for result in report.tables:
        for form in forms().values() if result.records else ():
            text = form.render(result.table, result.records)
            yield f"{result.table.name}.{form.suffix}", text.encode()
    for drawn in report.figures:
        if drawn.drawing is not None:
            yield f"{drawn.figure.name}.svg", drawn.drawing
    sources = _sources()
    if sources:
        yield "sources.bib", sources
    yield "index.md", index(report.tables, report.figures).encode()


def write(report: Report, folder: Path) -> Path:
    """Write the report's files, each whole or not at all; returns the index's path.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    folder_to_write(folder)
    for name, content in rendered(report):
        write_whole(folder / name, content)
    return folder / "index.md"


def page(report: Report) -> str:
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
        View(view["title"], view["scene"])
        for figure in figures
        for view in figure.document["data"].get(VIEWS, ())
    ]
    said = [summary(report.tables, report.figures)]
    return report_page(tables, figures, summary=said, views=views)


def _differing(found: Iterable[Cell]) -> tuple[Section, ...]:
    rows = tuple(
        (c.row, c.method, c.metric, c.printed, our_number(c), c.found.value, c.reason)
        for c in found
        if c.found in (cells.Found.DIFFERS, cells.Found.BETTER)
    )
    header = ("row", "method", "metric", "printed", "ours", "found", "why they differ")
    return (Section("Published values that ours differ from", "", header, rows),) if rows else ()


def _claim_parts(outcomes: Iterable[Outcome]) -> list[ClaimPart]:
    return [ClaimPart(o.claim.text, o.found.value, o.told, o.claim.source) for o in outcomes]


def _table(table: Table, results: Path) -> TableResult:
    path = results / f"{table.name}.jsonl"
    records = tuple(latest(read_records(path))) if path.is_file() else ()
    return TableResult(table, records, cells.cells(table, records), claims.of_table(table, records))


def _figure(figure: Figure, results: Path) -> FigureResult:
    path, drawing = (results / f"{figure.name}.{suffix}" for suffix in ("json", "svg"))
    document = _document(path) if path.is_file() else None
    drawn = drawing.read_bytes() if drawing.is_file() else None
    data = None if document is None else document["data"]
    return FigureResult(figure, document, drawn, claims.of_figure(figure, data))


def _document(path: Path) -> Data:
    try:
        document: Data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        document = {}
    if not isinstance(document, Mapping) or not isinstance(document.get("data"), Mapping):
        raise FormatError(path, None, "a figure's record, as reproduce writes it")
    return document


def _sources() -> bytes:
    root = registry.checkout()
    path = None if root is None else root / citations.SOURCES
    return path.read_bytes() if path is not None and path.is_file() else b""
