"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document.")]
Data = Annotated[
    Path | None, typer.Option("--data", metavar="DIR", help="Folder to look for datasets in first.")
]
ProofOut = Annotated[
    Path | None,
    typer.Option("--proof", metavar="OUT", help="Write a proof that certpgo check verifies."),
]
HtmlOut = Annotated[
    Path | None,
    typer.Option("--html", metavar="OUT", help="Write a page about the estimate, with a 3D view."),
]
Timestamps = Annotated[
    str, typer.Option("--timestamps", help="Of a TUM file: ids, index, or a file of seconds.")
]
