"""certpgo bench: how time and memory grow with the graph, and what certifiers get wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import document, notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from reports.harness.experiments.journal import JournalEntry
    from reports.harness.experiments.records import Record
    from reports.harness.experiments.zoo_records import ZooRecord


def command(
    what: Annotated[
        str,
        typer.Argument(
            metavar="scale|speed|zoo",
            help="scale: time and memory. speed: against others. zoo: certifiers.",
        ),
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
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random graphs.")] = 0,
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
    """Measure how time and memory grow with the graph, or count certifiers' errors.

    scale solves synthetic graphs of growing size, each in a process of its own: time, memory,
    slope, verdict. speed times public graphs in turn with GTSAM, next to SE-Sync's published times,
    and adds how each phase grows. zoo puts points of known truth, most of them adversarial, before
    our certifier and the competitors', and counts what is false. Existing results in the folder are
    reused, so that an interrupted run resumes.
    """
    records: Sequence[JournalEntry]
    if what == "scale":
        records = measured = _scale(family, sizes, quick, seed, out, not json)
        code = int(any(record.absence for record in measured))
    elif what == "speed":
        records = measured = _speed(family, sizes, quick, seed, out, not json)
        code = int(any(record.absence for record in measured))
    elif what == "zoo":
        records = certified = _zoo(campaign, quick, processes, out, not json)
        code = int(any(record.faults for record in certified))
    else:
        raise InputError(f"unknown benchmark {what!r}; known: scale, speed, zoo")
    if json:
        from reports.harness.experiments.journal import as_data

        document([as_data(record) for record in records])
    else:
        notice(f"written to {out}")
    return code


def _zoo(campaign: int, quick: bool, processes: int, out: Path, shown: bool) -> list[ZooRecord]:
    from certpgo.io.writing import write_whole
    from reports.harness.certifiers import summary, zoo
    from reports.harness.experiments.journal import Journal
    from reports.harness.experiments.zoo_records import FILE, ZooRecord

    journal = Journal(out, FILE, ZooRecord)
    with working("zoo") as status:
        jobs = zoo.jobs(campaign, quick)
        records = list(zoo.run_jobs(journal, jobs, processes=processes, announce=status.update))
    write_whole(out / f"{FILE}.md", summary.zoo_markdown(records).encode())
    if shown:
        table("points, and what was false", *summary.totals(records))
    return records


def _speed(
    family: list[str] | None,
    sizes: list[int] | None,
    quick: bool,
    seed: int,
    out: Path,
    shown: bool,
) -> list[Record]:
    from reports.harness.commands import _speed as speed
    from reports.harness.commands._reports import Order, TableReport
    from reports.harness.commands._tables import run_tasks
    from reports.harness.experiments import scan
    from reports.harness.experiments.execute import Pool
    from reports.harness.experiments.spec import Table
    from reports.harness.scaling import scale

    for name in family or ():
        scale.family(name)  # report a wrong name before any work
    spec = scan.get_experiment(speed.TABLE)
    if not isinstance(spec, Table):
        raise InputError(f"{speed.TABLE} is no table")
    report = TableReport(spec, Order(out, quick=quick))
    interrupted = run_tasks({spec.name: report}, Pool(), lines=True)
    report.close(interrupted=interrupted)
    if interrupted:
        raise KeyboardInterrupt
    timed = report.records
    if shown:
        table("certified solutions", speed.HEADER, speed.rows(timed), speed.CAPTION)
    families = {
        name: _scale([name], sizes, quick, seed, out, shown=False) for name in family or _families()
    }
    if shown:
        table("growth", speed.GROWTH, speed.growth(families), speed.GROWTH_CAPTION)
    return [*timed, *(record for records in families.values() for record in records)]


def _families() -> list[str]:
    from reports.harness.scaling import scale

    return list(scale.FAMILIES)


def _scale(
    family: list[str] | None,
    sizes: list[int] | None,
    quick: bool,
    seed: int,
    out: Path,
    shown: bool,
) -> list[Record]:
    from reports.harness.experiments.journal import Journal
    from reports.harness.experiments.records import Record
    from reports.harness.scaling import scale

    names = family or _families()
    chosen = {name: scale.family(name) for name in names}
    everything: list[Record] = []
    for name, known in chosen.items():
        chosen_sizes = sizes or (known.quick if quick else known.sizes)
        journal = Journal(out, scale.file_name(name), Record)
        records: list[Record] = []
        with working(name) as status:
            for size in chosen_sizes:
                status.update(f"{name}, size {size}")
                kept = journal.find(scale.graph_key(name, size, seed))
                if not kept or kept[0].absence:
                    kept = (scale.measure(name, size, seed),)
                    journal.add(kept[0])
                records += kept
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
            r.why_missing,
        )
        for r in records
    ]
    header = ("nodes", "edges", "verdict", "relative gap", "seconds", "GB", "work", "failed")
    caption = "" if math.isnan(slope) else f"seconds grow with the {slope:.2f}th power of the nodes"
    table(name, header, rows, caption)
