"""The certified pipeline: initialize, optimize, certify; escape, round, polish where needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from certpgo.certify import Certificate, Tier, Verdict
from certpgo.certify.case import PROOF_GAIN, Basin, Case
from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.objective.problem import Problem, problem_of
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import stoppable
from certpgo.optimize.solution import Solution, Status
from certpgo.optimize.starts import Start
from certpgo.solvers.certified.disagreement import Disagreement, agrees, disagreement, ignore
from certpgo.solvers.certified.settings import SolveSettings
from certpgo.solvers.certified.staircase import Level, Staircase

#: What an initial estimate of the caller is called.
GIVEN = "the given estimate"
#: Dimensions that the staircase may add to the d of space.
MORE_RANKS = 7


@dataclass(frozen=True, eq=False)
class CertifiedSolution:
    """An answer and the judgement on it.

    Attributes
    ----------
    solution : the estimate, how it was found, and what it cost to find
    certificate : what is proven about it
    start : what the descent started from: a method, or "the given estimate"
    levels : the steps of the staircase, one when it never climbed
    settings : that it was found with
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
    settings: SolveSettings
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
    settings: SolveSettings | None = None,
    *,
    initial: Estimate | None = None,
    monitor: Monitor = silent,
    on_disagreement: Callable[[Disagreement], object] = ignore,
    **options: Any,
) -> CertifiedSolution:
    """The best estimate of a graph, with a certificate of how good it is.

    The Riemannian staircase begun at rank d (Boumal 2015; Rosen et al., IJRR 2019), with Newton's
    method on poses and certificates that account for rounding.

    Parameters
    ----------
    graph : the measurements of n poses or rotations, connected
    settings : limits, tolerances and tuning, see `SolveSettings`
    initial : where to start instead of an initialization of our own; n poses, in metres
    monitor : is called with each iteration, and may stop the search
    on_disagreement : is called with measurements that disagree with the rest, before the search
        goes on to escape from where they led
    options : single settings instead: ``time_limit``, ``max_rank``, ``tier``, ``rtol``, ``atol``
        and any other field of `SolveSettings`

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
        An unknown tier or setting.
    NumericalError
        No initialization could be computed.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> answer = certpgo.solve(instance.graph, time_limit=10.0)
    >>> answer.verdict.value
    'CERTIFIED'
    >>> print(f"{answer.cost:.6f}")  # 8 n sin^2(theta / (2 n)), the closing error shared out
    0.029994
    """
    if not isinstance(graph, (PoseGraph, RotationGraph)):
        raise InputError(
            f"solve takes a graph, such as instance.graph, not a {type(graph).__name__}"
        )
    chosen = (settings or SolveSettings()).changed(options)
    begin = None if initial is None else Start(initial, GIVEN)
    return search_and_certify(problem_of(graph), chosen, begin, monitor, on_disagreement)


def search_and_certify(
    problem: Problem,
    settings: SolveSettings,
    initial: Start | None,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None = None,
) -> CertifiedSolution:
    """`solve` for a problem; the name of the initial estimate goes into the solution's note."""
    if initial is not None:
        problem.check(initial.estimate)
    highest = problem.d + MORE_RANKS if settings.max_rank is None else settings.max_rank
    if highest < problem.d:
        raise InputError(f"the maximal rank must be at least {problem.d}, not {highest}")
    case = Case.of(problem, settings.tier or Tier.STANDARD, settings.rtol, settings.atol)
    # The cheaper bounds are enough to steer by.
    steering = replace(case, tier=Tier.STANDARD) if case.tier is Tier.PROOF else case
    with stoppable(monitor, case.unit, settings.time_limit) as stop:
        search = Staircase(steering, settings, stop, initial)
        found = on_disagreement and _disagreement(search, problem, on_disagreement)
        search.go_on(highest)
        ended = search.status
        certificate = _judged(search, None if settings.tier is None else case.tier)
    answer = _result(problem, search, ended, certificate)
    # Where the first descent ended may have been no more than a local minimum.
    stands = found and not agrees(problem, answer.estimate)
    return replace(answer, disagreement=found) if stands else answer


