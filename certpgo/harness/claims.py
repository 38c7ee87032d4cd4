"""What a paper says of its table or figure in words, and whether our records bear it out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from certpgo.errors import SpecError
from certpgo.harness.averages import summarized
from certpgo.io.wording import counted

if TYPE_CHECKING:
    from certpgo.harness.figure import Data, Figure
    from certpgo.harness.records import Record
    from certpgo.harness.spec import Table

#: Asked of records, one an instance and method (means or medians, where the table shows those), or
#: of a figure's record; None where what it needs was not run.
Holds = Callable[[Any], bool | None]


class Found(StrEnum):
    """What became of a claim."""

    HOLDS = "holds"
    DIFFERS = "differs"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Claim:
    """A sentence of a paper that records can contradict.

    Attributes
    ----------
    text : the sentence, quoted or shortened
    holds : whether it is so
    source : where it stands
    each : it is said of every row: ``holds`` is asked of the records of each in turn
    share : the share of the rows of which it must be so, where a paper says "nearly all"
    rows : labels of the rows it is about; empty for all
    remark : what is to be said where ours differ, or why nobody can tell
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


@dataclass(frozen=True)
class Outcome:
    """A claim and what became of it.

    Attributes
    ----------
    held, decided, asked : of a claim about each row, in how many rows it holds, in how many that
        can be told, and in how many it was asked; of others, of one
    """

    claim: Claim
    found: Found
    held: int
    decided: int
    asked: int

    @property
    def said(self) -> str:
        """What became of it, in words."""
        if not self.claim.each or self.found is Found.NOT_RUN:
            return self.found.value
        part = f"in {self.held} of {counted(self.decided, 'row{s}')}"
        missing = self.asked - self.decided
        left = f"; {counted(missing, 'row{s}')} not run" if missing else ""
        if self.found is Found.HOLDS:
            return f"holds {part}{left}"
        return f"differs: holds {part}{left}"

    @property
    def told(self) -> str:
        """The same, with what is to be remarked where it does not hold."""
        remark = "" if self.found is Found.HOLDS else self.claim.remark
        return ". ".join(filter(None, (self.said, remark)))


def of_table(table: Table, records: Iterable[Record]) -> tuple[Outcome, ...]:
    """What became of the table's claims."""
    by_row: dict[str, list[Record]] = {row.label: [] for row in table.rows}
    for record in records:
        by_row.setdefault(record.row, []).append(record)
    if table.summary:
        by_row = {label: summarized(group, table.summary) for label, group in by_row.items()}
    return tuple(_outcome(claim, by_row) for claim in table.claims)


def of_figure(figure: Figure, data: Data | None) -> tuple[Outcome, ...]:
    """What became of the figure's claims; ``data`` is its record, or None without one."""
    return tuple(
        _decided(claim, [None if data is None else claim.holds(data)]) for claim in figure.claims
    )


def _outcome(claim: Claim, by_row: Mapping[str, Sequence[Record]]) -> Outcome:
    labels = claim.rows or tuple(by_row)
    groups = [by_row.get(label, ()) for label in labels]
    if not claim.each:
        groups = [[record for group in groups for record in group]]
    return _decided(claim, [claim.holds(group) if group else None for group in groups])


def _decided(claim: Claim, answers: Sequence[bool | None]) -> Outcome:
    told = [answer for answer in answers if answer is not None]
    held = sum(told)
    found = Found.NOT_RUN
    if told:
        found = Found.HOLDS if held >= claim.share * len(told) else Found.DIFFERS
    return Outcome(claim, found, held, len(told), len(answers))


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
    """Whether all hold of those that can be told."""

    def holds(records: Any) -> bool | None:
        told = [answer for c in conditions if (answer := c(records)) is not None]
        return all(told) if told else None

    return holds


def unknown(records: Any) -> None:
    """Nobody can tell: what the claim is about cannot be run."""
