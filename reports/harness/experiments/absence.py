"""Why there is no result, as data: a reason that code can ask for, and the words for a reader."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from certpgo.errors import CertPGOError, FileNotHere, InputError, MissingDependency
from certpgo.solve.comparison import in_one_line
from reports.harness.experiments.limits import OutOfTime


class Absence(StrEnum):
    """Why a record or figure has no result."""

    NOT_HERE = "not here"
    LEFT_OUT = "left out"
    TOO_LARGE = "too large"
    MISSING_PACKAGE = "missing package"
    TIME_LIMIT = "time limit"
    OUT_OF_MEMORY = "out of memory"
    PROCESS_DIED = "process died"
    FAILED = "failed"
    ELSEWHERE = "ended elsewhere"

    @property
    def is_not_run(self) -> bool:
        """Whether it was never started, by choice or because its data are not here."""
        return self in (Absence.NOT_HERE, Absence.LEFT_OUT, Absence.TOO_LARGE)

    @property
    def is_failure(self) -> bool:
        """Whether it was started and failed."""
        known = (Absence.MISSING_PACKAGE, Absence.ELSEWHERE)
        return not self.is_not_run and self not in known


class Missing(NamedTuple):
    """Why there is no result, in the fields of a record.

    Attributes
    ----------
    absence : the reason
    error : the same in words
    """

    absence: Absence
    error: str

    def __str__(self) -> str:
        return f"not run: {self.error}" if self.absence.is_not_run else self.error


#: Why there is no result of a process that died.
DIED = Missing(
    Absence.PROCESS_DIED,
    "the process that ran it was killed (out of memory, or it did not respond to its time limit)",
)


class NotRun(InputError):  # noqa: N818 - the condition is the name
    """Something is not run, for a reason that is no failure."""

    def __init__(self, absence: Absence, reason: str) -> None:
        self.absence = absence
        super().__init__(reason)


def missing(error: Exception | OutOfTime) -> Missing:
    """Why there is no result where this was raised."""
    match error:
        case NotRun():
            return Missing(error.absence, str(error))
        case FileNotHere():
            return Missing(Absence.NOT_HERE, str(error))
        case MissingDependency():
            return Missing(Absence.MISSING_PACKAGE, str(error))
        case OutOfTime():
            return Missing(Absence.TIME_LIMIT, str(error))
        case MemoryError():
            return Missing(Absence.OUT_OF_MEMORY, "not enough memory")
        case CertPGOError():
            return Missing(Absence.FAILED, str(error))
    return Missing(Absence.FAILED, in_one_line(error))
