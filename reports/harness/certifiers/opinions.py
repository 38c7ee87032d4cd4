"""What every certifier says of a point, and where that is false."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from certpgo import certify
from certpgo.certify import Tier, Verdict
from certpgo.errors import InputError, MissingDependency
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from reports.harness.certifiers import oracle, rules
from reports.harness.certifiers.points import Known, ZooPoint
from reports.harness.experiments.zoo_records import ALL, FAULTS, Outcome, Tally

#: Nodes up to which an interval factorization confirms bounds.
MOST_NODES = 200


@dataclass(frozen=True, eq=False)
class Opinion:
    """What a certifier says of a point.

    Attributes
    ----------
    certified : the estimate that it calls optimal, or None
    lower_bound : no estimate costs less, it says
    better : an estimate that it calls better by more than the tolerance, or None
    basin : another estimate that it calls optimal, or None
    multipliers : (n, d, d) what the lower bound rests on, or None where that is a surrogate
    undecided : whether it decides nothing
    """

    certified: Estimate | None
    lower_bound: float = -np.inf
    better: Estimate | None = None
    basin: Estimate | None = None
    multipliers: FloatArray | None = None
    undecided: bool = False


Certifier = Callable[[Quadratic | Sum, Estimate], Opinion]


def certifiers() -> dict[str, Certifier]:
    """Ours, one per tier and the standard one on the point alone; then the competitors'."""
    asked = {f"certpgo {t.value}": _ours(t, True) for t in Tier if t is not Tier.SCREEN}
    asked["certpgo standard, unrefined"] = _ours(Tier.STANDARD, False)
    for name in rules.rule_names():
        asked[name] = _theirs(name)
    return asked


def tally_of(case: ZooPoint, asked: dict[str, Certifier]) -> Tally:
    """What every certifier says of a point."""
    outcomes: dict[str, Counter[str]] = {
        name: Counter(_outcomes(case, certifier)) for name, certifier in asked.items()
    }
    faults = [
        f"{case.name}: {name}: {outcome}"
        for name, counts in outcomes.items()
        for outcome in counts
        if outcome in (*FAULTS, Outcome.FAILED) and name.startswith("certpgo")
    ]
    return Tally(points=Counter(_facts(case)), outcomes=outcomes, faults=faults)


def _facts(case: ZooPoint) -> Iterator[str]:
    yield ALL
    yield case.truth.known.value
    if case.truth.loose:
        yield "loose"
    if not case.feasible:
        yield "infeasible"
    elif case.is_beaten(case.point):
        yield "not optimal"
    elif case.is_optimal(case.point):
        yield "optimal"
    else:
        yield "open point" if case.truth.known is Known.OPEN else "borderline"


def _outcomes(case: ZooPoint, certifier: Certifier) -> Iterator[Outcome]:
    try:
        with np.errstate(all="ignore"):
            opinion = certifier(case.problem, case.point)
    except MissingDependency:
        yield Outcome.NOT_INSTALLED
        return
    except InputError:
        yield Outcome.REFUSED
        return
    except Exception:  # the zoo goes on whatever a certifier raises
        opinion = None
    if opinion is None:
        yield Outcome.FAILED
    else:
        yield Outcome.NOT_CERTIFIED if opinion.certified is None else Outcome.CERTIFIED
        yield from _faults(case, opinion)
        if opinion.undecided and case.truth.lower > case.tolerance(case.truth.upper):
            yield Outcome.NO_ANSWER
    missed = opinion is None or (opinion.certified is None and not _is_refuted(case, opinion))
    if missed and case.feasible and case.is_optimal(case.point):
        yield Outcome.MISSED_LOOSE if case.truth.loose else Outcome.MISSED


def _faults(case: ZooPoint, opinion: Opinion) -> Iterator[Outcome]:
    if opinion.certified is not None:
        # What is no estimate cannot be the best one.
        feasible = opinion.certified is not case.point or case.feasible
        if not feasible or case.is_beaten(opinion.certified):
            yield Outcome.FALSE
        elif case.truth.known is Known.OPEN:
            yield Outcome.UNCONFIRMED
    if opinion.lower_bound > case.truth.upper:
        yield Outcome.FALSE_BOUND
    if opinion.better is not None and not _is_refuted(case, opinion):
        yield Outcome.FALSE_REFUTATION
    if opinion.basin is not None and case.is_beaten(opinion.basin):
        yield Outcome.FALSE_BASIN
    problem = case.problem
    if opinion.multipliers is not None and problem.n <= MOST_NODES and not isinstance(problem, Sum):
        holds = oracle.is_proof(problem, opinion.multipliers)
        if holds is False and problem.d == 2 and problem.has_positions:
            holds = oracle.is_proof(problem, opinion.multipliers, over_complex=True)
        if holds is False:
            yield Outcome.FALSE_PROOF
        else:
            yield Outcome.CONFIRMED if holds else Outcome.UNDECIDED


def _is_refuted(case: ZooPoint, opinion: Opinion) -> bool:
    """Whether an estimate that is called better costs less, in interval arithmetic."""
    if opinion.better is None or not case.feasible:
        return False
    _, theirs = oracle.cost(case.problem, opinion.better)
    return theirs < oracle.cost(case.problem, case.point)[0]


def _ours(tier: Tier, refine: bool) -> Certifier:
    def certifier(problem: Quadratic | Sum, point: Estimate) -> Opinion:
        estimate = Estimate(point.rotations, point.translations)  # which checks its matrices
        certificate = certify(problem, estimate, tier=tier, refine=refine)
        return Opinion(
            estimate if certificate.verdict is Verdict.CERTIFIED else None,
            certificate.lower_bound,
            certificate.better if certificate.verdict is Verdict.REFUTED else None,
            certificate.refined if certificate.basin_is_global else None,
            None if isinstance(problem, Sum) else certificate.multipliers,
            certificate.verdict is Verdict.UNDECIDED,
        )

    return certifier


def _theirs(name: str) -> Certifier:
    rule = rules.get_rule(name)

    def certifier(problem: Quadratic | Sum, point: Estimate) -> Opinion:
        if isinstance(problem, Sum):
            raise InputError(f"{name} is about F")
        return Opinion(rule(problem, point))

    return certifier
