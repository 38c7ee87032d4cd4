"""certpgo report: every table and figure from its records, and an index of what was found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.solve.comparison import MethodResult

#: Columns of a comparison as CSV.
CSV = (
    *("graph", "method", "objective", "cost", "f_ml", "gap", "relative_gap", "verdict"),
    *("distance_m", "distance_deg", "status", "note", "error"),
)
EXAMPLES = (
    "certpgo report",
    "certpgo report --results compare-results -o report",
)


def command(
    results: Annotated[
        Path | None,
        typer.Option("--results", metavar="DIR", help="Records; the checkout's by default."),
    ] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the rendered files.")
    ] = Path("report"),
    html: Annotated[
        Path | None, typer.Option("--html", metavar="OUT", help="Write it all as one page, too.")
    ] = None,
) -> None:
    """Render tables (Markdown, CSV, LaTeX), figures and an index, from records alone.

    Of a folder that compare wrote, its tables.
    """
    from certpgo import registry
    from certpgo.cli._outputs import Outputs
    from certpgo.io.writing import write_text
    from reports.harness.rendering.index import summary
    from reports.harness.rendering.publication import report_html, write_report
    from reports.harness.rendering.results import gather

    outputs, records = Outputs(html=html), results or registry.repository() / "reports" / "results"
    outputs.refuse(records)
    if (compared := _compared(records)) is not None:
        if html is not None:
            raise InputError("--html is a page of papers' tables: results of compare have none")
        _write(compared, out)
        return
    with working("reading the results"):
        report = gather(records)
        path = write_report(report, out)
        if html is not None:
            text = report_html(report)
            write_text(html, text)
    typer.echo(summary(report.tables, report.figures))
    notice(f"written to {path}, with the tables and figures in the same folder")


def _compared(records: Path) -> list[MethodResult] | None:
    """The results of a comparison, if compare wrote the folder."""
    from certpgo.solve.comparison import read_results

    path = records / "compare.jsonl"
    return read_results(path) if path.is_file() else None


def _write(results: list[MethodResult], out: Path) -> None:
    """Show the tables of a comparison, and write them."""
    import itertools

    from certpgo.cli._compared import FAILED, latex, markdown, section
    from certpgo.io.csv_files import write_csv
    from certpgo.io.writing import folder_to_write, write_text
    from certpgo.solve.comparison_table import OPTIONAL

    folder_to_write(out)
    for _, group in itertools.groupby(results, key=lambda result: (result.graph, result.nodes)):
        if (rows := list(group))[0].method:
            table(*section(rows, (FAILED, "by phase")), optional=OPTIONAL)
    for suffix, render in (("md", markdown), ("tex", latex)):
        write_text(out / f"compare.{suffix}", render(results))
    of_row = ([getattr(row, name) for name in CSV] for row in results)
    seconds = (sum(row.seconds.values()) for row in results)
    cells = ([*row, total] for row, total in zip(of_row, seconds, strict=True))
    write_csv(out / "compare.csv", [*CSV, "seconds"], cells)
    notice(f"written to {out / 'compare.md'}, and as .csv and .tex in the same folder")