def _disagreement(
    search: Staircase, problem: Problem, tell: Callable[[Disagreement], object]
) -> Disagreement | None:
    """Tell what the first descent's residuals say; ``problem`` has the weights of the graph."""
    refit = not search.is_done
    with search.watch.phase("residuals"):
        found = disagreement(
            problem, search.best.estimate, refit=refit, monitor=lambda _: search.stop.asked
        )
    if found is not None:
        tell(found)
    return found


def _judged(search: Staircase, tier: Tier | None) -> Certificate:
    """The certificate at a tier; by default the proof tier's where only rounding is missing."""
    estimate = search.best.estimate
    certificate = search.case.certificate(estimate, search.basin)
    near = certificate.gap <= PROOF_GAIN * certificate.tolerance
    missing = search.has_reached_the_floor and near and not search.is_certified
    escalates = missing and tier is None and not search.stop.asked
    if not (tier is Tier.PROOF or escalates):
        return certificate
    with search.watch.phase("prove"):
        case = replace(search.case, tier=Tier.PROOF)
        cost = case.cost_upper(estimate)
        # Who stops before a proof that was asked for is not given less than a proof instead.
        bound = None if search.stop.asked else case.bound(estimate, cost)
        proven = case.certificate(estimate, Basin(estimate, cost, True, bound))
    better = proven.lower_bound > certificate.lower_bound
    return proven if tier is Tier.PROOF or better else certificate


def _result(
    problem: Problem, search: Staircase, ended: Status, certificate: Certificate
) -> CertifiedSolution:
    """Everything in the units of the graph."""
    stop, unit, estimate = search.stop, search.case.unit, search.best.estimate
    certificate = replace(certificate, reason=_reason(search, certificate))
    solution = Solution(
        estimate=estimate,
        cost=problem.cost(estimate),
        status=ended,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=certificate.lower_bound,
        seconds=search.watch.seconds,
        trace=tuple(stop.trace),
        counts=dict(search.counts),
        note=f"initialized by {search.origin}; {_end(search)}",
    )
    levels = tuple(replace(level, cost=unit * level.cost) for level in search.levels)
    return CertifiedSolution(solution, certificate, search.start, levels, search.settings)


def _end(search: Staircase) -> str:
    """Where the search ended, and how to let it continue where its own limit ended it."""
    where = f"the staircase ended at rank {search.levels[-1].rank}"
    if not search.ended_early:
        return where
    return (
        f"{where}, {search.patience:g} s after a first bound; setting a time limit (time_limit, "
        "--time-limit) lets it continue"
    )


def _reason(search: Staircase, certificate: Certificate) -> str:
    """The certificate's reason, and what of the search explains it."""
    stopped = search.stop.status is not None
    minimal = search.has_reached_the_floor and not stopped
    if certificate.verdict is Verdict.UNDECIDED and minimal:
        cost, share = certificate.cost_upper, certificate.cost_upper / certificate.scale
        return (
            f"the relaxation has no lower point, but the cost, {cost:.4g}, is only {share:.1g} of "
            "the total weight W, too little for a proof that allows for rounding: "
            f"atol={2.0 * share:.1g} treats it as zero, and weights that state the true precision "
            "of the data raise it"
        )
    if certificate.verdict is Verdict.UNDECIDED:
        how = "stopped" if stopped else _end(search)
        return f"{how} before a useful bound was found"
    if certificate.verdict is not Verdict.BOUNDED:
        return certificate.reason
    if minimal:
        limit = "the relaxation has no lower point: rounding limits the proof"
        return f"{certificate.reason}; {limit}"
    return f"{certificate.reason}; {_end(search)}" if search.ended_early else certificate.reason


@dataclass(frozen=True)
class Certified(SolveSettings):
    """The certified pipeline as a method among others.

    Its estimate is that of `certpgo.solve`, its settings are those of `SolveSettings`.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = certpgo.RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> certpgo.get_solver("certified")().solve(problem).lower_bound > 0.029
    True
    """

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The best estimate found."""
        begin = None if initial is None else Start(initial, GIVEN)
        return search_and_certify(problem, self, begin, monitor).solution


SOLVER = Certified
