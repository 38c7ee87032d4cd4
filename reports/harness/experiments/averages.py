"""Many instances of a row as one record per method: means or medians, and tallies of verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import fmean, quantiles
from typing import Any, Literal

from reports.harness.experiments.absence import Absence
from reports.harness.experiments.records import Record

#: What the metrics of lower and upper quartiles are called, after the metric.
LOWER, UPPER = ".lower", ".upper"


def summarized(records: Iterable[Record], summary: Literal["mean", "median"]) -> list[Record]:
    """One record per method, in the order of their first ones.

    Metrics are means or medians over the records that have them, the latter with quartiles;
    times and counts are means; texts are tallied.
    """
    by_method: dict[str, list[Record]] = {}
    for record in records:
        by_method.setdefault(record.method, []).append(record)
    return [_summary(group, summary) for group in by_method.values()]


def _summary(group: Sequence[Record], summary: Literal["mean", "median"]) -> Record:
    if len(group) == 1:
        return group[0]
    of_metrics = _means if summary == "mean" else _quartiles
    steps = [r.iterations for r in group if r.iterations is not None]
    counts = _means([r.counts for r in group])
    return replace(
        group[0],
        metrics=of_metrics([r.metrics for r in group]),
        seconds=_means([r.seconds for r in group]),
        counts={key: round(value) for key, value in counts.items()},
        iterations=round(fmean(steps)) if steps else None,
        verdict=_tally(r.verdict for r in group),
        certified_by=_each(group),
        status=_tally(r.status for r in group),
        note=group[0].note if len({r.note for r in group}) == 1 else "",
        **_failures(group),
    )


def _means(mappings: Sequence[Mapping[str, float]]) -> dict[str, float]:
    keys = dict.fromkeys(key for mapping in mappings for key in mapping)
    return {key: fmean(m[key] for m in mappings if key in m) for key in keys}


def _quartiles(mappings: Sequence[Mapping[str, float]]) -> dict[str, float]:
    keys = dict.fromkeys(key for mapping in mappings for key in mapping)
    found: dict[str, float] = {}
    for key in keys:
        values = [m[key] for m in mappings if key in m]
        cuts = quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3
        found |= {key: cuts[1], key + LOWER: cuts[0], key + UPPER: cuts[2]}
    return found


def _tally(texts: Iterable[str]) -> str:
    counted = Counter(filter(None, texts))
    if len(counted) == 1:
        return next(iter(counted))
    return "; ".join(f"{text} ({count})" for text, count in counted.most_common())


def _each(group: Sequence[Record]) -> str:
    """The bounds that hold, each with how often, unless it always holds."""
    held = Counter(name for r in group for name in r.certified_by.split(", ") if name)
    always = sum(bool(r.certified_by) for r in group)
    return ", ".join(name if k == always else f"{name} ({k})" for name, k in held.items())


def _failures(group: Sequence[Record]) -> dict[str, Any]:
    """Why there are no results, where some are missing: the first reason, and how often."""
    failed = [record for record in group if record.absence]
    if not failed:
        return {}
    first = failed[0]
    if len(failed) == len(group) and len({(r.absence, r.error) for r in failed}) == 1:
        return {"absence": first.absence, "error": first.error}
    said = f"{len(failed)} of {len(group)}: {first.why_missing}"
    return {"absence": Absence.FAILED, "error": said}
