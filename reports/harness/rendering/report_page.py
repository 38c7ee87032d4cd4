"""The report as one page: every table and figure, what they claim, and what made them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from certpgo.graph.phrases import counted
from certpgo.view.charts import Curve, Lines, lines
from certpgo.view.page import data_uri, page
from reports.harness.experiments.figure import DARK
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table
from reports.harness.rendering.render import Section, notes, sections


@dataclass(frozen=True)
class ClaimPart:
    """A claim and its outcome.

    Attributes
    ----------
    text : the sentence
    found : ``"holds"``, ``"differs"`` or ``"not run"``
    said : the same in more words; empty for none
    source : where it is made, or empty
    """

    text: str
    found: str
    said: str = ""
    source: str = ""


@dataclass(frozen=True)
class TablePart:
    """A table and its results.

    Attributes
    ----------
    table, records : the specification, and every record of it that counts
    csv : its text as a CSV file; empty for none
    bibtex : the entries of its sources; empty for none
    claims : of its source
    cells : how many published cells came to what, such as ``{"reproduced": 3, "differs": 1}``
    findings : what else is to be said of these cells, such as those that differ, and why
    """

    table: Table
    records: Sequence[Record]
    csv: str = ""
    bibtex: str = ""
    claims: Sequence[ClaimPart] = ()
    cells: Mapping[str, int] = field(default_factory=dict)
    findings: Sequence[Section] = ()


@dataclass(frozen=True)
class FigurePart:
    """A figure and its results.

    Attributes
    ----------
    document : what ``NAME.json`` holds, see `reports.harness.experiments.figure.document`
    svg : what ``NAME.svg`` holds
    bibtex, claims : as of tables
    """

    document: Mapping[str, Any]
    svg: str
    bibtex: str = ""
    claims: Sequence[ClaimPart] = ()


@dataclass(frozen=True)
class SceneView:
    """A trajectory to look at: its title, and what `certpgo.view.page_scene.page_scene` made."""

    title: str
    scene: Mapping[str, Any]


def report_page(
    tables: Sequence[TablePart],
    figures: Sequence[FigurePart],
    *,
    title: str = "Tables and figures reproduced by certpgo",
    summary: Sequence[str] = (),
    headline: Sequence[tuple[str, str, str]] = (),
    opening: Sequence[str] = (),
    views: Sequence[SceneView] = (),
    environment: Mapping[str, str] | None = None,
) -> str:
    """The report, one HTML file; the same bytes for the same arguments.

    Parameters
    ----------
    summary : sentences at the top; by default, the outcomes of the claims
    headline : the numbers above them: their names, values, and what they mean
    opening : figures that come first, by name, with the views; the others follow the tables
    environment : what made the page; by default, what made the first results that say so
    """
    shown = [_table(results) for results in tables]
    drawn = [_figure(results) for results in figures]
    made = [part["environment"] for part in (*shown, *drawn) if part["environment"]]
    return page(
        "report.html",
        title=title,
        summary=summary or [*_claims_said([*tables, *figures])],
        headline=headline,
        index=[*shown, *drawn],
        tables=shown,
        opening=[part for name in opening for part in drawn if part["name"] == name],
        figures=[part for part in drawn if part["name"] not in opening],
        views=views,
        environment=dict(environment or (made[0] if made else {})),
    )


def _table(results: TablePart) -> dict[str, Any]:
    table, records = results.table, results.records
    return {
        "name": table.name,
        "anchor": table.name,
        "title": table.title,
        "source": table.source,
        "results": _results(records),
        "sections": sections(table, records),
        "notes": notes(table, records),
        "claims": results.claims,
        "cells": ", ".join(f"{count:,} {name}" for name, count in results.cells.items()),
        "findings": results.findings,
        "charts": _charts(records),
        "csv": data_uri(results.csv, "text/csv") if results.csv else "",
        "bibtex": results.bibtex,
        "environment": dict(records[0].provenance) if records else {},
    }


def _results(records: Sequence[Record]) -> str:
    if not records:
        return "not run"
    failed = sum(bool(record.absence) for record in records)
    said = counted(len(records), "record{s}")
    return f"{said}, {failed} not run or failed" if failed else said


def _figure(results: FigurePart) -> dict[str, Any]:
    document = results.document
    return {
        "name": document["figure"],
        "anchor": document["figure"],
        "title": document["title"],
        "results": "drawn",
        "caption": document["caption"],
        "notes": document["notes"],
        "claims": results.claims,
        "svg": inlined(results.svg, document["figure"], document["title"]),
        "csv": "",
        "bibtex": results.bibtex,
        "environment": document.get("provenance", {}),
    }


def _claims_said(parts: Sequence[TablePart | FigurePart]) -> Iterable[str]:
    outcomes = [claim.found for part in parts for claim in part.claims]
    if outcomes:
        counts = {name: outcomes.count(name) for name in dict.fromkeys(outcomes)}
        said = ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))
        yield f"Claims: {said}."


def _charts(records: Iterable[Record]) -> list[Lines]:
    """Cost over time of what each row's methods did, and gap where a bound was proven."""
    rows: dict[str, list[Record]] = {}
    for record in records:
        if len(record.trace) > 1:
            rows.setdefault(record.part or record.row, []).append(record)
    drawn = []
    for row, traced in rows.items():
        bounds = [b for r in traced if (b := r.metrics.get("lower_bound")) is not None]
        drawn.append(lines(f"{row}: cost F", "seconds", [_curve(r) for r in traced]))
        gaps = [_curve(r, above=max(bounds)) for r in traced] if bounds else []
        title = f"{row}: cost F above the best proven bound"
        drawn.append(lines(title, "seconds", gaps, logarithmic=True))
    return [chart for chart in drawn if chart is not None]


def _curve(record: Record, above: float = 0.0) -> Curve:
    seconds, costs = zip(*record.trace, strict=True)
    return Curve(record.method, seconds, [cost - above for cost in costs])


def inlined(svg: str, name: str, title: str) -> Markup:
    """A drawing of Matplotlib as part of a page: its ids and styles stay its own."""
    prefix = re.sub(r"\W", "-", name)
    body = svg[svg.index("<svg") :].replace(DARK, "")  # the page has a theme of its own
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r'\bid="([^"]*)"', rf'id="{prefix}-\1"', body)
    body = re.sub(r'\bxlink:href="#', f'xlink:href="#{prefix}-', body)
    body = body.replace("url(#", f"url(#{prefix}-")
    body = body.replace(">*{", f">#{prefix}-drawing *{{")
    label = Markup('<svg id="{}-drawing" role="img" aria-label="{}"').format(prefix, title)
    return label + Markup(body.removeprefix("<svg"))
