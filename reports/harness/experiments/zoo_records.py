"""What the zoo counts, and its records: of a named family, or of a block of random instances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from certpgo.linalg.factor import default_engine
from reports.harness.experiments.journal import JournalEntry
from reports.harness.experiments.keys import content_key

#: Name of the file of records.
FILE = "zoo"
#: Instances in a block, which is what a process is given and a record holds.
BLOCK = 50
#: How many points or instances there are.
ALL = "all"


class Outcome(StrEnum):
    """What a certifier says of a point, and where that is false or lacking."""

    CERTIFIED = "certified"
    NOT_CERTIFIED = "not certified"
    FALSE = "false"
    FALSE_BOUND = "false bound"
    FALSE_REFUTATION = "false refutation"
    FALSE_BASIN = "false basin"
    FALSE_PROOF = "false proof"
    #: What an interval factorization says of the multipliers that a bound rests on.
    CONFIRMED = "bound confirmed"
    UNDECIDED = "bound undecided"
    MISSED = "missed"
    MISSED_LOOSE = "missed, loose"
    #: Of ours: UNDECIDED though a lower bound above the tolerance exists.
    NO_ANSWER = "no answer"
    UNCONFIRMED = "unconfirmed"
    REFUSED = "refused"
    FAILED = "failed"
    NOT_INSTALLED = "not installed"


#: What else may be false, of certifiers that say so much; and all that may be.
OTHER_FAULTS = (
    Outcome.FALSE_BOUND,
    Outcome.FALSE_REFUTATION,
    Outcome.FALSE_BASIN,
    Outcome.FALSE_PROOF,
)
FAULTS = (Outcome.FALSE, *OTHER_FAULTS)


@dataclass(frozen=True, kw_only=True)
class Tally:
    """Counts.

    Attributes
    ----------
    points : of points: `ALL`, and by what is known of them
    instances : of random instances: `ALL`, and by their sort
    outcomes : of each certifier, by `Outcome`
    faults : what is false of ours, or failed, in words
    """

    points: Counter[str] = field(default_factory=Counter)
    instances: Counter[str] = field(default_factory=Counter)
    outcomes: dict[str, Counter[str]] = field(default_factory=dict)
    faults: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.outcomes, Mapping):
            raise TypeError("outcomes are counts by certifier")
        # A file has mappings.
        object.__setattr__(self, "points", Counter(self.points))
        object.__setattr__(self, "instances", Counter(self.instances))
        counts = {name: Counter(of_one) for name, of_one in self.outcomes.items()}
        object.__setattr__(self, "outcomes", counts)

    def of(self, certifier: str) -> Counter[str]:
        """The certifier's outcomes."""
        return self.outcomes.get(certifier, Counter())


def total(tallies: Iterable[Tally]) -> Tally:
    """All counts together."""
    points: Counter[str] = Counter()
    instances: Counter[str] = Counter()
    outcomes: dict[str, Counter[str]] = {}
    faults: list[str] = []
    for tally in tallies:
        points.update(tally.points)
        instances.update(tally.instances)
        for name, counts in tally.outcomes.items():
            outcomes.setdefault(name, Counter()).update(counts)
        faults += tally.faults
    return Tally(points=points, instances=instances, outcomes=outcomes, faults=faults)


@dataclass(frozen=True)
class Job:
    """A family, or a block of random instances from ``seed`` on."""

    name: str
    seed: int | None = None
    quick: bool = False

    @property
    def label(self) -> str:
        """What reports call it."""
        if self.seed is None:
            return self.name
        return f"{self.name}: seeds {self.seed} to {self.seed + BLOCK - 1}"

    def key(self, certifiers: Iterable[str]) -> str:
        """The key of its record, with the factorization engine in use."""
        return content_key(
            {
                "family": self.name,
                "seed": self.seed,
                "quick": self.quick and self.seed is None,
                "certifiers": list(certifiers),
                "engine": default_engine(),
            }
        )


@dataclass(frozen=True, kw_only=True)
class ZooRecord(Tally, JournalEntry):
    """What every certifier says of a family, or of a block of random instances.

    Attributes
    ----------
    family : its name
    seed : the first one of a block; None for a named family
    quick : whether it is of the quick profile
    certifiers : those that were run
    falsely_certified : by certifier, the names of a named family's points
    """

    family: str
    seed: int | None = None
    quick: bool = False
    certifiers: Sequence[str] = ()
    falsely_certified: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """What reports call it."""
        return Job(self.family, self.seed).label

    @property
    def why_missing(self) -> str:
        """Why there are no points, or empty."""
        return "" if self.points else "not run: its file is not here"
