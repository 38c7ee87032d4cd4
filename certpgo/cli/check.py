"""certpgo check: verify a proof file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from certpgo.cli._options import Data, Json
from certpgo.cli._proving import REFUSED
from certpgo.cli._show import document, working
from certpgo.errors import InputError

#: What the checker's line begins with if it cannot read a file.
SAYS = "error: "


def command(
    graph: Annotated[str, typer.Argument(metavar="GRAPH", help="g2o or 1DSfM file, or dataset.")],
    proof: Annotated[Path, typer.Argument(metavar="PROOF", help="Proof file written by --proof.")],
    data: Data = None,
    json: Json = False,
) -> int:
    """Verify a proof file with the independent checker, certpgo/checker.py."""
    from certpgo.cli._reading import Reading

    path = Reading(data=data).resolve(graph).path()
    if json:
        return _as_json(path, proof)
    program = Path(__file__).parents[1] / "checker.py"
    arguments = [sys.executable, str(program), str(path), str(proof)]
    with working(f"checking {proof}"):
        done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.stderr.startswith(SAYS):
        raise InputError(done.stderr.removeprefix(SAYS).strip())
    typer.echo(done.stdout, nl=False)
    typer.echo(done.stderr, nl=False, err=True)
    return done.returncode


def _as_json(path: Path, proof: Path) -> int:
    from certpgo import checker

    files = {"graph": str(path), "proof": str(proof)}
    try:
        proven = checker.check(path, proof)
    except checker.Unreadable as error:
        raise InputError(str(error)) from None
    except checker.Refused as reason:
        document({**files, "proved": False, "reason": str(reason)})
        return REFUSED
    document(
        {
            **files,
            "proved": True,
            "about": proven.about,
            "cost_upper": proven.upper,
            "lower_bound": proven.lower,
            "relative_gap": proven.relative_gap,
        }
    )
    return 0
