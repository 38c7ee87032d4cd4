"""Every bound on a graph: its requirements, run time and implication for an estimate.

Lower bounds on F* are compared with the cost of an estimate. Residual-angle bounds are about
stationary rotations only: these are optimal if all their residuals stay below one of the bounds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from certpgo import registry
from certpgo.certify import Certificate, Verdict
from certpgo.certify.bounds import (
    alpha_max,
    cycle_bound,
    cycle_sum_holds,
    fiedler_value,
    normalized_fiedler_value,
    row_bound,
)
from certpgo.certify.cycles import CycleProof, prove
from certpgo.certify.tolerances import SETTLED
from certpgo.errors import CertPGOError, InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.cycles import is_cycle
from certpgo.graph.phrases import rounded_down
from certpgo.objective.quadratic import NO_SCALES, Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Status
from certpgo.solve.judging import certify
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.rungs import About, Ladder, Rung
from certpgo.solve.solving import solve

#: The method that solves the semidefinite program.
PROGRAM = "sdp_dual"
#: Cycles of a basis up to which a proof by cycles is tried unasked.
MANY_CYCLES = 3000
#: Relative gap below which a lower bound counts as equal to F.
TIGHT = 1e-6

T = TypeVar("T")


def ladder(
    problem: Quadratic,
    estimate: Estimate | None = None,
    *,
    sdp: bool = False,
    force: bool = False,
    cycles: bool | None = None,
) -> Ladder:
    """Compute all bounds of a connected graph.

    Parameters
    ----------
    estimate : estimate to compare with; by default the certified pipeline's
    sdp : also solve the semidefinite program
    force : solve it even if it is too large for its solver
    cycles : whether to try a proof by cycles; by default where a basis has at most `MANY_CYCLES`

    Raises
    ------
    InputError
        An estimate of another graph, or nodes of unknown scale.
    NumericalError
        No estimate was given, and none was found.
    KeyboardInterrupt
        Ctrl-C, also where the search returns an estimate after it.
    """
    if problem.takes_scales:
        raise InputError(NO_SCALES)
    if estimate is None:
        found, seconds = _timed(lambda: _searched(problem))
        point, certificate, proven = found.estimate, found.certificate, found.certificate
    else:
        problem.check(point := estimate)
        (certificate, proven), seconds = _timed(lambda: _certificates(problem, point))
    stationary = _stationary_rotations(problem, point)
    F = _Cost(problem.cost(point), certificate.cost_upper)
    by_cycles, rung = _cycles(problem, stationary, cycles)
    rungs = [*_spectral(problem, F), *_angles(problem, stationary), rung]
    unsolved = "not requested: --sdp solves it"
    rungs.append(_program(problem, F, force) if sdp else _sdp(None, F, 0.0, unsolved))
    title, needs = "proven bound", "a search, and factorizations with bounded rounding"
    bound = proven.lower_bound
    rungs.append(_lower("proven", title, bound, F, needs, seconds, claim="proven: "))
    angles = problem.rotation.residual_angles
    return Ladder(
        cost=F.computed,
        given=estimate is not None,
        largest=float(angles(point).max()),
        settled=None if stationary is None else float(angles(stationary).max()),
        certificate=certificate,
        rungs=tuple(_in_view_of_earlier(rungs)),
        cycles=by_cycles,
    )


def rungs_of_eigenvalues(
    problem: Quadratic, estimate: Estimate, certificate: Certificate
) -> tuple[Rung, ...]:
    """The rungs that need only a few eigenvalues, for an estimate with its certificate."""
    F = _Cost(problem.cost(estimate), certificate.cost_upper)
    stationary = _stationary_rotations(problem, estimate)
    return tuple(_in_view_of_earlier([*_spectral(problem, F), *_angles(problem, stationary)]))


def _searched(problem: Quadratic, initial: Estimate | None = None) -> CertifiedSolution:
    """The pipeline's result; an unfinished one would be taken for what the graph has to offer."""
    found = solve(problem, initial=initial)
    if found.solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return found


