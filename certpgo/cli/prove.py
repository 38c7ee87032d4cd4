"""certpgo prove: graphs are solved, their proofs written and checked; for CI and commit hooks."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._completion import graphs as graphs_named
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import CostOption, Json, tier_for, time_limit_option
from certpgo.cli._outputs import Outputs, refuse_overwriting
from certpgo.cli._proving import REFUSED
from certpgo.cli._rules import Rule
from certpgo.cli._show import document, notice, outlasting_reader, working
from certpgo.cli.check import claims, rounded
from certpgo.errors import (
    CertPGOError,
    InputError,
    NoEdges,
    NumericalError,
    require_numbers,
)

if TYPE_CHECKING:
    from certpgo.checker import Answer
    from certpgo.solve.prove_files import Attempt

EXAMPLES = (
    "certpgo prove graph.g2o",
    "certpgo prove maps/*.g2o -o proofs --badge proven.svg",
    "certpgo prove graph.g2o --within 0.05m,0.2deg",
)
#: A badge: width of both halves, the label, and the message with its colour.
_BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="190" height="20"
role="img" aria-label="{0}"><title>{0}</title><rect width="90" height="20" fill="#555"/>
<rect x="90" width="100" height="20" fill="{2}"/>
<g fill="#fff" text-anchor="middle" font-family="Verdana,sans-serif" font-size="11">
<text x="45" y="14">pose graphs</text><text x="140" y="14">{1}</text></g></svg>
"""
_GOOD, _BAD = "#2e7d32", "#b71c1c"
RULES = (Rule("--reference needs --within", "reference", without="within"),)
_Distance = tuple[float | None, float | None]
#: Units of --within, and the numbers that they are of.
_UNITS = {"m": "metres", "deg": "degrees"}


def _distance(text: str) -> _Distance:
    """Metres and degrees, as of ``0.05m,0.2deg``; None where nothing is said."""
    found: dict[str, float] = {}
    try:
        for part in text.split(","):
            number, unit = re.findall(r"(.+?)(m|deg)$", part)[0]
            found[_UNITS[unit]] = float(number)
        require_numbers(**found)
    except (IndexError, ValueError, InputError):
        wanted = "--within: metres, degrees up to 180 or both expected, as in 0.05m,0.2deg"
        raise InputError(f"{wanted}, not {text}") from None
    return found.get("metres"), found.get("degrees")


@tells_unwritten("badge")
def command(
    graphs: Annotated[
        list[str],
        typer.Argument(metavar="GRAPH...", autocompletion=graphs_named, help="Files of graphs."),
    ],
    cost: CostOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="DIR", help="Folder that keeps the proofs, each by its path."
        ),
    ] = None,
    badge: Annotated[
        Path | None,
        typer.Option("--badge", metavar="SVG", help="Write how many are proven as a picture."),
    ] = None,
    within: Annotated[
        str | None,
        typer.Option(
            "--within",
            metavar="0.05m[,0.2deg]",
            help="Prove, too, that every node is this near to where any optimum has it: in metres, "
            "degrees, or both.",
        ),
    ] = None,
    reference: Annotated[
        int | None,
        typer.Option(
            "--reference",
            metavar="NODE",
            show_default="the pose whose measurements weigh most",
            help="Pose, by its id, from which --within is seen.",
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        time_limit_option("For each graph: stop the search.", "30 s after a first bound"),
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, metavar="N", help="Processes, a graph each.")
    ] = 1,
    json: Json = False,
) -> int:
    """Solve graphs, prove how good each answer is, and check the proofs.

    A line a graph. Files of estimates are skipped. The exit code is 0 if every answer is CERTIFIED
    and its proof accepted, with what --within demands, 1 if a file cannot be read or no proof can
    be about it, else 6.
    """
    from certpgo.io.writing import write_text
    from certpgo.solve.many import results_of
    from certpgo.solve.processes import processes
    from certpgo.solve.prove_files import attempt

    tier_for(Path(), None, cost)
    distance = None if within is None else _distance(within)
    how: dict[str, Any] = {"cost": cost, "within": distance, "reference": reference}
    work = partial(attempt, time_limit=time_limit, **how)
    found: dict[str, str | Answer] = {}
    unread = False
    with ExitStack() as stack:
        if out is not None:
            stack.enter_context(outlasting_reader())
        folder = out or Path(stack.enter_context(TemporaryDirectory()))
        proofs = _proofs(graphs, folder)
        refuse_overwriting(proofs.values(), *map(Path, graphs))
        Outputs(scene=badge).refuse(*map(Path, graphs))
        attempts: Iterator[Attempt] = map(work, proofs.items())
        if workers > 1:
            pool = stack.enter_context(processes(workers))
            attempts = results_of(work, proofs.items(), workers, pool)
        for name in proofs:
            with working(f"proving {name}"):
                proven, notices = next(attempts)
            for sentence in notices:
                notice(f"{name}: {sentence}")
            if isinstance(proven, NoEdges):
                notice(f"{name}: no measurements; skipped")
                continue
            unread |= isinstance(proven, InputError)
            found[name] = _in_words(name, proven) if isinstance(proven, CertPGOError) else proven
            if not json:
                also = getattr(found[name], "within", ())
                typer.echo(f"{name}: {'; '.join(map(str, [found[name], *also]))}")
    good = sum(not isinstance(said, str) for said in found.values())
    if badge is not None:
        said = f"{good} of {len(found)} proven"
        text = _BADGE.format(f"pose graphs: {said}", said, _GOOD if good == len(found) else _BAD)
        write_text(badge, text)
    if json:
        document({name: _as_json(said) for name, said in found.items()})
    return 0 if good == len(found) else 1 if unread else REFUSED


def _proofs(graphs: Sequence[str], folder: Path) -> dict[str, Path]:
    """The file of each proof: below the folder, where the graph is below this one.

    Raises
    ------
    InputError
        Two graphs would have one.
    """
    proofs, owners = dict[str, Path](), dict[Path, Path]()
    for graph in graphs:
        path, here = Path(os.path.abspath(graph)), Path.cwd()
        within = path.relative_to(here if path.is_relative_to(here) else path.anchor)
        proof = folder / within.with_name(f"{within.name}.cert")
        if (owner := owners.setdefault(proof, path)) != path:
            raise InputError(f"{graph}: its proof would be {proof}, as that of {owner}")
        proofs[graph] = proof
    return proofs


def _in_words(name: str, error: CertPGOError) -> str:
    """Why there is no proof, after the graph's name and a colon."""
    if isinstance(error, NumericalError):
        return f"NOT PROVED: {error}"
    return f"ERROR: {str(error).removeprefix(f'{name}: ')}"


def _as_json(said: str | Answer) -> dict[str, object]:
    if isinstance(said, str):
        return {"proved": False, "reason": said}
    return {
        "proved": True,
        "about": said.about,
        "cost_upper": rounded(said.upper, math.inf),
        "lower_bound": rounded(said.lower, -math.inf),
        "relative_gap": rounded(said.relative_gap, math.inf),
        "within": claims(said),
    }
