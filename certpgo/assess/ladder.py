"""Every bound on a graph: what it needs, its run time, and what it implies here.

Two kinds of rungs. Lower bounds on F* are compared with the cost of an answer. Angles speak of
stationary rotations alone: where all residuals stay below one, those rotations are optimal.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from certpgo import registry
from certpgo.certify import Certificate, Verdict, certify
from certpgo.certify.bounds import (
    alpha_max,
    cycle_bound,
    cycle_sum_holds,
    fiedler_value,
    normalized_fiedler_value,
    row_bound,
)
from certpgo.certify.case import SETTLED
from certpgo.errors import CertPGOError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.cycles import is_cycle
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize import spectral
from certpgo.optimize.newton import NewtonSettings, newton
from certpgo.registry import build, setting_fields
from certpgo.solvers.certified.pipeline import solve

#: The method whose value is the rung of the semidefinite program.
PROGRAM = "sdp_dual"
#: Lower bounds within this part of F are as good as F.
TIGHT = 1e-6

About = Literal["cost", "angle", "ratio"]
T = TypeVar("T")


@dataclass(frozen=True)
class Rung:
    """One bound.

    Attributes
    ----------
    key, title : its name, for programs and for people
    about : what it bounds: the ``"cost"`` F from below; each residual ``"angle"`` of stationary
        rotations that are optimal, or their sum, radians; or the ``"ratio"`` of a node's residuals
        to its weight
    value : of the bound; None where there is none, for a reason that ``says`` gives
    against : what it is compared with: F, the largest residual angle (their sum), the largest ratio
    holds : whether it shows the estimate (the stationary rotations near it) to be optimal; of
        computed lower bounds, up to `TIGHT`; None without a value
    needs : what it takes to compute
    seconds : what it took here
    says : what follows here, in words
    """

    key: str
    title: str
    about: About
    value: float | None
    against: float
    holds: bool | None
    needs: str
    seconds: float
    says: str

    @property
    def shown(self) -> str:
        """The value with its unit, or a dash."""
        if self.value is None:
            return "-"
        if self.about == "angle":
            return f"{math.degrees(self.value):.4g} deg"
        return f"{self.value:.10g}" if self.about == "cost" else f"{self.value:.4g} of its weight"


@dataclass(frozen=True, eq=False)
class Ladder:
    """The bounds of a connected graph, cheap ones first.

    Attributes
    ----------
    cost : F of the estimate, given or found
    given : whether it was given
    largest : its largest residual angle, radians
    settled : largest residual angle of the stationary rotations near it, radians, which the
        angles are compared with; None where descent reached none
    certificate : of the estimate
    rungs : one bound each
    """

    cost: float
    given: bool
    largest: float
    settled: float | None
    certificate: Certificate
    rungs: tuple[Rung, ...]


def ladder(
    problem: Problem, estimate: Estimate | None = None, *, sdp: bool = False, force: bool = False
) -> Ladder:
    """Climb the ladder.

    Parameters
    ----------
    estimate : what bounds are compared with; by default the certified pipeline's answer
    sdp : solve the semidefinite program as well
    force : even where it is too large for its solver

    Raises
    ------
    InputError
        An estimate of another graph.
    NumericalError
        No estimate was given, and none found.
    """
    if estimate is None:
        found, seconds = _timed(lambda: solve(problem.graph))
        point, certificate, proven = found.estimate, found.certificate, found.certificate
    else:
        problem.check(point := estimate)
        (certificate, proven), seconds = _timed(lambda: _certificates(problem, point))
    stationary = _stationary_rotations(problem, point)
    F = _Cost(problem.cost(point), certificate.cost_upper)
    rungs = [*_spectral(problem, F), *_angles(problem, stationary)]
    rungs.append(_program(problem, F, force) if sdp else _unasked(F))
    rungs.append(_proven(proven, F, seconds))
    angles = problem.rotation.residual_angles
    return Ladder(
        cost=F.computed,
        given=estimate is not None,
        largest=float(angles(point).max()),
        settled=None if stationary is None else float(angles(stationary).max()),
        certificate=certificate,
        rungs=tuple(_in_view_of_earlier(rungs)),
    )


def rungs_of_eigenvalues(
    problem: Problem, estimate: Estimate, certificate: Certificate
) -> tuple[Rung, ...]:
    """The rungs that a few eigenvalues give, for an estimate that is certified already."""
    F = _Cost(problem.cost(estimate), certificate.cost_upper)
    stationary = _stationary_rotations(problem, estimate)
    return tuple(_in_view_of_earlier([*_spectral(problem, F), *_angles(problem, stationary)]))


def _certificates(problem: Problem, point: Estimate) -> tuple[Certificate, Certificate]:
    """That of the point, and the one with the higher bound: it, or that of our own answer."""
    own = certify(problem, point)
    if own.verdict is Verdict.CERTIFIED or own.basin_is_global:
        return own, own
    searched = solve(problem.graph, initial=point).certificate
    return own, max(own, searched, key=lambda certificate: certificate.lower_bound)


def _in_view_of_earlier(rungs: list[Rung]) -> Iterator[Rung]:
    """The rungs; of a bound on F below an earlier one it is said that it takes nothing away."""
    highest: Rung | None = None
    for rung in rungs:
        if rung.about != "cost" or rung.value is None:
            yield rung
        elif highest and highest.value and rung.value < highest.value * (1 - TIGHT):
            unproven = ", not proven" * (rung.key == "proven")
            higher = f"the bound by {highest.title} is higher{unproven}"
            yield replace(rung, says=f"{rung.says}; {higher}")
        else:
            highest = rung
            yield rung


class _Cost(NamedTuple):
    """F of the answer: as computed, and rounded up, which no lower bound exceeds."""

    computed: float
    upper: float


def _stationary_rotations(problem: Problem, point: Estimate) -> Estimate | None:
    found = newton(
        problem.rotation, Estimate.trusted(point.rotations), NewtonSettings(max_iterations=200)
    )
    settled = problem.rotation.stationarity(found.estimate) <= SETTLED
    return found.estimate if settled else None


def _timed(step: Callable[[], T]) -> tuple[T, float]:
    start = time.perf_counter()
    result = step()
    return result, time.perf_counter() - start


def _eigenvalues(step: Callable[[], T]) -> tuple[T | None, str, float]:
    """What a step found or why it did not, and its seconds."""
    start = time.perf_counter()
    found, why = None, ""
    try:
        found = step()
    except (NumericalError, np.linalg.LinAlgError) as error:
        why = f"not computed: {error}"
    return found, why, time.perf_counter() - start


def _spectral(problem: Problem, F: _Cost) -> Iterator[Rung]:
    rotation, alone = problem.rotation, isinstance(problem, PoseProblem)
    value, why, seconds = _eigenvalues(
        lambda: spectral.spectral_bound(rotation, spectral.smallest_eigenpairs(rotation))
    )
    title = "eigenvalues" + ", rotations alone" * alone
    needs = f"{problem.d} eigenvalues of the rotations' matrix"
    yield _lower("spectral", title, value, F, needs, seconds, why)
    if isinstance(problem, PoseProblem):
        poses = problem
        value, why, seconds = _eigenvalues(
            lambda: spectral.spectral_bound(poses, spectral.eliminated_eigenpairs(poses))
        )
        title, needs = "eigenvalues, translations eliminated", f"{problem.d} more costly ones"
        yield _lower("spectral_poses", title, value, F, needs, seconds, why)


def _lower(
    key: str,
    title: str,
    value: float | None,
    F: _Cost,
    needs: str,
    seconds: float,
    why: str = "",
    *,
    proven: str = "",
) -> Rung:
    """A rung that bounds F from below, or the reason why there is none."""
    cost = F.computed
    if value is not None and value > F.upper:
        value, why = None, f"not a bound: the computed value, {value:.10g}, is above F"
    if value is None:
        return Rung(key, title, "cost", None, cost, None, needs, seconds, why)
    gap = cost - value
    holds = gap <= TIGHT * cost
    if value <= 0.0 and cost > 0.0:
        says = "nothing: no cost is negative"
    elif holds:
        says = f"this estimate is optimal, to six digits{proven}"
    else:
        says = f"this estimate is at most {_percent(gap / value)} above the optimum{proven}"
    return Rung(key, title, "cost", value, cost, holds, needs, seconds, says)


def _percent(part: float) -> str:
    return f"{100.0 * part:.3g} %" if part < 10.0 else f"{part:.3g} times"


def _angles(problem: Problem, stationary: Estimate | None) -> Iterator[Rung]:
    rotation = problem.rotation
    largest = math.inf if stationary is None else float(rotation.residual_angles(stationary).max())
    fiedler, why, seconds = _eigenvalues(lambda: fiedler_value(rotation))
    by_degree = None if fiedler is None else alpha_max(fiedler / float(rotation.node_weights.max()))
    title, needs = "residual-angle bound, largest degree", "one eigenvalue of the Laplacian"
    yield _angle("alpha_max", title, by_degree, largest, needs, seconds, why)
    nu, why, seconds = _eigenvalues(lambda: normalized_fiedler_value(rotation))
    by_node = None if nu is None else alpha_max(nu)
    title = "residual-angle bound, each node's degree"
    needs = "one eigenvalue of the normalized Laplacian"
    yield _angle("normalized", title, by_node, largest, needs, seconds, why)
    rows, seconds = _timed(
        lambda: math.inf if stationary is None else float(row_bound(rotation, stationary).max())
    )
    holds = None if nu is None else rows < nu
    yield Rung(
        "rows",
        "each node's own residuals",
        "ratio",
        nu,
        rows,
        holds,
        "that eigenvalue and all residuals",
        seconds,
        why
        if holds is None
        else _said(holds, stationary is not None, f"a node has {rows:.4g} of its weight"),
    )
    if not is_cycle(rotation.graph):
        return
    equal = cycle_bound(rotation.graph)
    if equal is not None:
        needs = "one cycle, equal weights"
        yield _angle("cycle", "half a turn over the nodes", equal, largest, needs, 0.0)
    total = math.inf if stationary is None else float(rotation.residual_angles(stationary).sum())
    adds_up = stationary is not None and cycle_sum_holds(rotation, stationary) is True
    yield Rung(
        "cycle_sum",
        "the cycle's residuals, added up",
        "angle",
        math.pi,
        total,
        adds_up,
        "one cycle, residuals about one axis",
        0.0,
        _said(adds_up, stationary is not None, f"they add up to {math.degrees(total):.4g} degrees"),
    )


def _angle(
    key: str,
    title: str,
    value: float | None,
    largest: float,
    needs: str,
    seconds: float,
    why: str = "",
) -> Rung:
    """A rung that all residual angles of stationary rotations must stay below."""
    if value is None:
        return Rung(key, title, "angle", None, largest, None, needs, seconds, why)
    holds = largest <= value
    says = _said(
        holds, math.isfinite(largest), f"a residual is {math.degrees(largest):.4g} degrees"
    )
    return Rung(key, title, "angle", value, largest, holds, needs, seconds, says)


def _said(holds: bool, settled: bool, otherwise: str) -> str:
    if not settled:
        return "nothing: local descent reached no stationary rotations"
    return "the stationary rotations here are optimal" if holds else f"nothing: {otherwise}"


def _unasked(F: _Cost) -> Rung:
    return _sdp(None, F, 0.0, "not requested: --sdp solves it")


def _sdp(value: float | None, F: _Cost, seconds: float, why: str, title: str = "") -> Rung:
    needs = "an interior-point solver"
    return _lower("sdp", f"semidefinite program{title}", value, F, needs, seconds, why)


def _program(problem: Problem, F: _Cost, force: bool) -> Rung:
    """The bound of the relaxation, of the rotations alone, by multipliers that are feasible.

    What the program itself calls its value may lie above F*: its solver's multipliers are feasible
    up to a tolerance only. It is reported in words.
    """
    if PROGRAM not in registry.solver_names():
        return _sdp(None, F, 0.0, f"not solved: no method {PROGRAM} here")
    start = time.perf_counter()
    try:
        options = {"force": True} if force else {}
        known = setting_fields(registry.get_solver(PROGRAM))
        solver = build(PROGRAM, {k: v for k, v in options.items() if k in known})
        found = solver.solve(problem.rotation)
    except CertPGOError as error:
        reason = " ".join(str(error).split())
        return _sdp(None, F, time.perf_counter() - start, f"not solved: {reason}")
    seconds = time.perf_counter() - start
    alone = ", rotations alone" * isinstance(problem, PoseProblem)
    why = f"no bound from it: {found.status.value}"
    rung = _sdp(found.lower_bound, F, seconds, why, alone)
    if found.relaxation is None:
        return rung
    program = found.relaxation
    return replace(
        rung, says=f"{rung.says}; the program says {program.value:.10g} ({program.status})"
    )


def _proven(certificate: Certificate, F: _Cost, seconds: float) -> Rung:
    needs = "a search, and factorizations with bounded rounding"
    bound = certificate.lower_bound
    return _lower("proven", "proven bound", bound, F, needs, seconds, proven=", proven")
