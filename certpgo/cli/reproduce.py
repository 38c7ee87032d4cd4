"""certpgo reproduce: a paper's table, our numbers beside the printed ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from certpgo.cli._tables import run_table


def command(
    name: Annotated[str, typer.Argument(metavar="TABLE", help="See list tables.")],
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, help="Instances a synthetic row stands for.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The smallest rows only.")] = False,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("reproduce-results"),
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder to look in first.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Run a table of a paper and say which printed numbers ours agree with."""
    from certpgo import registry

    # A quick run is no result of the table, and must not pass for one.
    folder = out / "quick" if quick else out
    return run_table(
        registry.get_table(name), folder, data=data, seeds=seeds, quick=quick, json=json
    )
