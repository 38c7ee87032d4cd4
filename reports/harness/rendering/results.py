"""Results of tables and figures, read from a folder with what they say of the papers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from certpgo.errors import FormatError, InputError
from reports.harness.experiments import claim_outcomes, scan
from reports.harness.experiments.claim_outcomes import ClaimOutcome
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.journal import latest, read_entries
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table
from reports.harness.rendering import cells
from reports.harness.rendering.cells import Cell


@dataclass(frozen=True)
class TableResult:
    """A table with its records, and what they say of the paper.

    Attributes
    ----------
    records : the current ones, see `latest`; none where it was not run
    cells, claims : the outcomes of the printed values and of the claims
    """

    table: Table
    records: tuple[Record, ...]
    cells: tuple[Cell, ...]
    claims: tuple[ClaimOutcome, ...]


@dataclass(frozen=True)
class FigureResult:
    """A figure with its document and drawing, or without where it was not made.

    Attributes
    ----------
    document : the content of ``NAME.json``, or None
    drawing : the SVG's bytes, or None
    claims : the outcomes of its claims
    """

    figure: Figure
    document: Data | None
    drawing: bytes | None
    claims: tuple[ClaimOutcome, ...]


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
    tables = tuple(_table(scan.get_table(n), results) for n in scan.table_names())
    figures = tuple(_figure(scan.get_figure(n), results) for n in scan.figure_names())
    if not any(t.records for t in tables) and not any(f.document for f in figures):
        raise InputError(f"{results}: no results; certpgo reproduce makes some")
    return Report(tables, figures)


def _table(table: Table, results: Path) -> TableResult:
    path = results / f"{table.name}.jsonl"
    records = tuple(latest(read_entries(path, Record))) if path.is_file() else ()
    return TableResult(
        table, records, cells.cells(table, records), claim_outcomes.of_table(table, records)
    )


def _figure(figure: Figure, results: Path) -> FigureResult:
    path, drawing = (results / f"{figure.name}.{suffix}" for suffix in ("json", "svg"))
    document = _document(path) if path.is_file() else None
    drawn = drawing.read_bytes() if drawing.is_file() else None
    data = None if document is None else document["data"]
    return FigureResult(figure, document, drawn, claim_outcomes.of_figure(figure, data))


def _document(path: Path) -> Data:
    try:
        document: Data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        document = {}
    if not isinstance(document, Mapping) or not isinstance(document.get("data"), Mapping):
        raise FormatError(path, None, "a figure's record, as reproduce writes it")
    return document
