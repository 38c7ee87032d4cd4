"""The certified pipeline: initialize, optimize, certify; escape, round and polish if needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

from certpgo.certify import Certificate, Tier, Verdict
from certpgo.certify.case import Basin, Case
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.wording import early
from certpgo.costs.fit import Fit, fit_of
from certpgo.costs.problem import InformationProblem
from certpgo.costs.ranges import RangeProblem
from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.picture import circle_of, closures, drawn
from certpgo.graph.priors import mirrored_by
from certpgo.graph.speaking import Speaking, Text
from certpgo.graph.wording import counted
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.marginals import Marginals
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.solution import Level, Solution
from certpgo.optimize.starts import Start
from certpgo.optimize.undetermined import Undetermined, undetermined
from certpgo.solvers.certified.disagreement import Disagreement, agrees, disagreement
from certpgo.solvers.certified.settings import SolveSettings
from certpgo.solvers.certified.staircase import Staircase

#: Name of the caller's initial estimate.
GIVEN = "the given estimate"
#: Name of the initial values of an instance.
STORED = "the initial values of the file"
#: Ranks that the staircase may add to d.
MORE_RANKS = 7


@dataclass(frozen=True, eq=False, repr=False)
class CertifiedSolution(Speaking):
    """An estimate with its certificate; printed, it says what was found and what is proven.

    Attributes
    ----------
    solution : the estimate, and how it was found
    certificate : what is proven about it
    start : the initialization: a method, or "the given estimate"
    levels : the steps of the staircase; only one if it did not climb
    settings : settings of the search
    problem : what the certificate is about: the measurements, those kept if some were rejected
    disagreement : measurements that disagree with the rest, if there are any;
        `certpgo.solve_robustly` rejects them
    chordal : under the cost of another program, the result for the chordal cost F from which the
        search began; None for F itself, or from a given initial estimate
    instance : what was solved, if it was read rather than a bare graph: `certpgo.write` takes the
        node ids from it

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> result = certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph)
    >>> result.solution.status.value, len(result.levels)
    ('converged', 1)
    >>> result.certificate.lower_bound <= result.cost
    True
    """

    solution: Solution
    certificate: Certificate
    start: str
    levels: tuple[Level, ...]
    settings: SolveSettings
    problem: Problem | InformationProblem | RangeProblem = field(repr=False)
    disagreement: Disagreement | None = None
    chordal: CertifiedSolution | None = None
    instance: Instance | None = field(default=None, repr=False)

    @property
    def estimate(self) -> Estimate:
        """The best estimate found."""
        return self.solution.estimate

    @property
    def cost(self) -> float:
        """F of the estimate; of all measurements, also where the certificate is about fewer.

        That F is ``certificate.cost_upper``.
        """
        return self.solution.cost

    @property
    def verdict(self) -> Verdict:
        """The certificate's verdict."""
        return self.certificate.verdict

    def summary(self) -> str:
        """What was found, what is proven, and what to do next: the text that is printed."""
        return Text(self)

    @property
    def graph(self) -> PoseGraph | RotationGraph:
        """The measurements that the certificate is about."""
        return self.problem.chordal.graph

    @property
    def _headline(self) -> str:
        return self.certificate._headline

    def __repr__(self) -> str:
        kept = "" if self.solution.kept is None else f" of {self.solution.kept} kept measurements"
        return f"<CertifiedSolution: {self.certificate.in_brief}{kept}, {self.estimate!r}>"

    def _facts(self) -> Iterator[tuple[str, str]]:
        solution, found = self.solution, self.disagreement
        yield "graph", self.graph.size_in_words
        if solution.kept is not None:
            yield "kept", f"{solution.kept} measurements; the rest disagreed with them"
        yield from self.certificate._proven()
        if self.fit is not None:
            yield "chi^2", self.fit.warning.removeprefix("chi^2 is ") or str(self.fit)
        steps, seconds = counted(solution.iterations, "iteration{s}"), solution.seconds.values()
        yield "ended", f"{solution.status} after {steps}, {sum(seconds):.3g} s; {solution.note}"
        if self.undetermined is not None:
            named = "node {}".format if self.instance is None else self.instance.named
            yield "undetermined", self.undetermined.in_words(named)
        if found is not None:
            yield "outliers?", f"{found}: certpgo.solve_robustly(graph) rejects them"
        if self.verdict in (Verdict.CERTIFIED, Verdict.BOUNDED):
            yield "next", "certpgo.write(path, answer); answer.covariance(node)"
        else:
            yield "next", "the reason says what was in the way"

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 and its degrees of freedom, where the source of the graph states the noise."""
        if self.instance is None:
            return None
        return fit_of(self.instance, self.problem, self.estimate, self.solution.weights)

    def _picture(self) -> str:
        graph, t = self.graph, self.estimate.translations
        if t is None or not isinstance(graph, PoseGraph):
            return circle_of(graph.num_nodes, graph.edges)
        return drawn(t, closures(graph.edges), graph.pose_nodes)

    @cached_property
    def undetermined(self) -> Undetermined | None:
        """What the measurements leave open there; None if they determine all nodes."""
        if not isinstance(self.graph, PoseGraph) or not self.graph.is_partial:
            return None  # it is connected
        world = None if self.instance is None else self.instance.world
        anchor = int(self.problem.tangent_layout.whole[0]) if world is None else world
        return undetermined(self.problem, self.estimate, anchor)

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the nodes relative to the first pose; see `certpgo.Marginals`."""
        return Marginals(self.problem, self.estimate, int(self.problem.tangent_layout.whole[0]))

    def covariance(self, node: int) -> FloatArray:
        """(b, b) covariance of a node relative to the first pose, see `certpgo.Marginals`."""
        return self.marginals.covariance(node)


