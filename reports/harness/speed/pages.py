"""The records as tables: in a terminal, as Markdown and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence

from certpgo.graph.phrases import counted
from certpgo.view.markdown_tables import markdown_table
from reports.harness.experiments.absence import Absence
from reports.harness.scaling.scale import exponent
from reports.harness.speed import limits
from reports.harness.speed.measuring import SpeedRecord

HEADER = (
    "on",
    "what",
    "seconds",
    "against",
    "its seconds",
    "ratio",
    "from",
    "to",
    "at most",
    "what they say",
)
#: Left out first where a terminal is too narrow.
LAST = ("what they say", "at most", "from", "to")
GROWTH = ("what", "exponent", "exponent of its limit")
TITLE = "How fast certpgo is"
RULES = """\
Made by `certpgo bench speed --out DIR`. Seconds are of the processor, on one core with one thread,
medians; steps run in turn, and a ratio is the median of the rounds' ratios, with the least and the
largest. Above `at most` a ratio is a goal that is missed, marked by `>`. Graphs of other programs
are built beforehand, and they certify nothing. GTSAM's chordal initialization (in the plane LAGO)
is counted; with `isotropic weights` it has those of F. The optimizers of g2o and Ceres begin at the
chordal optimum, which is not counted, nor is what Ceres' residuals take, which are in Python. There
is no ratio where a program ends at another minimum.
SE-Sync, where there is a build, prints the seconds of its own solution, without reading."""
OF_SECTION = {
    "processes": "Whole processes, imports included. GTSAM's script reads the file and optimises "
    "it from the file's initial values.",
    "reading": "Seconds of reading alone, in new processes that have imported NumPy and SciPy.",
    "solving": "From the graph in memory to the certified estimate, and certifying that estimate "
    "anew. What they say: verdict, cost and how phases share the time, or the cost where another "
    "program ends.",
    "small problems": "Graphs of 3 to 125 nodes. Poses are solved and certified under each cost, "
    "next to GTSAM's chordal initialization and Gauss-Newton, or to g2o's from there.",
    "proofs": "A proof about the file, accepted by the checker, for an answer that is known.",
    "sessions": "Measurements one by one, the certificate refreshed at each 100th; and, from some "
    "measurement on, after each of a hundred, loop closures among them, of which the mean is next "
    "to that of updates of GTSAM's iSAM2, which minimises GTSAM's cost and certifies nothing.",
    "parts": "Initialization, eigenvectors and assembly.",
    limits.SECTION: "A phase against the least time of its work on this core: the flops of its "
    "factorizations at the rate of a product of dense matrices (sgemm or dgemm, 1024 rows), plus "
    "the bytes that it must read or write at the rate of a copy. Orders and analyses follow a "
    "graph and are bound by neither; they stand against the bytes of the pattern.",
}


def sections(records: Sequence[SpeedRecord]) -> dict[str, list[SpeedRecord]]:
    """The records of each section, in their order."""
    found: dict[str, list[SpeedRecord]] = {}
    for record in records:
        found.setdefault(record.section, []).append(record)
    return found


def row(record: SpeedRecord) -> tuple[str, ...]:
    """A line of a table."""
    ratios = record.ratios
    against = "its limit" if record.section == limits.SECTION else record.against
    said = " / ".join(filter(None, (record.note, record.against_note)))
    return (
        record.subject,
        record.what,
        _seconds(record.seconds),
        against,
        _seconds(record.against_seconds),
        _number(record.ratio),
        _number(min(ratios, default=None)),
        _number(max(ratios, default=None)),
        "" if record.goal is None else f"{'> ' if record.misses else ''}{record.goal:g}",
        record.why_missing or said,
    )


def growth(records: Sequence[SpeedRecord]) -> list[tuple[str, ...]]:
    """Exponents p of seconds ~ poses^p, and of the limits, of each phase."""
    lines = []
    for what in dict.fromkeys(record.what for record in records if record.size):
        ours, limit = [], []
        for record in records:
            if record.what == what and record.size and record.seconds and record.against_seconds:
                ours.append((record.size, record.seconds))
                limit.append((record.size, record.against_seconds))
        slopes = exponent(ours), exponent(limit)
        if not any(map(math.isnan, slopes)):
            lines.append((what, *(f"{slope:.2f}" for slope in slopes)))
    return lines


def summary(records: Sequence[SpeedRecord]) -> str:
    """How many goals are met, and what misses them."""
    with_goals = [r for r in records if r.goal is not None and r.ratios]
    missed = [record for record in with_goals if record.misses]
    return f"{counted(len(with_goals), 'ratio{s}')} with a goal, {len(missed)} above it."


def markdown(records: Sequence[SpeedRecord]) -> str:
    """The page."""
    lines = [f"# {TITLE}", "", *RULES.splitlines(), "", summary(records)]
    for section, found in sections(records).items():
        lines += ["", f"## {section.capitalize()}", "", OF_SECTION[section], ""]
        here = [record for record in found if record.absence is not Absence.MISSING_PACKAGE]
        lines += markdown_table(HEADER, map(row, here))
        lines += _not_here(found)
        slopes = growth(found)
        if slopes:
            lines += ["", "Exponents p of seconds ~ poses^p:", "", *markdown_table(GROWTH, slopes)]
    lines += ["", *_environment(records)]
    return "\n".join(lines) + "\n"


def _not_here(records: Sequence[SpeedRecord]) -> list[str]:
    """A sentence for the programs that are not here, which have no rows."""
    absent = [r.error for r in records if r.absence is Absence.MISSING_PACKAGE]
    return ["", f"Not measured: {'; '.join(dict.fromkeys(absent))}."] if absent else []


def csv_text(records: Sequence[SpeedRecord]) -> str:
    """All numbers, one comparison a line."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ("section", *HEADER[:5], "ratio", "least", "most", "at most", "note", "its note", "missing")
    )
    for r in records:
        spread = (min(r.ratios, default=None), max(r.ratios, default=None))
        writer.writerow(
            (
                *(r.section, r.subject, r.what, r.seconds, r.against, r.against_seconds),
                *(r.ratio, *spread, r.goal, r.note, r.against_note, r.why_missing),
            )
        )
    return stream.getvalue()


def _environment(records: Sequence[SpeedRecord]) -> Iterator[str]:
    """Versions and machine, once."""
    known = {tuple(sorted(r.provenance.items())) for r in records if r.provenance}
    values = {key: sorted({dict(one)[key] for one in known}) for key, _ in next(iter(known), ())}
    yield "; ".join(f"{key}: {found[-1]}" for key, found in values.items())


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
