"""How fast certified solutions are: side by side with GTSAM, next to SE-Sync's published times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from reports.harness.experiments.records import Record
from reports.harness.rendering.published import published
from reports.harness.scaling import scale

#: The table that is timed, and the published numbers.
TABLE, PUBLISHED = "certified", "rosen2019_se_sync_table"

HEADER = (
    "graph",
    "poses",
    "verdict",
    "seconds",
    "GTSAM, seconds",
    "ratio",
    "SE-Sync 2019, seconds",
    "theirs over ours",
)
CAPTION = (
    "GTSAM: chordal initialization (in 2D LAGO) and Gauss-Newton, which certify nothing, timed in "
    "turn on one core; the ratio is the median of the rounds' ratios. SE-Sync: the printed times, "
    "of another machine (a 2.8 GHz laptop), empty where the paper has none"
)
GROWTH = ("family", "poses", "seconds", "GB", "exponent", *scale.PHASES)
GROWTH_CAPTION = (
    "Poses, seconds and GB are those of the largest graph. The exponents p of seconds ~ poses^p, "
    "for the whole solution and each phase, say little where all graphs take less than a second"
)


def rows(records: Iterable[Record]) -> list[tuple[str, ...]]:
    """One line per graph of the table."""
    printed = published(PUBLISHED, "dataset")
    return [_row(record, printed.get(record.row, {})) for record in records]


def _row(record: Record, line: Mapping[str, str]) -> tuple[str, ...]:
    if record.absence:
        return (record.row, "", record.why_missing, *[""] * 5)
    seconds, theirs = record.metrics.get("median_seconds"), line.get("se_sync_time_s", "")
    return (
        record.row,
        f"{record.n or 0:,}",
        record.verdict,
        _shown(seconds, ".3f"),
        _shown(record.metrics.get("reference_seconds"), ".3f"),
        _shown(record.metrics.get("ratio"), ".2f"),
        theirs,
        f"{float(theirs) / seconds:.1f}" if theirs and seconds else "",
    )


def growth(families: Mapping[str, Sequence[Record]]) -> list[tuple[str, ...]]:
    """One line per family of synthetic graphs."""
    lines = []
    for name, records in families.items():
        done = [record for record in records if not record.absence]
        if not done:
            continue
        largest, slopes = max(done, key=lambda record: record.n or 0), scale.phase_slopes(done)
        lines.append(
            (
                name,
                f"{largest.n or 0:,}",
                _shown(largest.metrics.get("median_seconds"), ".2f"),
                _shown(largest.metrics.get("memory_gb"), ".2f"),
                _shown(scale.slope(done), ".2f"),
                *(_shown(slopes.get(phase), ".2f") for phase in scale.PHASES),
            )
        )
    return lines


def _shown(value: float | None, pattern: str) -> str:
    return "" if value is None or value != value else format(value, pattern)
