"""certpgo fetch: download named datasets."""

from __future__ import annotations

from typing import Annotated

import typer

from certpgo.cli._options import Data, Json
from certpgo.cli._show import document, working


def command(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="See list datasets.")],
    data: Data = None,
    json: Json = False,
) -> None:
    """Find or download datasets, check their checksums, and print where they are."""
    from certpgo import datasets

    for name in names:
        datasets.entry(name)  # an unknown name is said before anything is downloaded
    paths = {}
    for name in names:
        with working(f"fetching {name}"):
            paths[name] = str(datasets.fetch(name, data))
        if not json:
            typer.echo(paths[name])
    if json:
        document(paths)
