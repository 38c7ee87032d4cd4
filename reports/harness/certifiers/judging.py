"""Every certifier on a case: what it says, and where that is false."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.certify import Tier, Verdict, certify
from certpgo.errors import InputError, MissingDependency
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import Problem
from reports.harness.certifiers import oracle, rules
from reports.harness.certifiers.points import JudgedPoint, Known

#: What may be false of a certifier's answer; that it fails, and what it may otherwise lack.
FALSE, BOUND, REFUTATION, BASIN = "false", "false bound", "false refutation", "false basin"
PROOF = "false proof"
FAULTS = (FALSE, BOUND, REFUTATION, BASIN, PROOF)
#: What an interval factorization says of the multipliers that a bound rests on.
CONFIRMED, UNDECIDED = "bound confirmed", "bound undecided"
#: Nodes up to which it is asked.
MOST_NODES = 200
FAILED, MISSED, LOOSE, UNCONFIRMED = "failed", "missed", "missed, loose", "unconfirmed"
#: Of ours: UNDECIDED though a lower bound above the tolerance exists.
NO_ANSWER = "no answer"

Tally = Counter[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class Opinion:
    """What a certifier says of a point.

    Attributes
    ----------
    certified : the estimate that it calls optimal, or None
    lower_bound : no estimate costs less, it says
    better : an estimate that it calls better by more than the tolerance, or None
    basin : an estimate that it calls optimal besides, or None
    multipliers : (n, d, d) what the lower bound rests on, or None
    undecided : whether it has no answer
    """

    certified: Estimate | None
    lower_bound: float = -np.inf
    better: Estimate | None = None
    basin: Estimate | None = None
    multipliers: FloatArray | None = None
    undecided: bool = False


Judge = Callable[[Problem, Estimate], Opinion]


def certifiers() -> dict[str, Judge]:
    """Ours, one a tier and the standard one on the point alone; then the competitors'."""
    judges = {f"certpgo {t.value}": _ours(t, True) for t in Tier if t is not Tier.SCREEN}
    judges["certpgo standard, unrefined"] = _ours(Tier.STANDARD, False)
    for name in rules.rule_names():
        judges[name] = _theirs(name)
    return judges


def judged(case: JudgedPoint, judges: dict[str, Judge]) -> tuple[Tally, list[str]]:
    """Counts by certifier and outcome, and what is false of ours, or failed, in words."""
    tally: Tally = Counter()
    for fact in _facts(case):
        tally["", fact] += 1
    faults = []
    for name, judge in judges.items():
        for outcome in _outcomes(case, judge):
            tally[name, outcome] += 1
            if outcome in (*FAULTS, FAILED) and name.startswith("certpgo"):
                faults.append(f"{case.name}: {name}: {outcome}")
    return tally, faults


def _facts(case: JudgedPoint) -> Iterator[str]:
    yield "points"
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


def _outcomes(case: JudgedPoint, judge: Judge) -> Iterator[str]:
    try:
        with np.errstate(all="ignore"):
            opinion = judge(case.problem, case.point)
    except MissingDependency:
        yield "not installed"
        return
    except InputError:
        yield "refused"
        return
    except Exception:  # a zoo survives whatever a certifier raises
        opinion = None
    if opinion is None:
        yield FAILED
    else:
        yield "not certified" if opinion.certified is None else "certified"
        yield from _faults(case, opinion)
        if opinion.undecided and case.truth.lower > case.tolerance(case.truth.upper):
            yield NO_ANSWER
    missed = opinion is None or (opinion.certified is None and not _is_refuted(case, opinion))
    if missed and case.feasible and case.is_optimal(case.point):
        yield LOOSE if case.truth.loose else MISSED


def _faults(case: JudgedPoint, opinion: Opinion) -> Iterator[str]:
    if opinion.certified is not None:
        # What is no estimate cannot be the best one.
        feasible = opinion.certified is not case.point or case.feasible
        if not feasible or case.is_beaten(opinion.certified):
            yield FALSE
        elif case.truth.known is Known.OPEN:
            yield UNCONFIRMED
    if opinion.lower_bound > case.truth.upper:
        yield BOUND
    if opinion.better is not None and not _is_refuted(case, opinion):
        yield REFUTATION
    if opinion.basin is not None and case.is_beaten(opinion.basin):
        yield BASIN
    if opinion.multipliers is not None and case.problem.n <= MOST_NODES:
        holds = oracle.is_proof(case.problem, opinion.multipliers)
        yield PROOF if holds is False else CONFIRMED if holds else UNDECIDED


def _is_refuted(case: JudgedPoint, opinion: Opinion) -> bool:
    """Whether an estimate that is called better costs less, in interval arithmetic."""
    if opinion.better is None or not case.feasible:
        return False
    _, theirs = oracle.cost(case.problem, opinion.better)
    return theirs < oracle.cost(case.problem, case.point)[0]


def _ours(tier: Tier, refine: bool) -> Judge:
    def judge(problem: Problem, point: Estimate) -> Opinion:
        estimate = Estimate(point.rotations, point.translations)  # which checks its matrices
        certificate = certify(problem, estimate, tier=tier, refine=refine)
        return Opinion(
            estimate if certificate.verdict is Verdict.CERTIFIED else None,
            certificate.lower_bound,
            certificate.better if certificate.verdict is Verdict.REFUTED else None,
            certificate.refined if certificate.basin_is_global else None,
            certificate.multipliers,
            certificate.verdict is Verdict.UNDECIDED,
        )

    return judge


def _theirs(name: str) -> Judge:
    certifier = rules.get_rule(name)
    return lambda problem, point: Opinion(certifier(problem, point))
