"""The certified pipeline: start, optimise, certify; escape, round and polish where that fails.

The Riemannian staircase (Boumal 2015; Rosen et al., SE-Sync, IJRR 2019), begun at rank d: a local
minimum whose certificate matrix has a negative eigenvalue is left through a new dimension, along
the eigenvector, and what low-rank optimization finds there is rounded and polished.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from certpgo.certify import (
    Certificate,
    DualBound,
    Tier,
    Verdict,
    cost_upper,
)
from certpgo.certify.case import ATOL, MAX_STEPS, RTOL, Basin, Case
from certpgo.certify.curvature import negative_curvature
from certpgo.disagreement import Disagreement, agrees, disagreement, ignore
from certpgo.errors import InputError, NumericalError
from certpgo.estimate import Estimate
from certpgo.graph import Graph, PoseGraph, RotationGraph
from certpgo.lift import Lift, Point, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.monitor import Monitor, silent
from certpgo.newton import newton
from certpgo.problem import Problem, problem_of
from certpgo.progress import Stop, stoppable
from certpgo.solution import Solution, Status
from certpgo.solvers import low_rank
from certpgo.starts import Start, start_of

#: Dimensions that the staircase may add to the d of space.
MORE_RANKS = 7
#: By how much less rounding costs at the proof tier, at most.
PROOF_GAIN = 1e3
#: Stationarity asked of estimates, and over the typical residual of points of higher rank; radians.
TOLERANCE, LIFTED_TOLERANCE = 1e-11, 1e-5


@dataclass(frozen=True, eq=False)
class Level:
    """One step of the staircase.

    Attributes
    ----------
    rank : dimensions of the points
    cost : F at the point found there
    status : how the descent to it ended
    eigenvalue : negative, when the certificate matrix was found to have such an eigenvalue there
    """

    rank: int
    cost: float
    status: Status
    eigenvalue: float | None = None


@dataclass(frozen=True, eq=False)
class CertifiedSolution:
    """An answer and the judgement on it.

    Attributes
    ----------
    solution : the estimate, how it was found, and what it cost to find
    certificate : what is proven about it
    start : the method that the descent started from, or "given"
    levels : the steps of the staircase, one when it never climbed
    disagreement : measurements that disagree with the rest, if residuals give reason to say so;
        `certpgo.solve_robustly` leaves such out

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> answer = certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph)
    >>> answer.solution.status.value, len(answer.levels)
    ('converged', 1)
    >>> answer.certificate.lower_bound <= answer.cost
    True
    """

    solution: Solution
    certificate: Certificate
    start: str
    levels: tuple[Level, ...]
    disagreement: Disagreement | None = None

    @property
    def estimate(self) -> Estimate:
        """The best estimate found."""
        return self.solution.estimate

    @property
    def cost(self) -> float:
        """F of the estimate."""
        return self.solution.cost

    @property
    def verdict(self) -> Verdict:
        """The certificate's verdict."""
        return self.certificate.verdict


def solve(
    graph: Graph,
    *,
    initial: Estimate | None = None,
    time_limit: float | None = None,
    max_rank: int | None = None,
    tier: Tier | str = Tier.STANDARD,
    rtol: float = RTOL,
    atol: float = ATOL,
    monitor: Monitor = silent,
    on_disagreement: Callable[[Disagreement], object] = ignore,
) -> CertifiedSolution:
    """The best estimate of a graph, with a certificate of how good it is.

    The Riemannian staircase begun at rank d (Boumal 2015; Rosen et al., IJRR 2019), with Newton's
    method on poses and certificates that account for rounding.

    Parameters
    ----------
    graph : the measurements of n poses or rotations, connected
    initial : where to start instead of a start of our own; n poses, in metres
    time_limit : seconds after which to return the best estimate so far; what is under way, such
        as a factorization, is finished first
    max_rank : dimensions at which the staircase ends; by default d + 7
    tier : what the certificate may trust, see `Tier`. Where rounding is all that the standard tier
        lacks, the proof tier is asked, and the certificate says so
    rtol, atol : CERTIFIED means gap <= rtol F + atol W
    monitor : is told each iteration, and may stop the search
    on_disagreement : is told of measurements that disagree with the rest, before the search goes on
        to escape from where they led

    Returns
    -------
    The answer. Its verdict is CERTIFIED; BOUNDED with a proven gap, where the relaxation is not
    tight; or UNDECIDED, when the search ended before a useful bound was found. Ctrl-C stops the
    search like a monitor; a second one raises KeyboardInterrupt.

    Raises
    ------
    GraphError
        The graph is not connected.
    InputError
        An initial estimate of another graph, limits or tolerances that make no sense, weights
        beyond the range of doubles.
    SpecError
        An unknown tier.
    NumericalError
        No start could be computed.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> answer = certpgo.solve(instance.graph)
    >>> answer.verdict.value
    'CERTIFIED'
    >>> print(f"{answer.cost:.6f}")  # 8 n sin^2(theta / (2 n)), the closing error shared out
    0.029994
    """
    if not isinstance(graph, (PoseGraph, RotationGraph)):
        raise InputError(
            f"solve takes a graph, such as instance.graph, not a {type(graph).__name__}"
        )
    problem = problem_of(graph)
    return _solve(
        problem, initial, time_limit, max_rank, tier, rtol, atol, monitor, on_disagreement
    )


