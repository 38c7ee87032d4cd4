"""certpgo bench: how time and memory grow with the graph, and what certifiers get wrong."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import document, notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from reports.harness.experiments.records import Record


def command(
    what: Annotated[
        str, typer.Argument(metavar="scale|zoo", help="scale: time and memory. zoo: certifiers.")
    ],
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
    campaign: Annotated[
        int,
        typer.Option("--campaign", metavar="N", min=0, help="zoo: at least N random instances."),
    ] = 0,
    processes: Annotated[
        int, typer.Option("--processes", min=1, help="zoo: how many work at once.")
    ] = 2,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("bench-results"),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Measure growth, or what certifiers get wrong.

    scale solves synthetic graphs of growing size, each in a process of its own: time, memory,
    slope, verdict. zoo puts points of known truth, most of them adversarial, before our certifier
    and the competitors', and counts what is false. What is in the results folder already is taken
    from there, so that a run that was interrupted goes on.
    """
    if what == "scale":
        records = _scale(family, sizes, quick, seed, out, not json)
        code = int(any(record.error for record in records))
    elif what == "zoo":
        records = _zoo(campaign, quick, processes, out, not json)
        code = int(any(record.note for record in records))
    else:
        raise InputError(f"unknown benchmark {what!r}; known: scale, zoo")
    if json:
        from reports.harness.experiments.records import as_data

        document([as_data(record) for record in records])
    else:
        notice(f"written to {out}")
    return code


def _zoo(campaign: int, quick: bool, processes: int, out: Path, shown: bool) -> list[Record]:
    from certpgo.io.writing import write_whole
    from reports.harness.certifiers import run
    from reports.harness.certifiers import summary as report
    from reports.harness.experiments.records import Ledger

    ledger = Ledger(out, run.TABLE)
    with working("zoo") as status:
        jobs = run.jobs(campaign, quick)
        records = list(run.run_jobs(ledger, jobs, processes=processes, announce=status.update))
    write_whole(out / f"{run.TABLE}.md", report.markdown(records).encode())
    if shown:
        table("points judged, and what was false", *report.totals(records))
    return records


def _scale(
    family: list[str] | None,
    sizes: list[int] | None,
    quick: bool,
    seed: int,
    out: Path,
    shown: bool,
) -> list[Record]:
    from certpgo.linalg.factor import default_engine
    from reports.harness.experiments.records import Ledger
    from reports.harness.scaling import scale

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
                    record = scale.measure(name, size, seed)
                    ledger.add(record)
                records.append(record)
        everything += records
        if shown:
            _show(name, records, scale.slope(records))
    return everything


def _show(name: str, records: list[Record], slope: float) -> None:
    from reports.harness.rendering.render import work

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
