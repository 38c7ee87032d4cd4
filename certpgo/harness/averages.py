"""Many instances of a row as one record a method: means, and how many of each verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import fmean

from certpgo.harness.records import Record


def averaged(records: Iterable[Record]) -> list[Record]:
    """One record a method, in the order of their first ones.

    Numbers are means over the records that have them; of texts, each with how many have it.
    """
    by_method: dict[str, list[Record]] = {}
    for record in records:
        by_method.setdefault(record.method, []).append(record)
    return [_mean(group) for group in by_method.values()]


def _mean(group: Sequence[Record]) -> Record:
    if len(group) == 1:
        return group[0]
    steps = [r.iterations for r in group if r.iterations is not None]
    counts = _means([r.counts for r in group])
    failed = [r.error for r in group if r.error]
    return replace(
        group[0],
        metrics=_means([r.metrics for r in group]),
        seconds=_means([r.seconds for r in group]),
        counts={key: round(value) for key, value in counts.items()},
        iterations=round(fmean(steps)) if steps else None,
        verdict=_tally(r.verdict for r in group),
        certified_by=_each(group),
        status=_tally(r.status for r in group),
        note=group[0].note if len({r.note for r in group}) == 1 else "",
        error=_failures(failed, len(group)),
    )


def _means(mappings: Sequence[Mapping[str, float]]) -> dict[str, float]:
    keys = dict.fromkeys(key for mapping in mappings for key in mapping)
    return {key: fmean(m[key] for m in mappings if key in m) for key in keys}


def _tally(texts: Iterable[str]) -> str:
    counted = Counter(filter(None, texts))
    if len(counted) == 1:
        return next(iter(counted))
    return "; ".join(f"{text} ({count})" for text, count in counted.most_common())


def _each(group: Sequence[Record]) -> str:
    """The bounds that hold, each with how often unless it is always."""
    held = Counter(name for r in group for name in r.certified_by.split(", ") if name)
    always = sum(bool(r.certified_by) for r in group)
    return ", ".join(name if k == always else f"{name} ({k})" for name, k in held.items())


def _failures(errors: Sequence[str], runs: int) -> str:
    if not errors:
        return ""
    if len(errors) == runs and len(set(errors)) == 1:
        return errors[0]
    return f"{len(errors)} of {runs}: {errors[0]}"
