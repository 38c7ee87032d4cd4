"""certpgo gate: new results against the committed ones, and what moved."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._show import document, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from reports.harness.experiments.regression import GateFindings, Key, Movement, Records

EXAMPLES = ("certpgo gate",)
#: Exit code when a value got worse or differs.
FAILED = 7
#: How many records are named of those on one side alone; --json has all.
NAMED = 5
#: Longest text of a cell; longer ones are cut.
CELL = 60


def command(
    new: Annotated[
        Path | None,
        typer.Argument(
            metavar="NEW",
            help="A folder of results, or one file of records; by default a small fixed set is "
            "run, the quick profiles of some tables.",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            "--against",
            metavar="DIR|FILE",
            help="What to compare with, by default the checkout's reports/results.",
        ),
    ] = None,
    complete: Annotated[
        bool, typer.Option("--complete", help="Fail for records on one side alone, too.")
    ] = False,
    times: Annotated[
        float | None,
        typer.Option("--times", min=1.0, help="Factor by which ratios of times may move: 1.5."),
    ] = None,
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder to look in first.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Compare results with the committed ones; exit code 7 when a value got worse or differs."""
    from certpgo import registry
    from reports.harness.experiments.metrics import TIMES
    from reports.harness.experiments.regression import (
        FIXED,
        compare_records,
        load_records,
        run_quick,
    )

    against = against or registry.repository() / "reports" / "results"
    if new is not None and new.resolve() == against.resolve():
        raise InputError(f"{new}: would be compared with itself")
    committed = load_records(against)
    refused: dict[str, str] = {}
    if new is not None:
        records: Records = load_records(new)
    else:
        with working("the fixed set") as status:
            records, refused = run_quick(FIXED, data, status.update)
    found = compare_records(records, committed, times=times or TIMES)
    if not found.compared:
        raise InputError(f"nothing to compare: {against} has none of these records")
    holds = found.holds(complete=complete)
    if json:
        document({"holds": holds, "against": against.as_posix(), **_as_data(found, refused)})
    else:
        _show(found, refused)
        typer.echo(_summary(found, against, holds))
    return 0 if holds else FAILED


def _show(found: GateFindings, refused: dict[str, str]) -> None:
    from certpgo.graph.phrases import counted

    if found.movements:
        header = ("table", "row", "method", "what", "committed", "new", "change", "")
        failing_first = sorted(found.movements, key=lambda move: move not in found.failures)
        table("what moved", header, [_row(move) for move in failing_first])
    for title, keys in (("without a new record", found.missing), ("not committed", found.added)):
        if keys:
            typer.echo(f"{title}: {_named(keys)}")
    for reason in dict.fromkeys(filter(None, found.missing.values())):
        typer.echo(f"  {reason}")
    if found.untouched:
        typer.echo(f"tables with no new record: {', '.join(found.untouched)}")
    for name, reason in refused.items():
        typer.echo(f"{name}: {reason}")
    if found.other_engine:
        typer.echo(
            f"{counted(found.other_engine, 'record{s}')} by another factorization engine: fill and "
            "ratios of times are not compared"
        )


def _named(keys: Iterable[Key]) -> str:
    names = [_name(key) for key in keys]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return "; ".join(names[:NAMED]) + more


def _name(key: Key) -> str:
    return ", ".join((key.table, _instance(key), key.method))


def _instance(key: Key) -> str:
    seed = "" if key.seed is None else f"seed {key.seed}"
    return ", ".join(filter(None, (key.part or key.row, seed)))


def _row(move: Movement) -> tuple[str, ...]:
    change = "" if move.change is None else f"{move.change:+.1e}"
    if move.change is not None and abs(move.change) >= 0.001:
        change = f"{100.0 * move.change:+.1f} %"
    key = move.key
    cells = (move.metric, _cell(move.before), _cell(move.after))
    return (key.table, _instance(key), key.method, *cells, change, move.direction)


def _cell(value: Any) -> str:
    if value is None:
        return "none"
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return text if len(text) <= CELL else f"{text[: CELL - 3]}..."


def _summary(found: GateFindings, against: Path, holds: bool) -> str:
    from certpgo.graph.phrases import counted

    compared = f"{counted(found.compared, 'record{s}')} compared with {against}"
    if holds:
        return f"the gate holds: {compared}, nothing got worse"
    failed = f"{counted(len(found.failures), 'value{s}')} worse or different"
    return f"the gate failed: {compared}, {failed if found.failures else 'records are lacking'}"


def _as_data(found: GateFindings, refused: dict[str, str]) -> dict[str, Any]:
    return {
        "compared": found.compared,
        "movements": [
            {
                **move.key._asdict(),
                "what": move.metric,
                "committed": move.before,
                "new": move.after,
                "change": move.change,
                "direction": move.direction,
                "fails": move in found.failures,
            }
            for move in found.movements
        ],
        "missing": [{**key._asdict(), "reason": why} for key, why in found.missing.items()],
        "added": [key._asdict() for key in found.added],
        "untouched": list(found.untouched),
        "refused": refused,
        "other_engine": found.other_engine,
    }
