"""certpgo optima: the register of certified optima of public graphs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from certpgo.cli._completion import graphs
from certpgo.cli._options import CostOption, Json
from certpgo.cli._proving import REFUSED
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._rules import Rule
from certpgo.cli._show import document, facts, notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.graph import Estimate, Instance
    from certpgo.optima import Register
    from certpgo.optima.adding import Added

EXAMPLES = (
    "certpgo optima",
    "certpgo optima graph.g2o --estimate estimate.tum",
    "certpgo optima --verify",
)
#: Seconds for a check in integers with --exact --add.
EXACT = 120.0
RULES = (
    Rule("--proof has an estimate of its own: not with --estimate", "proof", "estimate"),
    Rule("--estimate needs a GRAPH", "estimate", without="graph"),
    Rule("--add and --verify are two commands", "add", "verify"),
    Rule("--add needs a GRAPH", "add", without="graph"),
    Rule("--verify checks the whole register: without GRAPH", "verify", "graph"),
    Rule("--verify checks the optima of all costs: without --cost", "verify", "cost"),
    Rule("--exact needs --verify or --add", "exact", without="verify|add"),
    Rule("--{option} needs --add", "name|proof", without="add"),
    Rule("--source needs --add", "origin", without="add"),
)


@takes_reading
def command(
    graph: Annotated[
        str | None,
        typer.Argument(
            metavar="[GRAPH]",
            autocompletion=graphs,
            help="Graph file, or dataset name; without one, the register is listed.",
            show_default=False,
        ),
    ] = None,
    add: Annotated[
        bool, typer.Option("--add", help="Solve GRAPH and enter its optimum, if that is better.")
    ] = False,
    cost: CostOption = None,
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="Name of the graph, with --add.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--source",
            metavar="SOURCE",
            help="Where GRAPH is from, with --add: OWNER/REPOSITORY@COMMIT:PATH.",
        ),
    ] = None,
    estimate: Annotated[
        str | None,
        typer.Option(
            "--estimate",
            metavar="FILE",
            help="An estimate of GRAPH to judge; a better one, with --add.",
        ),
    ] = None,
    proof: Annotated[
        Path | None,
        typer.Option("--proof", metavar="FILE", help="A better proof, with --add: not solved."),
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check all proofs that the register keeps.")
    ] = False,
    exact: Annotated[
        bool,
        typer.Option("--exact", help="Check proofs in integers, with --verify or --add."),
    ] = False,
    register: Annotated[
        Path | None,
        typer.Option(
            "--register", metavar="DIR", help="Folder of the register (default: the package's)."
        ),
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """List the certified optima of public graphs, recognise a graph, and add or check entries.

    A graph is recognised by its measurements, in whatever file they are. A new entry never makes
    the register worse, and the independent checker judges its proof.
    """
    from certpgo.optima import recognise
    from certpgo.optima.register import folder_of

    if origin is not None and not re.fullmatch(r"[\w.-]+/[\w.-]+@[^\s:]+:\S+", origin):
        raise InputError(f"--source: OWNER/REPOSITORY@COMMIT:PATH expected, not {origin}")
    held = folder_of(register)
    if verify:
        return _verify(held, reading, exact, json)
    if graph is None:
        _list(held, cost, json)
        return 0
    source = reading.resolve(graph)
    instance = reading.open(source, notices=False, operation=None)
    start = None if estimate is None else _start(reading, estimate, instance)
    if not add:
        return _recognise(held, instance, cost, start, json)
    from_nowhere = origin is None and not source.origin and register is None
    if from_nowhere and not recognise(instance, held):
        raise InputError(
            f"{instance.name} is not in the register of public graphs: --source says where it is "
            "from, and --register DIR keeps one of your own"
        )
    how = {"name": name or "", "source": origin or source.origin, "estimate": start, "proof": proof}
    done = _add(register, source.path(), instance, _costs(cost, instance, proof), exact, how)
    _tell(done, json)
    return 0


def _start(reading: Reading, name: str, instance: Instance) -> Estimate:
    from certpgo.io import read_estimate

    source = reading.resolve(name)
    return read_estimate(source.path(), instance)


def _add(
    register: Path | None,
    path: Path,
    instance: Instance,
    costs: Sequence[str],
    exact: bool,
    how: dict[str, Any],
) -> list[Added]:
    """Enter what is found under each cost; others may write to the register meanwhile."""
    from certpgo.optima.adding import enter, prepare
    from certpgo.optima.register import folder_of

    done = []
    for cost in costs:
        with working(f"solving {instance.name}, {cost}"):
            found = prepare(path, instance, cost, exact_within=EXACT if exact else 0.0, **how)
        held = folder_of(register)
        done.append(enter(held, found))
        held.save()
    return done


def _costs(cost: str | None, instance: Instance, proof: Path | None) -> Sequence[str]:
    """The costs to enter: one that is chosen, else all; of a proof its own default."""
    from certpgo.objective.choose_cost import COSTS, own_cost

    if cost is not None:
        return (cost,)
    return (own_cost(instance),) if proof is not None else tuple(COSTS)


def _recognise(
    held: Register, instance: Instance, cost: str | None, estimate: Estimate | None, json: bool
) -> int:
    """Say what is known of a graph; with an estimate, how far that is from it."""
    from certpgo.objective.choose_cost import objective_of
    from certpgo.optima import recognise

    found = [one for one in recognise(instance, held) if cost in (None, one.optimum.cost)]
    costs = [] if estimate is None else [one.optimum.cost for one in found]
    of = {cost: objective_of(instance, cost) for cost in costs}
    above = {cost: f.enclosure(cast("Estimate", estimate))[1] for cost, f in of.items()}
    if json:
        document(
            [
                {
                    **asdict(one.optimum),
                    "is_exact": one.is_exact,
                    "estimate": above.get(one.optimum.cost),
                }
                for one in found
            ]
        )
        return 0
    if not found:
        typer.echo(f"{instance.name}: not in the register of public graphs")
        return 0
    from certpgo.optima.wording import details

    for k, one in enumerate(found):
        typer.echo("\n" * bool(k) + f"{one}.")
        if one.optimum.cost in above:
            said = one.compared(above[one.optimum.cost])
            typer.echo(f"{said[0].upper()}{said[1:]}.")
        facts(details(one.optimum, held))
    return 0


def _list(held: Register, cost: str | None, json: bool) -> None:
    from certpgo.graph.phrases import counted
    from certpgo.optima.wording import HEADER, row

    optima = [one for one in held.optima if cost in (None, one.cost)]
    if json:
        document([asdict(one) for one in optima])
        return
    graphs = counted(len({one.name for one in optima}), "public graph{s}")
    title = f"{len(optima)} certified optima of {graphs}"
    table(title, HEADER, [row(one) for one in optima], optional=["priors", "ranges", "points"])


def _verify(held: Register, reading: Reading, exact: bool, json: bool) -> int:
    from certpgo.optima.verifying import REFUSED as BAD
    from certpgo.optima.verifying import local_file
    from certpgo.optima.verifying import verify as checks

    done = []
    with working("checking proofs") as status:
        for one in checks(held, lambda entry: local_file(entry, reading.data), exact=exact):
            status.update(f"checking {one.entry.name}")
            done.append(one)
            if not json:
                said = f"{one.result}: {one.entry.name}, {one.entry.cost}: {one.detail}"
                typer.echo(said)
    counts: dict[str, int] = {}
    for one in done:
        counts[one.result] = counts.get(one.result, 0) + 1
    if json:
        document(
            [
                {"name": c.entry.name, "cost": c.entry.cost, "result": c.result, "detail": c.detail}
                for c in done
            ]
        )
    else:
        typer.echo(", ".join(f"{count} {result}" for result, count in counts.items()))
    return REFUSED if BAD in counts else 0


def _tell(done: Sequence[Added], json: bool) -> None:
    from certpgo.optima.register import Absent
    from certpgo.optima.wording import interval

    if json:
        document([{"what": one.what, **asdict(one.entry)} for one in done])
        return
    for one in done:
        entry = one.entry
        if isinstance(entry, Absent):
            notice(f"{entry.name}, {entry.cost}: {entry.reason}")
            continue
        typer.echo(f"{one.what}: {entry.name}, {entry.cost}: {interval(entry)}, {entry.tier}")
        if entry.unproven:
            notice(f"{entry.name}, {entry.cost}: no proof file: {entry.unproven}")
