"""The result of one method on one instance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from certpgo.certify import Certificate
from certpgo.optimize.solution import Solution
from reports.harness.experiments.absence import Absence, Missing
from reports.harness.experiments.journal import JournalEntry

#: Iterations that a record keeps of a method.
TRACED = 40
#: How far below and above the estimate's cost the last reported cost may be, relative: reports may
#: end before a last projection, and no cost F ends below it.
ENDS = 1e-6, 1e-3


@dataclass(frozen=True)
class Record(JournalEntry):
    """One method on one instance.

    Attributes
    ----------
    table, row, method : labels, as in the specification
    solver, settings : what was run
    reading : reading options of the instance, as text
    judging : reading options of the graph that metrics were evaluated on, when another
    seed : of a synthetic instance, or None
    d, n, m : dimension, nodes, edges
    metrics : metric to value
    verdict, tier, reason : of the certificate, or empty
    certified_by : the bounds that prove the estimate, or the stationary point near it, optimal
    status, iterations, seconds, counts, note : as the method reported them
    trace : at most `TRACED` rows of seconds and cost as the method went on, of the first seed alone
    absence, error : why there is no estimate, and the same in words; None and empty where there is
    kind : ``"poses"`` or ``"rotations"``, of the graph
    profile : ``"quick"`` or ``"full"``
    parts : how many records have the key, one a component
    objective : the cost that metrics and verdict are about; empty for F
    """

    table: str
    row: str
    method: str
    solver: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    reading: Mapping[str, str] = field(default_factory=dict)
    judging: Mapping[str, str] | None = None
    seed: int | None = None
    d: int | None = None
    n: int | None = None
    m: int | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    verdict: str = ""
    certified_by: str = ""
    tier: str = ""
    reason: str = ""
    status: str = ""
    iterations: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    note: str = ""
    trace: tuple[tuple[float, float], ...] = ()
    absence: Absence | None = None
    error: str = ""
    kind: str = ""
    profile: str = "full"
    parts: int = 1
    objective: str = ""

    def __post_init__(self) -> None:
        if bool(self.absence) != bool(self.error):
            raise ValueError("a missing result has a reason, and words for it")
        # A file has texts and lists.
        if self.absence is not None:
            object.__setattr__(self, "absence", Absence(self.absence))
        object.__setattr__(self, "trace", tuple((time, cost) for time, cost in self.trace))

    @property
    def why_missing(self) -> str:
        """Why there is no estimate, as a table says it, or empty."""
        return "" if self.absence is None else str(Missing(self.absence, self.error))


def of_solution(solution: Solution) -> dict[str, Any]:
    """The fields of a record that say how a method ended and what it did."""
    return {
        "status": solution.status.value,
        "iterations": solution.iterations,
        "seconds": dict(solution.seconds),
        "counts": dict(solution.counts),
    }


def trace_of(solution: Solution) -> tuple[tuple[float, float], ...]:
    """Seconds and cost by iteration; early iterations are kept more densely than late ones.

    Empty for methods that report another cost: robust ones, and those that do not end at F.
    """
    reported = [iteration for iteration in solution.trace if math.isfinite(iteration.cost)]
    below, above = ENDS
    F = solution.cost
    ends = reported and -below * F <= reported[-1].cost - F <= above * F
    if not ends or solution.weights is not None:
        return ()
    if len(reported) > TRACED:
        places = np.geomspace(1, len(reported), TRACED).round().astype(int) - 1
        reported = [reported[place] for place in np.unique(places)]
    return tuple((float(f"{it.seconds:.6g}"), float(f"{it.cost:.12g}")) for it in reported)


def of_certificate(certificate: Certificate) -> dict[str, Any]:
    """The fields of a record that hold the verdict."""
    return {
        "verdict": certificate.verdict.value,
        "tier": certificate.tier.value,
        "reason": certificate.reason,
    }