def _solve(
    problem: Problem,
    initial: Estimate | None,
    time_limit: float | None,
    max_rank: int | None,
    tier: Tier | str,
    rtol: float,
    atol: float,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None = None,
) -> CertifiedSolution:
    if initial is not None:
        problem.check(initial)
    if time_limit is not None and not time_limit >= 0.0:
        raise InputError(f"the time limit must not be negative: {time_limit}")
    highest = problem.d + MORE_RANKS if max_rank is None else max_rank
    if highest < problem.d:
        raise InputError(f"the maximal rank must be at least {problem.d}, not {highest}")
    case = Case.of(problem, tier, rtol, atol)
    with stoppable(monitor, case.unit, time_limit) as stop:
        # The search itself is steered by the cheaper bounds.
        steering = replace(case, tier=Tier.STANDARD) if case.tier is Tier.PROOF else case
        search = _Staircase(steering, stop)
        search.begin(initial)
        found = on_disagreement and _disagreement(search, problem, on_disagreement)
        search.climb(highest)
        certificate = search.judged(case.tier)
    answer = search.result(problem, certificate)
    # Where the first descent ended may have been no more than a local minimum.
    stands = found and not agrees(problem, answer.estimate)
    return replace(answer, disagreement=found) if stands else answer


def _disagreement(
    search: _Staircase, problem: Problem, tell: Callable[[Disagreement], object]
) -> Disagreement | None:
    """Tell what the first descent's residuals say; ``problem`` has the weights of the graph."""
    refit = not (search.is_certified or search.stop.asked)
    with search.watch.phase("residuals"):
        found = disagreement(
            problem, search.best.estimate, refit=refit, monitor=lambda _: search.stop.asked
        )
    if found is not None:
        tell(found)
    return found


