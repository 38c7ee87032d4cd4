"""certpgo bench: how time and memory grow with the graph."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import document, notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.harness.records import Record


def command(
    what: Annotated[str, typer.Argument(metavar="scale", help="What to measure: scale.")],
    family: Annotated[
        list[str] | None,
        typer.Option("--family", help="helix, grid, ...; all of them by default."),
    ] = None,
    sizes: Annotated[
        list[int] | None,
        typer.Option("--size", min=2, help="Turns of a helix, or the side of a grid."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small sizes only.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the random graphs.")] = 0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("bench-results"),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Solve synthetic graphs of growing size: time, memory, slope, verdict.

    Every size has a process of its own. Sizes that are in the results folder already are taken
    from there, so that a run that was interrupted goes on.
    """
    from certpgo.harness import scale
    from certpgo.harness.records import Ledger, as_data
    from certpgo.linalg.factor import default_engine

    if what != "scale":
        raise InputError(f"unknown benchmark {what!r}; known: scale")
    names = family or list(scale.FAMILIES)
    chosen = {name: scale.family(name) for name in names}
    everything: list[Record] = []
    for name, known in chosen.items():
        wanted = sizes or (known.quick if quick else known.sizes)
        ledger = Ledger(out, f"scale_{name}")
        records: list[Record] = []
        with working(name) as status:
            for size in wanted:
                status.update(f"{name}, size {size}")
                record = ledger.find(scale.label(name, size), seed, default_engine())
                if record is None:
                    record = scale.run(name, size, seed)
                    ledger.add(record)
                records.append(record)
        everything += records
        if not json:
            _show(name, records, scale.slope(records))
    if json:
        document([as_data(record) for record in everything])
    else:
        notice(f"written to {out}")
    return int(any(record.error for record in everything))


def _show(name: str, records: list[Record], slope: float) -> None:
    from certpgo.harness.render import work

    rows = [
        (
            f"{r.n or 0:,}",
            f"{r.m or 0:,}",
            r.verdict,
            f"{r.metrics.get('relative_gap', float('nan')):.1e}",
            f"{r.metrics.get('median_seconds', float('nan')):.2f}",
            f"{r.metrics.get('memory_gb', float('nan')):.2f}",
            work(r),
            r.error,
        )
        for r in records
    ]
    header = ("nodes", "edges", "verdict", "relative gap", "seconds", "GB", "work", "failed")
    caption = "" if math.isnan(slope) else f"seconds grow with the {slope:.2f}th power of the nodes"
    table(name, header, rows, caption)
