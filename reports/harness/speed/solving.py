"""Solving and certifying public sets, under each cost, next to GTSAM, g2o, Ceres and SE-Sync."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from certpgo import certify
from certpgo.certify import Certificate
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Instance
from certpgo.io import datasets
from certpgo.objective.choose_cost import CHORDAL, objective_of
from certpgo.optimize.solution import Status
from certpgo.registry import build
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.solving import solve
from reports.harness.experiments.absence import Missing, missing
from reports.harness.experiments.reference import step_of
from reports.harness.experiments.spec import Method
from reports.harness.speed.measuring import Comparison, Group, Timer, Timers, processor
from reports.harness.speed.programs import se_sync

SECTION = "solving"
SETS = (
    "intel",
    "MIT",
    "kitti_00",
    "manhattan",
    "city10000",
    "smallGrid3D",
    "parking-garage",
    "sphere2500",
    "torus3D",
    "sphere_bignoise_vertex3",
)
#: Of the quick sample.
SAMPLE = ("MIT",)
COSTS = (CHORDAL, "g2o", "gtsam")
#: What GTSAM does: its chordal initialization, in 2D LAGO, then Gauss-Newton.
GTSAM = Method("gtsam_gauss_newton", start=Method("gtsam_chordal"))
ISOTROPIC, FULL = "GTSAM, isotropic weights", "GTSAM"
OF_G2O, OF_CERES, OF_SE_SYNC = "g2o's Gauss-Newton", "Ceres' Levenberg-Marquardt", "SE-Sync"
#: Optimizers of g2o's cost, by what their steps are called.
OPTIMIZERS = {OF_G2O: "g2o_gauss_newton", OF_CERES: "ceres_levenberg_marquardt"}


def groups(quick: bool) -> Iterator[Group]:
    """One for each set: all costs in turn with all other programs."""
    for name in SAMPLE if quick else SETS:
        timers = functools.partial(_set, name)
        yield Group(SECTION, name, timers, comparisons(), rounds=2 if quick else 5)


def comparisons() -> tuple[Comparison, ...]:
    """What is compared on a set, and what the ratios should stay below."""
    peers = {
        CHORDAL: ((ISOTROPIC, None), (OF_SE_SYNC, 0.2)),
        "g2o": ((OF_G2O, 1.0), (OF_CERES, 1.0)),
        "gtsam": ((FULL, 0.5),),
    }
    found = []
    for cost, others in peers.items():
        found += [Comparison(solving(cost), other, goal) for other, goal in others]
        found.append(Comparison(certifying(cost), solving(cost), 1.0))
    return tuple(found)


def solving(cost: str) -> str:
    """The step that solves under a cost."""
    return f"solve, cost {cost}"


def certifying(cost: str) -> str:
    """The step that certifies the estimate of `solving`."""
    return f"certify, cost {cost}"


@contextmanager
def _set(name: str) -> Iterator[Timers]:
    instance = datasets.load(name, download=False, quiet=True)
    path = datasets.fetch(name, download=False)
    timers: dict[str, Timer | Missing] = {}
    for cost in COSTS:
        timers |= certified(instance, cost)
    timers[ISOTROPIC] = or_missing(lambda: of_gtsam(instance, CHORDAL))
    timers[FULL] = or_missing(lambda: of_gtsam(instance, "gtsam"))
    start = solve(instance, cost=CHORDAL).estimate
    for called, method in OPTIMIZERS.items():
        timers[called] = or_missing(functools.partial(of_optimizer, method, instance, start))
    timers[OF_SE_SYNC] = se_sync(path)
    yield timers


def or_missing(make: Callable[[], Timer]) -> Timer | Missing:
    """The timer, or why it cannot be made here."""
    try:
        return make()
    except CertPGOError as error:
        return missing(error)


def certified(instance: Instance, cost: str, calls: int = 1) -> Timers:
    """Timers of `certpgo.solve` and `certpgo.certify`, from the instance in memory."""
    try:
        estimate = solve(instance, cost=cost).estimate
    except CertPGOError as error:
        return dict.fromkeys((solving(cost), certifying(cost)), missing(error))
    return {
        solving(cost): processor(
            lambda: finished(solve(instance, cost=cost)),
            _answered,
            calls=calls,
            cost=lambda answer: answer.cost,
        ),
        certifying(cost): processor(
            lambda: certify(instance, estimate, cost=cost), _judged, calls=calls
        ),
    }


def finished(answer: CertifiedSolution) -> CertifiedSolution:
    """The answer; KeyboardInterrupt if Ctrl-C has ended the search, which is no measurement."""
    if answer.solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return answer


def _answered(answer: CertifiedSolution) -> str:
    return f"{_judged(answer.certificate)} ({shares(answer)})"


def shares(answer: CertifiedSolution) -> str:
    """How the phases of a search share its time, in percent."""
    seconds = answer.solution.seconds
    whole = sum(seconds.values())
    return ", ".join(f"{phase} {spent / whole:.0%}" for phase, spent in seconds.items())


def _judged(found: Certificate) -> str:
    return f"{found.verdict.value}, {found.cost_upper:.8g}"


def of_gtsam(instance: Instance, cost: str, calls: int = 1) -> Timer:
    """A timer of GTSAM on its own graph object, built beforehand; it says the cost it ends at."""
    step = step_of(GTSAM, lambda: objective_of(instance, cost))
    return processor(step, calls=calls, cost=functools.partial(_ended, instance, cost))


def of_optimizer(method: str, instance: Instance, start: Estimate, calls: int = 1) -> Timer:
    """A timer of an optimizer of g2o's cost from a given start, on its own graph object.

    What pyceres spends in Python, where residuals are computed, is not counted.
    """
    solver: Any = build(method, {})
    step = solver.prepared(objective_of(instance, "g2o"), start)
    return processor(
        step,
        calls=calls,
        spared=lambda outcome: outcome.evaluating,
        cost=functools.partial(_ended, instance, "g2o"),
    )


def _ended(instance: Instance, cost: str, outcome: Any) -> float:
    return float(objective_of(instance, cost).cost(outcome.estimate))
