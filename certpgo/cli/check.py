"""certpgo check: verify a proof file."""

from __future__ import annotations

import importlib
import math
import os
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._completion import graphs
from certpgo.cli._options import Data, Json
from certpgo.cli._proving import REFUSED
from certpgo.cli._show import document, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.checker import Answer
    from certpgo.integer_checker import Answer as InIntegers

EXAMPLES = (
    "certpgo check graph.g2o solution.cert",
    "certpgo check graph.g2o solution.cert --exact",
)
#: The checker is another process.
NUMERICS = False
#: What the checker's line begins with if it cannot read a file.
SAYS = "error: "
#: How it prints file names that are no UTF-8.
ANY_BYTES = "surrogateescape"


def command(
    graph: Annotated[
        str,
        typer.Argument(
            metavar="GRAPH", autocompletion=graphs, help="g2o or 1DSfM file, or dataset."
        ),
    ],
    proof: Annotated[Path, typer.Argument(metavar="PROOF", help="Proof file written by --proof.")],
    data: Data = None,
    exact: Annotated[
        bool,
        typer.Option(help="Check in integers alone, with certpgo/integer_checker.py."),
    ] = False,
    json: Json = False,
) -> int:
    """Verify a proof file with an independent checker, in doubles or in integers.

    Proofs by cycles (certpgo bounds --cycles) are checked in fractions.
    """
    from certpgo.cli._reading import Reading
    from certpgo.io.pipes import readable

    path = readable(Reading(data=data).resolve(graph).path())
    proof = readable(proof)
    if proof.is_dir():
        raise InputError(f"{proof}: a folder, not a proof file")
    if _begins(path) in PROOFS and proof.is_file() and _begins(proof) not in PROOFS:
        line = f"certpgo check {proof} {path}"
        raise InputError(f"{proof}: not a proof file; the graph comes first: {line}")
    name = _checker(proof, exact)
    if json:
        return _as_json(path, proof, name)
    program = Path(__file__).parents[1] / f"{name}.py"
    arguments = [sys.executable, str(program), str(path), str(proof)]
    with working(f"checking {proof}"):
        done = subprocess.run(
            arguments,
            env={**os.environ, "PYTHONIOENCODING": f"utf-8:{ANY_BYTES}"},
            capture_output=True,
            encoding="utf-8",
            errors=ANY_BYTES,
            check=False,
        )
    if done.stderr.startswith(SAYS):
        raise InputError(done.stderr.removeprefix(SAYS).strip())
    typer.echo(done.stdout, nl=False)
    typer.echo(done.stderr, nl=False, err=True)
    return done.returncode


#: First bytes of proof files: archives, and those by cycles, which are text.
PROOFS = (b"P", b"{")
#: The programs that check proofs, and in what they compute.
CHECKERS = {"checker": "doubles", "integer_checker": "integers", "cycle_checker": "fractions"}


def _checker(proof: Path, exact: bool) -> str:
    """The program for a proof file."""
    if _begins(proof) == b"{":
        return "cycle_checker"
    return "integer_checker" if exact else "checker"


def _begins(path: Path) -> bytes:
    """The first byte of a file; nothing of others."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(1)


def _as_json(path: Path, proof: Path, name: str) -> int:
    checker: Any = importlib.import_module(f"certpgo.{name}")
    files = {"graph": str(path), "proof": str(proof), "checked_in": CHECKERS[name]}
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
            "cost_upper": rounded(proven.upper, math.inf),
            "lower_bound": rounded(proven.lower, -math.inf),
            "relative_gap": rounded(proven.relative_gap, math.inf),
            "within": claims(proven),
        }
    )
    return 0


def claims(proven: Answer | InIntegers) -> list[dict[str, float | None]]:
    """What was claimed of distances and verified; null for every node, and for the world."""
    found = [claim._asdict() for claim in proven.within]
    return [{k: float(x) if isinstance(x, Decimal) else x for k, x in one.items()} for one in found]


def rounded(x: float | Fraction, toward: float) -> float:
    """The double next to a bound, on its safe side."""
    nearest = float(x)
    if nearest == x or (nearest > x) == (toward > 0.0):
        return nearest
    return math.nextafter(nearest, toward)
