"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

GraphName = Annotated[
    str,
    typer.Argument(metavar="GRAPH", help="Graph file, or dataset name (certpgo list datasets)."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Data = Annotated[
    Path | None, typer.Option("--data", metavar="DIR", help="Folder to search for datasets first.")
]
ProofOut = Annotated[
    Path | None,
    typer.Option("--proof", metavar="OUT", help="Write a proof file for certpgo check."),
]
HtmlOut = Annotated[
    Path | None,
    typer.Option("--html", metavar="OUT", help="Write an HTML page with plots and a 3D view."),
]
Timestamps = Annotated[
    str,
    typer.Option(
        "--timestamps",
        metavar="ids|index|FILE",
        help="TUM timestamps are node ids, ignored (index), or matched with the times in FILE.",
    ),
]


def tier_option(default: str) -> Any:
    """The option --tier of a command with this default."""
    return typer.Option(
        "--tier",
        metavar="screen|standard|proof",
        show_default=default,
        help="Rigor: screen ignores rounding (no proof), standard bounds it, and proof relies on "
        "IEEE 754 arithmetic only.",
    )