def _certificates(problem: Quadratic, point: Estimate) -> tuple[Certificate, Certificate]:
    """The certificate of the point, and the one with the higher bound: this or the pipeline's."""
    own = certify(problem, point)
    if own.verdict is Verdict.CERTIFIED or own.basin_is_global:
        return own, own
    searched = _searched(problem, point).certificate
    return own, max(own, searched, key=lambda certificate: certificate.lower_bound)


def _in_view_of_earlier(rungs: list[Rung]) -> Iterator[Rung]:
    """The rungs, with a remark where an earlier bound on F is higher."""
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
    """F of the estimate: as computed, and rounded up, which no lower bound exceeds."""

    computed: float
    upper: float


def _stationary_rotations(problem: Quadratic, point: Estimate) -> Estimate | None:
    found = newton(
        problem.rotation, Estimate.trusted(point.rotations), NewtonSettings(max_iterations=200)
    )
    stationary = problem.rotation.stationarity(found.estimate) <= SETTLED
    return found.estimate if stationary else None


def _timed(step: Callable[[], T]) -> tuple[T, float]:
    start = time.perf_counter()
    result = step()
    return result, time.perf_counter() - start


def _eigenvalues(step: Callable[[], T]) -> tuple[T | None, str, float]:
    """The result of a step or the reason for its failure, and its seconds."""

    def attempt() -> tuple[T | None, str]:
        try:
            return step(), ""
        except (NumericalError, np.linalg.LinAlgError) as error:
            return None, f"not computed: {error}"

    (found, why), seconds = _timed(attempt)
    return found, why, seconds


def _spectral(problem: Quadratic, F: _Cost) -> Iterator[Rung]:
    rotation, alone = problem.rotation, problem.has_positions
    value, why, seconds = _eigenvalues(
        lambda: spectral.spectral_bound(rotation, spectral.smallest_eigenpairs(rotation))
    )
    title = "eigenvalues" + ", rotations alone" * alone
    needs = f"{problem.d} eigenvalues of the rotations' matrix"
    yield _lower("spectral", title, value, F, needs, seconds, why)
    if problem.has_positions:
        poses = problem
        value, why, seconds = _eigenvalues(
            lambda: spectral.spectral_bound(poses, spectral.eliminated_eigenpairs(poses))
        )
        title, needs = "eigenvalues, translations eliminated", f"{problem.d} of the reduced matrix"
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
    claim: str = "",
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
        says = "none: no cost is negative"
    elif holds:
        says = f"{claim}this estimate is optimal to six digits"
    elif gap < value:
        says = f"{claim}this estimate is at most {100.0 * gap / value:.3g} % above the optimum"
    else:
        says = f"{claim}this estimate costs at most {cost / value:.3g} times the optimum"
    return Rung(key, title, "cost", value, cost, holds, needs, seconds, says)


def _angles(problem: Quadratic, stationary: Estimate | None) -> Iterator[Rung]:
    rotation = problem.rotation
    angles = np.array([math.inf]) if stationary is None else rotation.residual_angles(stationary)
    largest, total = float(angles.max()), float(angles.sum())
    residual = f"the largest residual is {math.degrees(largest):.4g} degrees"
    fiedler, why, seconds = _eigenvalues(lambda: fiedler_value(rotation))
    bound = None if fiedler is None else alpha_max(fiedler / float(rotation.node_weights.max()))
    title, needs = "residual-angle bound, largest degree", "one eigenvalue of the Laplacian"
    yield _local("alpha_max", title, bound, largest, needs, seconds, why or residual)
    nu, why, seconds = _eigenvalues(lambda: normalized_fiedler_value(rotation))
    bound = None if nu is None else alpha_max(nu)
    title = "residual-angle bound, each node's degree"
    needs = "one eigenvalue of the normalized Laplacian"
    yield _local("normalized", title, bound, largest, needs, seconds, why or residual)
    rows, seconds = _timed(
        lambda: (
            math.inf
            if stationary is None or nu is None
            else float(row_bound(rotation, stationary).max())
        )
    )
    title, needs = "each node's own residuals", "that eigenvalue and all residuals"
    why = why or f"a node's residuals reach {rows:.4g} of its weight"
    holds = nu is not None and rows < nu
    yield _local("rows", title, nu, rows, needs, seconds, why, about="ratio", holds=holds)
    if not is_cycle(rotation.graph):
        return
    equal = cycle_bound(rotation.graph)
    if equal is not None:
        title, needs = "half a turn over the number of nodes", "one cycle, equal weights"
        yield _local("cycle", title, equal, largest, needs, 0.0, residual)
    title, needs = "the cycle's residuals, added up", "one cycle, residuals about one axis"
    why = f"they add up to {math.degrees(total):.4g} degrees"
    holds = stationary is not None and cycle_sum_holds(rotation, stationary) is True
    yield _local("cycle_sum", title, math.pi, total, needs, 0.0, why, holds=holds)


