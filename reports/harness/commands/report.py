"""certpgo report: every table and figure from its records, and an index of what was found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from certpgo.cli._show import notice, working

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
    """Render tables (Markdown, CSV, LaTeX), figures and an index, from records alone."""
    from certpgo import registry
    from certpgo.cli._outputs import Outputs
    from certpgo.io.writing import write_text
    from reports.harness.rendering.index import summary
    from reports.harness.rendering.publication import report_html, write_report
    from reports.harness.rendering.results import gather

    outputs, records = Outputs(html=html), results or registry.repository() / "reports" / "results"
    outputs.refuse(records)
    with working("reading the results"):
        report = gather(records)
        path = write_report(report, out)
        if html is not None:
            text = report_html(report)
            write_text(html, text)
    typer.echo(summary(report.tables, report.figures))
    notice(f"written to {path}, with the tables and figures in the same folder")
