"""certpgo bench: how fast certpgo is, how it grows with the graph, what certifiers get wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._completion import one_of
from certpgo.cli._interrupting import INTERRUPTED
from certpgo.cli._show import document, notice, table, working
from certpgo.errors import InputError, SpecError

if TYPE_CHECKING:
    from reports.harness.experiments.journal import JournalEntry
    from reports.harness.experiments.records import Record
    from reports.harness.experiments.zoo_records import ZooRecord
    from reports.harness.speed.measuring import SpeedRecord


EXAMPLES = (
    "certpgo bench speed --quick",
    "certpgo bench zoo --campaign 1000",
)


def command(
    what: Annotated[
        str,
        typer.Argument(
            metavar="scale|speed|zoo",
            autocompletion=one_of(("scale", "speed", "zoo")),
            help="scale: time and memory. speed: against others. zoo: certifiers.",
        ),
    ],
    sections: Annotated[
        list[str] | None,
        typer.Option("--section", metavar="NAME", help="speed: these parts; all by default."),
    ] = None,
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
    workers: Annotated[
        int, typer.Option("--workers", min=1, metavar="N", help="zoo: processes at once.")
    ] = 2,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")
    ] = Path("bench-results"),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Measure how time and memory grow with the graph, or count certifiers' errors.

    scale solves synthetic graphs of growing size, each in a process of its own: time, memory,
    slope, verdict. speed times whole processes, reading, solving, proofs and sessions in turn with
    GTSAM, g2o and Ceres, and SE-Sync where CERTPGO_SESYNC names a build, and each phase against
    what this core can do. zoo puts points of known truth, most of them adversarial, before our
    certifier and the competitors', and counts what is false. Existing results in the folder are
    reused, so that an interrupted run resumes; those of speed, if they are of the same commit.
    """
    records: Sequence[JournalEntry]
    if what == "scale":
        records = measured = _scale(family, sizes, quick, seed, out, not json)
        code = int(any(record.absence for record in measured))
    elif what == "speed":
        records, interrupted = timed = _speed(sections or (), quick, out, not json)
        failed = any(record.absence and record.absence.is_failure for record in timed[0])
        code = INTERRUPTED if interrupted else int(failed)
    elif what == "zoo":
        records = certified = _zoo(campaign, quick, workers, out, not json)
        code = int(any(record.faults for record in certified))
    else:
        raise InputError(f"unknown benchmark {what!r}; known: scale, speed, zoo")
    if json:
        from reports.harness.experiments.journal import as_data

        document([as_data(record) for record in records])
    else:
        notice(f"written to {out}")
    if code == INTERRUPTED:
        notice("interrupted; the same command goes on from there")
    return code


def _zoo(campaign: int, quick: bool, workers: int, out: Path, shown: bool) -> list[ZooRecord]:
    from certpgo.io.writing import write_whole
    from reports.harness.certifiers import summary, zoo
    from reports.harness.experiments.journal import Journal
    from reports.harness.experiments.zoo_records import FILE, ZooRecord

    journal = Journal(out, FILE, ZooRecord)
    with working("zoo") as status:
        jobs = zoo.jobs(campaign, quick)
        records = list(zoo.run_jobs(journal, jobs, workers=workers, announce=status.update))
    write_whole(out / f"{FILE}.md", summary.zoo_markdown(records).encode())
    if shown:
        table("points, and what was false", *summary.totals(records))
    return records


def _speed(
    sections: Sequence[str], quick: bool, out: Path, shown: bool
) -> tuple[list[SpeedRecord], bool]:
    from reports.harness.commands._live import watching
    from reports.harness.speed import bench, pages

    for name in sections:
        if name not in bench.SECTIONS:
            raise SpecError.unknown("section", name, bench.SECTIONS)
    groups, records = bench.groups(quick, sections), []
    interrupted = False
    try:
        with watching(groups, lines=True) as view:
            for group, found in bench.run(out, groups, view.starting):
                records += found
                view.count(group, len(found), [r.absence for r in found if r.absence])
    except KeyboardInterrupt:
        if not records:
            raise
        interrupted = True
    bench.write(out, records)
    if shown:
        for section, of_section in pages.sections(records).items():
            caption = pages.OF_SECTION[section]
            table(section, pages.HEADER, map(pages.row, of_section), caption, optional=pages.LAST)
            if slopes := pages.growth(of_section):
                table("growth", pages.GROWTH, slopes)
        typer.echo(pages.summary(records))
    return records, interrupted


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

    names = family or list(scale.FAMILIES)
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
            _show(name, records)
    return everything


def _show(name: str, records: list[Record]) -> None:
    from reports.harness.rendering.render import work
    from reports.harness.scaling import scale

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
    slope, phases = scale.slope(records), scale.phase_slopes(records)
    of_phases = ", ".join(f"{phase} {p:.2f}" for phase, p in phases.items())
    caption = f"seconds grow with the {slope:.2f}th power of the nodes; {of_phases}"
    caption = "" if math.isnan(slope) else caption
    table(name, header, rows, caption)
