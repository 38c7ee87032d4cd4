"""certpgo prove: graphs are solved, their proofs written and checked; for CI and commit hooks."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._options import CostOption, Json, tier_for, time_limit_option
from certpgo.cli._proving import REFUSED
from certpgo.cli._show import document, notice, working
from certpgo.cli.check import rounded
from certpgo.errors import InputError, NoEdges, NumericalError

if TYPE_CHECKING:
    from certpgo.checker import Answer

#: A badge: width of both halves, the label, and the message with its colour.
_BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="190" height="20"
role="img" aria-label="{0}"><title>{0}</title><rect width="90" height="20" fill="#555"/>
<rect x="90" width="100" height="20" fill="{2}"/>
<g fill="#fff" text-anchor="middle" font-family="Verdana,sans-serif" font-size="11">
<text x="45" y="14">pose graphs</text><text x="140" y="14">{1}</text></g></svg>
"""
_GOOD, _BAD = "#2e7d32", "#b71c1c"


def command(
    graphs: Annotated[list[str], typer.Argument(metavar="GRAPH...", help="Files of graphs.")],
    cost: CostOption = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Folder that keeps the proofs."),
    ] = None,
    badge: Annotated[
        Path | None,
        typer.Option("--badge", metavar="SVG", help="Write how many are proven as a picture."),
    ] = None,
    time_limit: Annotated[
        float | None,
        time_limit_option("For each graph: stop the search.", "30 s after a first bound"),
    ] = None,
    json: Json = False,
) -> int:
    """Solve graphs, prove how good each answer is, and check the proofs.

    A line a graph. Files of estimates are skipped. The exit code is 0 if every answer is CERTIFIED
    and its proof accepted, 1 if a file cannot be read, else 6.
    """
    tier_for(Path(), None, cost)
    found: dict[str, str | Answer] = {}
    unread = False
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        for name in graphs:
            try:
                with working(f"proving {name}"):
                    found[name] = _proven(name, folder / _named(name), cost, time_limit)
            except NoEdges:
                notice(f"{name}: no measurements; skipped")
                continue
            except NumericalError as reason:
                found[name] = f"NOT PROVED: {reason}"
            except InputError as error:
                found[name], unread = f"ERROR: {error}", True
            if not json:
                typer.echo(f"{name}: {found[name]}")
    good = sum(not isinstance(said, str) for said in found.values())
    if badge is not None:
        said = f"{good} of {len(found)} proven"
        text = _BADGE.format(f"pose graphs: {said}", said, _GOOD if good == len(found) else _BAD)
        badge.write_text(text, encoding="utf-8")
    if json:
        document({name: _as_json(said) for name, said in found.items()})
    return 0 if good == len(found) else 1 if unread else REFUSED


def _named(graph: str) -> str:
    """The proof's file: by the graph's path, as graphs of several folders may have one name."""
    path = Path(graph)
    return "_".join(path.relative_to(path.anchor).parts) + ".cert"


def _proven(name: str, proof: Path, cost: str | None, time_limit: float | None) -> Answer:
    """The bounds of a graph's answer, as the checker accepts them from files alone."""
    import certpgo
    from certpgo.certify.proof_file import refuse_unreadable
    from certpgo.objective.choose_cost import own_cost
    from certpgo.optimize.solution import Status

    instance = certpgo.read(name, quiet=True)
    for sentence in instance.notices:
        notice(f"{name}: {sentence}")
    refuse_unreadable(Path(name), instance, cost or own_cost(instance))
    answer = certpgo.solve(instance, cost=cost, tier="proof", time_limit=time_limit)
    if answer.solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if answer.verdict is not certpgo.Verdict.CERTIFIED:
        raise NumericalError(answer.certificate.reason)
    certpgo.write_proof(proof, name, instance, answer.estimate, answer.certificate)
    return certpgo.check(name, proof)


def _as_json(said: str | Answer) -> dict[str, object]:
    if isinstance(said, str):
        return {"proved": False, "reason": said}
    return {
        "proved": True,
        "about": said.about,
        "cost_upper": rounded(said.upper, math.inf),
        "lower_bound": rounded(said.lower, -math.inf),
        "relative_gap": rounded(said.relative_gap, math.inf),
    }
