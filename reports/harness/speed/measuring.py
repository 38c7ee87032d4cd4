"""Steps that are timed in turn, and records of how they compare."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from statistics import median
from typing import NamedTuple, TypeVar

from certpgo.errors import CertPGOError
from certpgo.linalg.factor import default_engine
from reports.harness.experiments.absence import Absence, Missing, missing
from reports.harness.experiments.journal import JournalEntry
from reports.harness.experiments.keys import content_key
from reports.harness.experiments.timing import processor_seconds

Result = TypeVar("Result")
#: Share by which a cost is above ours where another minimum was found.
ELSEWHERE = 1e-3


class Lap(NamedTuple):
    """One run of a step: its seconds, and what its result says, or nothing; the cost it ends at."""

    seconds: float
    note: str = ""
    cost: float | None = None


Timer = Callable[[], Lap]
#: Timers by the names of their steps; steps that cannot be run here say why.
Timers = Mapping[str, Timer | Missing]


class Comparison(NamedTuple):
    """Which two steps are compared, and the ratio to stay below, if there is one."""

    what: str
    against: str
    goal: float | None = None


@dataclass(frozen=True)
class Group:
    """Steps that are timed in turn.

    Attributes
    ----------
    section : which table it belongs to
    subject : what it is run on
    timers : the context in which there are timers; what they need is read, built or written on
        entering it, and not timed
    comparisons : of which steps
    rounds : how often each step is timed, after a warm-up
    size : what the work grows with, poses for example; 0 where nothing is fitted
    """

    section: str
    subject: str
    timers: Callable[[], AbstractContextManager[Timers]]
    comparisons: tuple[Comparison, ...]
    rounds: int = 5
    size: int = 0

    @property
    def label(self) -> str:
        """What progress calls it."""
        return f"{self.section}: {self.subject}"

    @property
    def steps(self) -> int:
        """One, of a run's progress."""
        return 1

    def key(self, commit: str) -> str:
        """The key of its records: what is measured, at which commit, with which engine."""
        return content_key(
            {
                "section": self.section,
                "subject": self.subject,
                "comparisons": [comparison[:2] for comparison in self.comparisons],
                "rounds": self.rounds,
                "engine": default_engine(),
                "commit": commit,
            }
        )


@dataclass(frozen=True, kw_only=True)
class SpeedRecord(JournalEntry):
    """How two steps compare.

    Attributes
    ----------
    section, subject : as of the group
    what, against : the steps
    seconds, against_seconds : medians, of the processor
    ratios : of each round
    goal : what the ratio should stay below, or None
    note, against_note : what the results say
    size : as of the group
    absence, error : why there is no ratio, and the same in words
    """

    section: str
    subject: str
    what: str
    against: str
    seconds: float | None = None
    against_seconds: float | None = None
    ratios: Sequence[float] = ()
    goal: float | None = None
    note: str = ""
    against_note: str = ""
    size: int = 0
    absence: Absence | None = None
    error: str = ""

    def __post_init__(self) -> None:
        if bool(self.absence) == bool(self.ratios):
            raise ValueError("a record has ratios, or a reason why it has none")
        # A file has texts and lists.
        if self.absence is not None:
            object.__setattr__(self, "absence", Absence(self.absence))
        object.__setattr__(self, "ratios", tuple(self.ratios))

    @property
    def ratio(self) -> float | None:
        """The median of the rounds' ratios."""
        return median(self.ratios) if self.ratios else None

    @property
    def misses(self) -> bool:
        """Whether the ratio is above its goal."""
        return self.goal is not None and self.ratio is not None and self.ratio > self.goal

    @property
    def why_missing(self) -> str:
        """Why there is no ratio, or empty."""
        return "" if self.absence is None else str(Missing(self.absence, self.error))


