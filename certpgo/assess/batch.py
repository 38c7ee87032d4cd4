"""Many answers to one graph, judged one after another; what is proven once serves them all."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from certpgo.assess.assessment import Assessment, assess
from certpgo.certify.judge import Judge
from certpgo.errors import CertPGOError, InputError
from certpgo.graph import Estimate, Instance
from certpgo.io import read_estimate
from certpgo.io.digits import Writing
from certpgo.io.writing import atomically
from certpgo.objective.problem import Problem

#: The verdict of what could not be read or judged.
ERROR = "ERROR"


@dataclass(frozen=True)
class JudgedEstimate:
    """One answer to one connected graph; the fields are the columns of the CSV.

    Attributes
    ----------
    estimate, graph : what was judged, and for what
    verdict : or ``ERROR``, the reason then being the error and all numbers None
    cost : F of the estimate, as computed
    lower_bound, gap, relative_gap, refined_cost : as in `certpgo.certify.Certificate`
    best_cost : F of the best answer in hand, see `certpgo.assess.assessment.Assessment`
    mean_deg, worst_deg, mean_m, worst_m : distance to that one, degrees and metres
    reason : one sentence
    """

    estimate: str
    graph: str
    verdict: str
    reason: str
    cost: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    relative_gap: float | None = None
    refined_cost: float | None = None
    best_cost: float | None = None
    mean_deg: float | None = None
    worst_deg: float | None = None
    mean_m: float | None = None
    worst_m: float | None = None


@dataclass(frozen=True)
class JudgedGraph:
    """A connected graph, its problem, and who judges answers to it."""

    instance: Instance
    problem: Problem
    judge: Judge

    def assessed(self, estimate: Estimate, writing: Writing | None = None) -> Assessment:
        """The verdict on an answer, and what else there is to say of it."""
        certificate = self.judge.certify(estimate)
        return assess(self.problem, estimate, certificate, ids=self.instance.ids, writing=writing)


def estimates_for(
    path: Path, whole: Instance, parts: Sequence[Instance], timestamps: str | Path = "ids"
) -> list[Estimate]:
    """The estimate of each part, of a file that covers the whole graph, or the one part.

    Raises
    ------
    InputError
        The file is unusable, or another graph's.
    """
    if len(parts) == 1 and parts[0] is whole:
        return [read_estimate(path, whole, timestamps=timestamps)]
    try:
        estimate = read_estimate(path, whole, timestamps=timestamps)
    except InputError:
        if len(parts) != 1:
            raise
        return [read_estimate(path, parts[0], timestamps=timestamps)]
    return [estimate.subset(np.searchsorted(whole.ids, part.ids)) for part in parts]


def judge_all(
    names: Iterable[str], parts: Sequence[JudgedGraph], read: Callable[[str], Sequence[Estimate]]
) -> Iterator[JudgedEstimate]:
    """The rows of each answer, as they are made; what cannot be read is a row with its error.

    Parameters
    ----------
    read : from a name to the estimate of each part
    """
    for name in names:
        try:
            for part, estimate in zip(parts, read(name), strict=True):
                yield _row(name, part.instance.name, part.assessed(estimate))
        except (CertPGOError, OSError) as error:
            yield JudgedEstimate(name, "", ERROR, " ".join(str(error).split()))


def write_rows(path: Path, rows: Iterable[JudgedEstimate]) -> None:
    """The rows as CSV, whole or not at all; numbers to the last digit.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    # The reason, being the longest, comes last.
    columns = sorted(
        (field.name for field in fields(JudgedEstimate)), key=lambda name: name == "reason"
    )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(getattr(row, name)) for name in columns] for row in rows)
    atomically(path, lambda beside: beside.write_text(text.getvalue(), encoding="utf-8"))


def _row(name: str, graph: str, a: Assessment) -> JudgedEstimate:
    c = a.certificate
    return JudgedEstimate(
        estimate=name,
        graph=graph,
        verdict=c.verdict.value,
        reason=c.reason,
        cost=a.cost,
        lower_bound=c.lower_bound,
        gap=c.gap,
        relative_gap=c.relative_gap,
        refined_cost=c.refined_cost,
        best_cost=a.best_cost,
        mean_deg=a.distance.mean_deg,
        worst_deg=a.distance.worst_deg,
        mean_m=a.distance.mean_m,
        worst_m=a.distance.worst_m,
    )


def _cell(value: str | float | None) -> str:
    if isinstance(value, str):
        return value
    return repr(value) if value is not None and math.isfinite(value) else ""