def _cycles(
    problem: Quadratic, stationary: Estimate | None, wanted: bool | None
) -> tuple[CycleProof | None, Rung]:
    title, needs = "cycles of springs", "a cone program, and fractions"
    basis, why = problem.graph.num_edges - problem.n + 1, ""
    if problem.graph.has_matrix_weights:
        why = "not computed: it is for isotropic weights"
    elif wanted is False or (wanted is None and basis > MANY_CYCLES):
        why = f"not tried: a basis has {basis} cycles (--cycles FILE tries)"
    if stationary is None or why:
        why = why or "none: local descent reached no stationary rotations"
        return None, Rung("cycles", title, "stiffness", None, 1.0, None, needs, 0.0, why)
    proof, seconds = _timed(lambda: prove(problem.rotation, stationary))
    lower = f"F* of rotations >= {rounded_down(proof.lower_bound, 6)}"
    says = f"none: {proof.reason}, and {lower}"
    if proof.proven:
        says = f"proven by cycles: the stationary rotations nearby are optimal, {lower}"
    value = proof.ratio if math.isfinite(proof.ratio) else None
    return proof, Rung("cycles", title, "stiffness", value, 1.0, proof.proven, needs, seconds, says)


def _local(
    key: str,
    title: str,
    value: float | None,
    against: float,
    needs: str,
    seconds: float,
    why: str,
    *,
    about: About = "angle",
    holds: bool | None = None,
) -> Rung:
    """A rung about stationary rotations; without any, ``against`` is infinite.

    ``why`` is the reason why there is no value, or why the bound does not hold.
    """
    if value is None:
        return Rung(key, title, about, None, against, None, needs, seconds, why)
    holds = against <= value if holds is None else holds
    says = "the stationary rotations nearby are optimal" if holds else f"none: {why}"
    if math.isinf(against):
        says = "none: local descent reached no stationary rotations"
    return Rung(key, title, about, value, against, holds, needs, seconds, says)


def _sdp(value: float | None, F: _Cost, seconds: float, why: str, title: str = "") -> Rung:
    needs = "an interior-point solver"
    return _lower("sdp", f"semidefinite program{title}", value, F, needs, seconds, why)


def _program(problem: Quadratic, F: _Cost, force: bool) -> Rung:
    """The bound of the relaxation, for the rotations alone, by feasible multipliers.

    The solver's own value may lie above F*, as its multipliers are feasible only up to a tolerance.
    It is reported in words.
    """
    if PROGRAM not in registry.solver_names():
        return _sdp(None, F, 0.0, f"not solved: no method {PROGRAM} here")
    start = time.perf_counter()
    try:
        found = registry.build(PROGRAM, {"force": force}).solve(problem.rotation)
    except CertPGOError as error:
        reason = " ".join(str(error).split())
        return _sdp(None, F, time.perf_counter() - start, f"not solved: {reason}")
    seconds = time.perf_counter() - start
    alone = ", rotations alone" * problem.has_positions
    why = f"no bound from it: {found.status.value}"
    rung = _sdp(found.lower_bound, F, seconds, why, alone)
    if found.relaxation is None:
        return rung
    value = f"{found.relaxation.value:.10g} ({found.relaxation.status})"
    return replace(rung, says=f"{rung.says}; the solver's value is {value}")
