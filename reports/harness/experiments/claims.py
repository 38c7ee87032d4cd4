"""What a paper says of its table or figure in words, and whether our records confirm it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from certpgo.errors import SpecError

if TYPE_CHECKING:
    from reports.harness.experiments.records import Record

#: Whether a claim holds for records, one for each instance and method (means or medians, where the
#: table shows those), or for a figure's record; None where what it needs was not run.
Holds = Callable[[Any], bool | None]


@dataclass(frozen=True)
class Claim:
    """A sentence of a paper that records can contradict.

    Attributes
    ----------
    text : the sentence, quoted or shortened
    holds : whether it is true
    source : where it is made
    each : it is about every row: ``holds`` is called with the records of each in turn
    share : the share of the rows for which it must hold, where a paper says "nearly all"
    rows : labels of the rows it is about; empty for all
    remark : what explains that ours differ, or why it cannot be decided
    """

    text: str
    holds: Holds
    source: str = ""
    each: bool = False
    share: float = 1.0
    rows: tuple[str, ...] = ()
    remark: str = ""

    def __post_init__(self) -> None:
        if not 0.0 < self.share <= 1.0:
            raise SpecError(f"claim {self.text!r}: a share lies between 0 and 1, not {self.share}")


def number(records: Iterable[Record], method: str, metric: str) -> float | None:
    """The method's metric on the first instance that has it, or None."""
    for record in records:
        value = record.metrics.get(metric) if record.method == method else None
        if value is not None:
            return value
    return None


def numbers(records: Iterable[Record], method: str, metric: str) -> list[float]:
    """The method's metric on every instance that has it."""
    found = [r.metrics.get(metric) for r in records if r.method == method]
    return [value for value in found if value is not None]


def below(metric: str, method: str, other: str, factor: float = 1.0, slack: float = 0.0) -> Holds:
    """Whether the method's metric is at most ``factor`` times the other's, plus ``slack``."""

    def holds(records: Sequence[Record]) -> bool | None:
        mine, theirs = (number(records, name, metric) for name in (method, other))
        return None if mine is None or theirs is None else mine <= factor * theirs + slack

    return holds


def within(metric: str, method: str, lower: float, upper: float) -> Holds:
    """Whether the method's metric lies between two numbers, both included."""

    def holds(records: Sequence[Record]) -> bool | None:
        value = number(records, method, metric)
        return None if value is None else lower <= value <= upper

    return holds


def together(*conditions: Holds) -> Holds:
    """Whether all hold of those that can be decided."""

    def holds(records: Any) -> bool | None:
        found = [held for c in conditions if (held := c(records)) is not None]
        return all(found) if found else None

    return holds


def unknown(records: Any) -> None:
    """Undecided: what the claim is about cannot be run."""