class _Staircase:
    """The search: the best estimate and bound so far, and how they were found."""

    def __init__(self, case: Case, stop: Stop) -> None:
        self.case, self.problem, self.stop = case, case.problem, stop
        self.watch = stop.watch
        self.levels: list[Level] = []
        self.counts: Counter[str] = Counter()
        self.bound: DualBound | None = None

    def begin(self, initial: Estimate | None) -> None:
        """The first descent, at rank d, and its bound."""
        with self.watch.phase("start"):
            if initial is None:
                start = start_of(self.problem)
            else:
                start = Start(self.problem.complete(initial.rotations), "given")
        self.start_name = start.name
        self.take(self.descend(start.estimate, near=start.near))
        self.levels.append(Level(self.problem.d, self.best.cost, self.best.status))
        self.improve_bound(self.best.estimate)

    def climb(self, highest: int) -> None:
        """Escape to higher ranks until the gap is closed or the relaxation is solved."""
        point: Point = self.best.estimate
        # What was found before an error stays, and is judged.
        with suppress(NumericalError, np.linalg.LinAlgError):
            point = self.last_of_climb(point, highest)
        if not (self.is_certified or self.stop.asked):
            self.settle_for_less(point)

    def last_of_climb(self, point: Point, highest: int) -> Point:
        """The point of the relaxation where there is nothing left to gain, or no rank."""
        while not (self.is_certified or self.stop.asked):
            with self.watch.phase("escape"):
                eigenvalue, direction = negative_curvature(self.problem, point)
            # F can fall by at most this much for every point of the relaxation.
            if -eigenvalue * direction.size <= 0.1 * self.case.tolerance(self.best.cost):
                break
            self.levels[-1] = replace(self.levels[-1], eigenvalue=self.case.unit * eigenvalue)
            rank = self.levels[-1].rank + 1
            if rank > highest:
                break
            point = self.escape(point, rank, direction)
            polished = self.descend(self.problem.complete(rounded(point).rotations))
            if polished.cost < self.best.cost:
                self.take(polished)
                self.improve_bound(polished.estimate)
            if self.best.cost < (1.0 - 1e-9) * self.levels[-1].cost:
                point = self.best.estimate  # the higher rank has gained nothing yet
            elif not self.is_certified:
                self.improve_bound(point)
        return point

    def take(self, best: Solution) -> None:
        """Make a solution the best so far."""
        self.best = best
        self.cost = cost_upper(self.problem, best.estimate)

    def escape(self, point: Point, rank: int, direction: FloatArray) -> Lift:
        """The point that low-rank optimization finds from a saddle."""
        found = low_rank.descend(
            self.problem,
            point,
            rank,
            direction=direction,
            tolerance=max(LIFTED_TOLERANCE * math.sqrt(self.cost / self.problem.scale), TOLERANCE),
            monitor=self.stop,
            watch=self.watch,
        )
        self.counts.update(found.counts)
        self.levels.append(Level(rank, found.cost, found.status))
        return found.point

    def descend(self, start: Estimate, *, near: bool = False) -> Solution:
        """Newton's method at rank d."""
        found = newton(
            self.problem,
            start,
            tolerance=TOLERANCE,
            max_iterations=MAX_STEPS,
            near=near,
            monitor=self.stop,
            watch=self.watch,
        )
        self.counts.update(found.counts)
        return found

    def improve_bound(self, point: Point, *, tight: bool = True) -> None:
        """Take the bound of a point where it is better."""
        if self.stop.asked:
            return
        with self.watch.phase("certify"):
            bound = self.case.bound(point, self.cost, sharp=False, tight=tight)
        if bound is not None:
            self.counts["factorizations"] += bound.factorizations
            self.counts["nonzeros"] = max(self.counts["nonzeros"], bound.nonzeros)
            if self.bound is None or bound.value > self.bound.value:
                self.bound = bound

    def settle_for_less(self, point: Point) -> None:
        """Bounds that a negative eigenvalue weakens: better than none."""
        for candidate in (point, self.best.estimate):
            if not self.is_certified:
                self.improve_bound(candidate, tight=False)

    @property
    def is_certified(self) -> bool:
        return self.cost - self.basin.value <= self.case.tolerance(self.cost)

    @property
    def is_minimal(self) -> bool:
        """Whether the certificate matrix was not found to have a negative eigenvalue at rank d."""
        return len(self.levels) == 1 and self.levels[0].eigenvalue is None

    @property
    def basin(self) -> Basin:
        return Basin(self.best.estimate, self.cost, True, self.bound)

    def judged(self, tier: Tier) -> Certificate:
        """The certificate at a tier; at the proof tier as well where only rounding is missing."""
        estimate = self.best.estimate
        certificate = self.case.certificate(estimate, self.basin)
        near = certificate.gap <= PROOF_GAIN * certificate.tolerance
        missing = self.case.rigorous and self.is_minimal and near and not self.is_certified
        if self.stop.asked or not (tier is Tier.PROOF or missing):
            return certificate
        with self.watch.phase("prove"):
            case = replace(self.case, tier=Tier.PROOF)
            cost = case.cost_upper(estimate)
            basin = Basin(estimate, cost, True, case.bound(estimate, cost))
            proven = case.certificate(estimate, basin)
        better = proven.lower_bound > certificate.lower_bound
        return proven if tier is Tier.PROOF or better else certificate

    def result(self, problem: Problem, certificate: Certificate) -> CertifiedSolution:
        """Everything in the units of the graph."""
        estimate = self.best.estimate
        status = self.stop.status or self.best.status
        ended = f"the staircase ended at rank {self.levels[-1].rank}"
        if certificate.verdict is Verdict.UNDECIDED:
            how = "stopped" if self.stop.status else ended
            certificate = replace(certificate, reason=f"{how} before a useful bound was found")
        elif certificate.verdict is Verdict.BOUNDED and self.is_minimal and not self.stop.status:
            limit = "the relaxation shows no way down: rounding is what limits the proof"
            certificate = replace(certificate, reason=f"{certificate.reason}; {limit}")
        solution = Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=status,
            iterations=max(len(self.stop.trace) - 1, 0),
            lower_bound=certificate.lower_bound,
            seconds=self.watch.seconds,
            trace=tuple(self.stop.trace),
            counts=dict(self.counts),
            note=f"started from {self.start_name}; {ended}",
        )
        unit = self.case.unit
        levels = tuple(replace(level, cost=unit * level.cost) for level in self.levels)
        return CertifiedSolution(solution, certificate, self.start_name, levels)


@dataclass(frozen=True)
class Certified:
    """The certified pipeline as a method among others: certpgo.solve's estimate.

    Attributes
    ----------
    max_rank : dimensions at which the staircase ends; by default d + 7

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = certpgo.RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> certpgo.get_solver("certified")().solve(problem).lower_bound > 0.029
    True
    """

    max_rank: int | None = None

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The best estimate found."""
        tier = Tier.STANDARD
        return _solve(problem, initial, None, self.max_rank, tier, RTOL, ATOL, monitor).solution


SOLVER = Certified
