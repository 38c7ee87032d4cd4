"""Many estimates of one graph, certified in turn; they share the bounds proven for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

from certpgo.certify.certificate import of_instance
from certpgo.certify.region import limits
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Instance
from certpgo.io.csv_files import write_csv
from certpgo.io.digits import Writing
from certpgo.objective.choose_cost import Judged
from certpgo.solve.assessment import Assessment, assess
from certpgo.solve.fit import fit_of
from certpgo.solve.judging import Judge

#: Verdict for estimates that could not be read or certified.
ERROR = "ERROR"


@dataclass(frozen=True)
class JudgedEstimate:
    """One estimate of one connected graph; the fields are the columns of the CSV.

    Attributes
    ----------
    estimate, graph : names of the estimate and of the graph
    verdict : the verdict, or ``ERROR``: then ``reason`` is the error and all numbers are None
    cost : F of the estimate, as computed
    lower_bound, gap, relative_gap, refined_cost : as in `certpgo.certify.Certificate`
    best_cost : F of the best estimate found, see `certpgo.solve.assessment.Assessment`
    chi2, degrees_of_freedom : as in `certpgo.solve.fit.Fit`
    mean_deg, worst_deg, mean_m, worst_m : distance to that estimate, degrees and metres
    distance_m, distance_deg : the largest distance and angle of any node from where any optimum has
        it, proven, as in `certpgo.certify.region.ProvenDistance`; None where nothing is known
    objective : the cost that is meant by F
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
    chi2: float | None = None
    degrees_of_freedom: int | None = None
    distance_m: float | None = None
    distance_deg: float | None = None
    objective: str = ""


@dataclass(frozen=True)
class JudgedPart:
    """A connected graph, its problem, and the certifier of its estimates."""

    instance: Instance
    problem: Judged
    judge: Judge

    def assessed(self, estimate: Estimate, writing: Writing | None = None) -> Assessment:
        """The certificate of an estimate, and its comparison with the best one."""
        certificate = of_instance(self.judge.certify(estimate), self.instance, estimate)
        return assess(
            self.problem,
            estimate,
            certificate,
            instance=self.instance,
            writing=writing,
            fitting=partial(fit_of, self.instance, self.problem),
        )


def judge_all(
    names: Iterable[str], read: Callable[[str], Iterable[tuple[JudgedPart, Estimate]]]
) -> Iterator[JudgedEstimate]:
    """The rows of each estimate; one that cannot be read becomes a row with the error.

    They end with an estimate whose certification was interrupted.

    Parameters
    ----------
    read : returns the graphs that an estimate is of, with their estimates, given a name
    """
    for name in names:
        try:
            for part, estimate in read(name):
                yield _row(name, part.instance.name, part.assessed(estimate))
                if part.judge.interrupted:
                    return
        except (CertPGOError, OSError) as error:
            yield JudgedEstimate(name, "", ERROR, " ".join(str(error).split()))


def write_rows(path: Path, rows: Iterable[JudgedEstimate]) -> None:
    """Write the rows as CSV in full precision; an incomplete file is never left behind.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    # The reason is longest and comes last.
    columns = sorted(
        (field.name for field in fields(JudgedEstimate)), key=lambda name: name == "reason"
    )
    write_csv(path, columns, ([getattr(row, name) for name in columns] for row in rows))


def _row(name: str, graph: str, a: Assessment) -> JudgedEstimate:
    c = a.certificate
    distance_m, distance_deg = limits(c.stated_distance())
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
        chi2=None if a.fit is None else a.fit.chi2,
        degrees_of_freedom=None if a.fit is None else a.fit.freedom,
        distance_m=distance_m,
        distance_deg=distance_deg,
        objective=c.cost_in_words if c.broken else c.objective,
    )
