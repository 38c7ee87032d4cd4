"""certpgo reproduce: a paper's table, our numbers beside the printed ones, or figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import document, notice, working
from certpgo.cli._tables import run_table
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.harness.figure import Figure


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="See list tables, list figures.")],
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, help="Instances a synthetic row stands for.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The small profile only.")] = False,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("reproduce-results"),
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder to look in first.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Run a table of a paper and say which printed numbers ours agree with, or draw a figure."""
    from certpgo import registry
    from certpgo.harness.figure import Figure

    spec = registry.get_report(name)
    # A quick run is no result of the report, and must not pass for one.
    folder = out / "quick" if quick else out
    if not isinstance(spec, Figure):
        return run_table(spec, folder, data=data, seeds=seeds, quick=quick, json=json)
    if seeds is not None:
        raise InputError(f"--seeds is for tables; the seeds of {spec.name} are fixed")
    return _draw_figure(spec, folder, data=data, quick=quick, json=json)


def _draw_figure(
    figure: Figure, folder: Path, *, data: Path | None, quick: bool, json: bool
) -> int:
    from certpgo.harness.figure import computed, publish
    from certpgo.harness.figure import document as record_of

    with working(figure.title):
        record = computed(figure, quick=quick, data=data)
        path = publish(figure, record, folder)
    if json:
        document(record_of(figure, record))
        return 0
    typer.echo(figure.title)
    for sentence in (figure.captioned(record), *figure.notes):
        typer.echo(sentence)
    notice(f"written to {path} and {path.stem}.json beside it")
    return 0
