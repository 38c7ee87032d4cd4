"""The gate on the zoo: what certifiers said of the same points before, and what they say now."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from reports.harness.experiments.metrics import Direction, count_allowed
from reports.harness.experiments.zoo_records import ALL, FAULTS, Outcome, ZooRecord

#: Prefix of our certifiers' names.
OURS = "certpgo"
#: Outcomes of ours of which fewer are better. What else changes follows from these, or is of points
#: whose truth is open.
_WORSE = (
    *FAULTS,
    Outcome.FAILED,
    Outcome.MISSED,
    Outcome.MISSED_LOOSE,
    Outcome.NO_ANSWER,
    Outcome.UNDECIDED,
    Outcome.REFUSED,
)


def zoo_movements(
    before: ZooRecord, after: ZooRecord, same_engine: bool
) -> Iterator[tuple[str, Direction, Any, Any]]:
    """What moved between records of a family or block: its name, direction, and both values."""
    for name in ("points", "instances"):
        was, now = dict(getattr(before, name)), dict(getattr(after, name))
        if was != now:
            yield name, "different", was, now
    if before.points[ALL] != after.points[ALL]:
        return  # other points: comparing counts would say nothing
    new = [fault for fault in after.faults if fault not in before.faults]
    if new or len(before.faults) != len(after.faults):
        was_said, is_said = ("; ".join(said) or "none" for said in (before.faults, after.faults))
        yield "faults", "worse" if new else "better", was_said, is_said
    for certifier in dict.fromkeys((*before.outcomes, *after.outcomes)):
        ours = certifier.startswith(OURS)
        asked_before, asked_now = _was_asked(before, certifier), _was_asked(after, certifier)
        if asked_before and asked_now:
            yield from _of_certifier(certifier, before, after, same_engine)
        elif asked_before != asked_now:
            direction: Direction = "different" if ours and asked_before else "noted"
            yield certifier, direction, _asked(asked_before), _asked(asked_now)


def _of_certifier(
    certifier: str, before: ZooRecord, after: ZooRecord, same_engine: bool
) -> Iterator[tuple[str, Direction, Any, Any]]:
    was, now = before.of(certifier), after.of(certifier)
    for outcome in dict.fromkeys((*was, *now)):
        x, y = was[outcome], now[outcome]
        if x == y:
            continue
        title = f"{certifier}: {outcome}"
        if not certifier.startswith(OURS):
            if abs(y - x) > count_allowed(x, same_engine):
                yield title, "different", x, y
        elif outcome in _WORSE:
            # What is false is never a matter of the engine; a point at a tolerance may be.
            if outcome in FAULTS or abs(y - x) > count_allowed(0, same_engine):
                yield title, "worse" if y > x else "better", x, y
        else:
            yield title, "noted", x, y


def _was_asked(record: ZooRecord, certifier: str) -> bool:
    found = record.of(certifier)
    return bool(found) and not found[Outcome.NOT_INSTALLED]


def _asked(was_asked: bool) -> str:
    return "asked" if was_asked else "not asked"
