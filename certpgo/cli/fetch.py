"""certpgo fetch: download named datasets."""

from __future__ import annotations

from typing import Annotated

import typer

from certpgo.cli._completion import datasets as datasets_named
from certpgo.cli._options import Data, Json
from certpgo.cli._show import document, working

EXAMPLES = ("certpgo fetch sphere2500",)
NUMERICS = False


def command(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME", autocompletion=datasets_named, help="Names from certpgo list datasets."
        ),
    ],
    data: Data = None,
    json: Json = False,
) -> None:
    """Find or download datasets, verify their checksums, and print their paths."""
    from certpgo.io import datasets

    for name in names:
        datasets.entry(name)  # report unknown names before any download
    paths = {}
    for name in names:
        with working(f"fetching {name}"):
            paths[name] = str(datasets.fetch(name, data))
        if not json:
            typer.echo(paths[name])
    if json:
        document(paths)