def processor(
    step: Callable[[], Result],
    say: Callable[[Result], str] | None = None,
    *,
    calls: int = 1,
    spared: Callable[[Result], float] = lambda result: 0.0,
    cost: Callable[[Result], float | None] = lambda result: None,
) -> Timer:
    """A timer of processor seconds per call.

    Parameters
    ----------
    say : what a result says; not timed
    calls : how often the step is run each time, for steps of milliseconds
    spared : the share of the last run that is not counted
    cost : what a result costs, where steps that are compared minimise the same; not timed
    """

    def lap() -> Lap:
        gc.collect()
        start = processor_seconds()
        for _ in range(calls):
            result = step()
        seconds = (1.0 - spared(result)) * (processor_seconds() - start) / calls
        return Lap(seconds, "" if say is None else say(result), cost(result))

    return lap


def in_turn(timers: Timers, rounds: int) -> dict[str, list[Lap] | Missing]:
    """The laps of each step, A B A B ... after a warm-up; of those that fail there, the reason."""
    laps: dict[str, list[Lap] | Missing] = {name: _warmed(timer) for name, timer in timers.items()}
    for _ in range(rounds):
        for name, timer in timers.items():
            known = laps[name]
            if isinstance(known, list) and not isinstance(timer, Missing):
                known.append(timer())
    return laps


def _warmed(timer: Timer | Missing) -> list[Lap] | Missing:
    if isinstance(timer, Missing):
        return timer
    try:
        timer()
    except (CertPGOError, MemoryError, OSError) as error:
        return missing(error)
    return []


def measured(group: Group, commit: str, provenance: Mapping[str, str]) -> list[SpeedRecord]:
    """The records of a group: one for each comparison."""
    names = {name for comparison in group.comparisons for name in comparison[:2]}
    try:
        with group.timers() as timers:
            laps = in_turn(timers, group.rounds)
    except CertPGOError as error:
        laps = dict.fromkeys(names, missing(error))
    key = group.key(commit)
    return [
        replace(
            _record(group, comparison, laps[comparison.what], laps[comparison.against]),
            key=key,
            part=f"{comparison.what} / {comparison.against}",
            provenance=provenance,
        )
        for comparison in group.comparisons
    ]


def _record(
    group: Group,
    comparison: Comparison,
    ours: list[Lap] | Missing,
    theirs: list[Lap] | Missing,
) -> SpeedRecord:
    found: dict[str, object] = {}
    if isinstance(ours, list):
        found |= {"seconds": median(lap.seconds for lap in ours), "note": ours[-1].note}
    if isinstance(theirs, list):
        found["against_seconds"] = median(lap.seconds for lap in theirs)
        found["against_note"] = theirs[-1].note or _in_words(theirs[-1].cost)
    if isinstance(ours, list) and isinstance(theirs, list) and _is_elsewhere(ours, theirs):
        said = f"it ends at another minimum: {theirs[-1].cost:.8g} against {ours[-1].cost:.8g}"
        found |= {"absence": Absence.ELSEWHERE, "error": said}
    elif isinstance(ours, list) and isinstance(theirs, list):
        pairs = zip(ours, theirs, strict=True)
        found["ratios"] = tuple(a.seconds / b.seconds for a, b in pairs)
    else:
        reason = ours if isinstance(ours, Missing) else theirs
        found |= dict(zip(Missing._fields, reason, strict=True))
    return SpeedRecord(
        section=group.section,
        subject=group.subject,
        what=comparison.what,
        against=comparison.against,
        goal=comparison.goal,
        size=group.size,
        **found,  # type: ignore[arg-type]
    )


def _is_elsewhere(ours: list[Lap], theirs: list[Lap]) -> bool:
    """Whether the other step ends at a larger cost, so that its seconds are of another answer."""
    a, b = ours[-1].cost, theirs[-1].cost
    return a is not None and b is not None and b > a * (1.0 + ELSEWHERE)


def _in_words(cost: float | None) -> str:
    return "" if cost is None else f"{cost:.8g}"
