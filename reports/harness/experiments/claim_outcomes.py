"""Outcomes of the claims of a table or figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from certpgo.graph.phrases import counted
from reports.harness.experiments.averages import summarized
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table


class ClaimStatus(StrEnum):
    """The outcome of a claim."""

    HOLDS = "holds"
    DIFFERS = "differs"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class ClaimOutcome:
    """A claim and its outcome.

    Attributes
    ----------
    held, decided, asked : of a claim about each row, in how many rows it holds, how many could
        be decided, and how many it is about; of others, out of one
    """

    claim: Claim
    found: ClaimStatus
    held: int
    decided: int
    asked: int

    @property
    def in_brief(self) -> str:
        """The outcome in words."""
        if not self.claim.each or self.found is ClaimStatus.NOT_RUN:
            return self.found.value
        part = f"in {self.held} of {counted(self.decided, 'row{s}')}"
        missing = self.asked - self.decided
        left = f"; {counted(missing, 'row{s}')} not run" if missing else ""
        if self.found is ClaimStatus.HOLDS:
            return f"holds {part}{left}"
        return f"differs: holds {part}{left}"

    @property
    def in_full(self) -> str:
        """The same, with the remark where it does not hold."""
        remark = "" if self.found is ClaimStatus.HOLDS else self.claim.remark
        return ". ".join(filter(None, (self.in_brief, remark)))


def of_table(table: Table, records: Iterable[Record]) -> tuple[ClaimOutcome, ...]:
    """The outcomes of the table's claims."""
    by_row: dict[str, list[Record]] = {row.label: [] for row in table.rows}
    for record in records:
        by_row.setdefault(record.row, []).append(record)
    if table.summary:
        by_row = {label: summarized(group, table.summary) for label, group in by_row.items()}
    return tuple(_outcome(claim, by_row) for claim in table.claims)


def of_figure(figure: Figure, data: Data | None) -> tuple[ClaimOutcome, ...]:
    """The outcomes of the figure's claims; ``data`` is its record, or None without one."""
    return tuple(
        _decided(claim, [None if data is None else claim.holds(data)]) for claim in figure.claims
    )


def _outcome(claim: Claim, by_row: Mapping[str, Sequence[Record]]) -> ClaimOutcome:
    labels = claim.rows or tuple(by_row)
    groups = [by_row.get(label, ()) for label in labels]
    if not claim.each:
        groups = [[record for group in groups for record in group]]
    return _decided(claim, [claim.holds(group) if group else None for group in groups])


def _decided(claim: Claim, found: Sequence[bool | None]) -> ClaimOutcome:
    decided = [holds for holds in found if holds is not None]
    held = sum(decided)
    status = ClaimStatus.NOT_RUN
    if decided:
        status = ClaimStatus.HOLDS if held >= claim.share * len(decided) else ClaimStatus.DIFFERS
    return ClaimOutcome(claim, status, held, len(decided), len(found))