def search_and_certify(
    problem: Problem,
    settings: SolveSettings,
    initial: Start | None,
    monitor: Monitor,
    on_disagreement: Callable[[Disagreement], object] | None = None,
    stored: Start | None = None,
) -> CertifiedSolution:
    """`solve` for a problem; the solution's note contains the name of the initial estimate.

    Parameters
    ----------
    stored : another start, which is tried if the first descent is not certified
    """
    if initial is not None:
        problem.check(initial.estimate)
    highest = problem.d + MORE_RANKS if settings.max_rank is None else settings.max_rank
    if highest < problem.d:
        raise InputError(f"the maximal rank must be at least {problem.d}, not {highest}")
    case = Case.of(problem, settings.tier or Tier.STANDARD, settings.rtol, settings.atol, monitor)
    # Cheaper bounds suffice to guide the search.
    steering = replace(case, tier=Tier.STANDARD) if case.tier is Tier.PROOF else case
    closer = _as_close_as(case, settings)
    with case.stop.within(settings.time_limit):
        search = Staircase(steering, closer, initial)
        search.try_stored(stored)
        found = on_disagreement and _disagreement(search, problem, on_disagreement)
        if found and found.is_widespread(problem.graph):
            search.hurry()
        search.go_on(highest)
        certificate = _certificate(search, None if settings.tier is None else case.tier)
    result = replace(_result(problem, search, certificate), settings=settings)
    # The first descent may have ended in a local minimum.
    confirmed = found and not agrees(problem, result.estimate)
    return replace(result, disagreement=found) if confirmed else result


def _as_close_as(case: Case, settings: SolveSettings) -> SolveSettings:
    """Settings whose descents end as close to the minimum as the certificate can tell."""
    newton = settings.newton
    if case.tier is Tier.PROOF:
        return replace(settings, newton=replace(newton, enough=0.0))
    if isinstance(case.problem, PoseProblem):
        return settings
    # A certificate of rotations alone compensates nothing but their rounding.
    return replace(settings, newton=replace(newton, enough=0.1 * newton.enough))


def _disagreement(
    search: Staircase, problem: Problem, report: Callable[[Disagreement], object]
) -> Disagreement | None:
    """Report outliers after the first descent; ``problem`` has the weights of the graph."""
    refit = not search.is_done
    with search.watch.phase("residuals"):
        found = disagreement(
            problem, search.best.estimate, refit=refit, monitor=lambda _: search.stop.asked
        )
    if found is not None:
        report(found)
    return found


def _certificate(search: Staircase, tier: Tier | None) -> Certificate:
    """The certificate at a tier; by default the proof tier's if only rounding is in the way."""
    estimate = search.best.estimate
    certificate = search.case.certificate(estimate, search.basin)
    tight = search.is_certified or search.has_reached_the_floor
    rounding = tight and search.case.may_close(certificate)
    provable = not search.problem.unprovable
    escalates = rounding and tier is None and provable and not search.stop.cuts()
    if not (tier is Tier.PROOF or escalates):
        return certificate
    with search.watch.phase("prove"):
        case = replace(search.case, tier=Tier.PROOF)
        cost = case.cost_upper(estimate)
        # A search stopped before the requested proof must not return a weaker tier instead.
        bound = None if search.stop.cuts() else case.bound(estimate, cost)
        proven = case.certificate(estimate, Basin(estimate, cost, True, bound))
    better = proven.lower_bound > certificate.lower_bound
    return proven if tier is Tier.PROOF or better else certificate


def _result(problem: Problem, search: Staircase, certificate: Certificate) -> CertifiedSolution:
    """The result in the units of the graph."""
    stop, unit, estimate = search.stop, search.case.unit, search.best.estimate
    certificate = replace(certificate, obstacle=_obstacle(search, certificate))
    solution = Solution(
        estimate=estimate,
        cost=problem.cost(estimate),
        status=search.status,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=certificate.lower_bound,
        seconds=search.watch.seconds,
        trace=tuple(stop.trace),
        counts=dict(search.counts),
        note=f"initialized by {search.origin}; {_end(search)}",
    )
    levels = tuple(replace(level, cost=unit * level.cost) for level in search.levels)
    return CertifiedSolution(solution, certificate, search.start, levels, search.settings, problem)


def _end(search: Staircase) -> str:
    """Where the search ended, and how to continue it if its own limit ended it."""
    where = f"the staircase ended at rank {search.levels[-1].rank}"
    return f"{where}, {early(search.patience)}" if search.ended_early else where


def _obstacle(search: Staircase, certificate: Certificate) -> Obstacle:
    """What keeps the gap open after the search."""
    if certificate.verdict not in (Verdict.BOUNDED, Verdict.UNDECIDED):
        return certificate.obstacle
    rank, stopped, graph = search.levels[-1].rank, search.stop.cut, search.problem.graph
    patience = search.patience if search.ended_early else None
    about = Obstacle(certificate.limited_by, True, rank, stopped, patience)
    if certificate.verdict is Verdict.BOUNDED and isinstance(graph, PoseGraph):
        about = replace(about, mirrored=mirrored_by(graph))
    if about.mirrored is not None:
        return replace(about, kind=LimitedBy.LOOSE)
    if stopped is not None:
        return replace(about, kind=LimitedBy.STOPPED)
    if search.has_reached_the_floor:
        return replace(about, kind=LimitedBy.ROUNDING)
    return replace(about, kind=LimitedBy.STOPPED if search.ended_early else LimitedBy.LOOSE)
