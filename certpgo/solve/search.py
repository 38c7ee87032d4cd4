"""The search for the best estimate of a problem, with its certificate, under any cost.

What differs between costs is a plan: where descents begin, the points of relaxations, and numbers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np

from certpgo.certify.certificate import Tier, Verdict
from certpgo.certify.normalized import NormalizedProblem
from certpgo.errors import GraphError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import FEATURES
from certpgo.graph.relaxed_point import Point
from certpgo.graph.trees import tree_initialization
from certpgo.linalg.threads import one_thread
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.complex_relaxation import over_complex_numbers
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.optimize import similarity_starts
from certpgo.optimize.curvature import resolution
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import Start, averaged_start, start_of
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.randomized_rounding import roundings
from certpgo.optimize.solution import Level, Status
from certpgo.optimize.staircase import Stair, climb
from certpgo.solve import bounding, endings
from certpgo.solve.outliers import ignore
from certpgo.solve.plan import Plan
from certpgo.solve.relaxation import Relaxed
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Report, Search
from certpgo.solve.settings import SolveSettings

#: Where a search with distances begins of itself, for reports.
ORIGIN = "a random point of higher rank"
#: Surrogates after which a search does not begin again.
MOST_SURROGATES = 10
#: Times a robust kernel's scale is doubled for a start.
GRADUATED = 4


@one_thread
def search(
    problem: Certifiable,
    settings: SolveSettings,
    initial: Start | None = None,
    monitor: Monitor = silent,
    on_disagreement: Report | None = None,
    stored: Start | None = None,
) -> CertifiedSolution:
    """The best estimate found, with its certificate; see `certpgo.solve`.

    Parameters
    ----------
    initial : where the search begins; by default it finds a start of its own
    on_disagreement : is called with measurements that disagree with the rest
    stored : another start, that of the file, which is tried if the first descent is not certified
    """
    tier = settings.tier or Tier.STANDARD
    normalized: NormalizedProblem[Any]
    normalized = NormalizedProblem.of(problem, tier, settings.rtol, settings.atol, monitor)
    begun, stop = Search(plan_of(problem), problem, normalized, settings), normalized.stop
    with stop.within(settings.time_limit):
        with stop.for_at_most():
            begun.run(initial, stored, on_disagreement)
        return endings.result_of(begun)


def plan_of(problem: Certifiable) -> Plan:
    """The plan of a search under the cost of a problem."""
    if problem.is_lifted:
        return DISTANCES
    if problem.takes_scales:
        return SIMILARITIES if problem.is_chordal else SIMILARITY_SUMS
    if problem.kernel is not None:
        return ROBUST
    own = INERTIAL if FEATURES["inertial"].is_in(problem.measured) else SURROGATES
    return CHORDAL if problem.is_chordal else own


# --- Computed initializations ---------------------------------------------------------------------


def _suitable_start(search: Search) -> Start:
    """The initialization that suits the measurements."""
    with search.watch.phase("start"):
        return start_of(search.problem)


def _any_start(search: Search) -> Start:
    """A tree: the relaxation is climbed from a random point."""
    whole = search.normalized.eased.lifted_form.whole
    rotations = tree_initialization(whole.graph.rotations_alone).rotations
    return Start(whole.complete(rotations), ORIGIN)


def _averaged_start(search: Search) -> Start:
    """The rotations that F's searches begin at, unless large noise makes others better."""
    found = None
    with search.watch.phase("start"), suppress(GraphError):
        form = search.problem.isotropic
        found = averaged_start(form) if form.is_chordal else None
    if found is None:
        raise NumericalError("averaged rotations are no start")
    return found


def _chordal_start(own: Search) -> Start:
    """The best estimate under F, found in half of the time; else along a tree."""
    settings, limit = own.settings, own.settings.time_limit
    if limit is None:
        own.stop.deadline = math.inf  # what an earlier start has proven does not limit this one
    try:
        problem = own.original.isotropic
    except GraphError:  # what F has no terms for joins some nodes
        from certpgo.optimize.joint_starts import joint_start

        return joint_start(own.original)
    half = replace(
        settings,
        tier=None if own.tier is Tier.PROOF else own.tier,
        patience=0.5 * settings.patience,
        time_limit=None if limit is None else 0.5 * limit,
    )
    found = search(problem, half, monitor=own.stop.monitor, on_disagreement=ignore)
    for phase, seconds in found.solution.seconds.items():
        own.watch.seconds[phase] = own.watch.seconds.get(phase, 0.0) + seconds
    own.stop.interrupted |= found.solution.status is Status.INTERRUPTED
    if found.disagreement is not None and own.original.kernel is None:
        own.heed_outliers(found.disagreement)
    best = "optimum" if found.verdict is Verdict.CERTIFIED else "best estimate found"
    return Start(found.estimate, f"the {best} under the chordal cost")


def _graduated_start(own: Search) -> Start:
    """The end of descents under kernels of falling scale, from the best estimate under F.

    Graduated non-convexity (Blake and Zisserman 1987; Yang et al., RA-L 2020).
    """
    start = _chordal_start(own)
    estimate, kernel = start.estimate, own.problem.kernel
    for power in range(GRADUATED, 0, -1):
        if own.stop.should_stop():
            break
        wider = replace(own.problem, kernel=kernel.scaled(4.0**power))
        with suppress(NumericalError, np.linalg.LinAlgError):
            estimate = descend(wider, estimate, monitor=own.stop, watch=own.watch).estimate
    return Start(estimate, f"kernels of falling scale, from {start.name}")


# --- F: local minima of rising rank ---------------------------------------------------------------


def roundings_of_f(search: Search) -> Iterator[Iterable[Estimate]]:
    """Escape to higher ranks, then in the plane to those over complex numbers."""
    if search.ends():
        return
    yield from _roundings_over_real_numbers(search)
    if over_complex_numbers(search.problem) is not None:
        with search.stop.for_at_most(search.climb_deadline - time.monotonic()):
            yield from roundings_of_surrogates(search)
        search.ended_early = _is_late(search)


def _roundings_over_real_numbers(search: Search) -> Iterator[Iterable[Estimate]]:
    """Escape to higher ranks until the gap is closed or the relaxation is solved."""
    form, settings = search.normalized.eased, search.settings
    for stair in climb(
        form,
        search.point,
        search.highest,
        search.stop,
        lambda step: search.stop(step) or _is_late(search),
        accuracy=partial(_accuracy, search),
        goes_on=partial(goes_on, search),
        next_point=lambda _: search.point,
    ):
        search.counts.update(stair.counts)
        search.levels.append(_level(search, stair))
        fall, lower = form.cost(search.point) - stair.cost, stair.cost
        search.point = stair.point
        done = search.is_certified or search.stop.stop_requested
        if fall <= settings.negligible * search.normalized.tolerance(lower) and not done:
            search.floor = lower  # the eigenvalue was rounding
            return
        yield search.problem.nearest_estimates(stair.point)
        if search.best.cost < (1.0 - settings.same_cost) * lower:
            search.point = search.best.estimate  # no gain at the higher rank yet
        elif not search.is_certified:
            search.improve_bound(search.point)
        if search.is_certified:
            return


def goes_on(search: Search, point: Point, eigenvalue: float) -> bool:
    """Whether to climb on, given the smallest eigenvalue of the certificate matrix at a point.

    At the minimum, records the relaxation's lowest cost. Otherwise computes a first bound if the
    eigenvalue predicts a useful one and the climb may take long.
    """
    level, form = search.levels[-1], search.normalized.eased
    # No point of the relaxation is lower by more than this.
    fall = -eigenvalue * form.n * form.d
    negligible = search.settings.negligible * search.normalized.tolerance(search.best.cost)
    falls = -eigenvalue > resolution(form) and fall > negligible
    if not falls:
        search.floor = form.cost(point)
    else:
        search.levels[-1] = replace(level, eigenvalue=search.normalized.unit * eigenvalue)
        if level.rank > form.d and level.cost - fall > search.lower_bound:
            search.improve_bound(point, tight=False)
    search.ended_early = _is_late(search)
    return falls and not search.ended_early


def _is_late(search: Search) -> bool:
    """Whether the time for climbing is over."""
    return time.monotonic() > search.climb_deadline


def _level(search: Search, stair: Stair) -> Level:
    """The level of a stair, with what ended the descent."""
    if stair.status is not Status.INTERRUPTED:
        return stair.level
    return replace(stair.level, status=search.stop.ended_by or Status.TIME_LIMIT)


def _accuracy(search: Search) -> dict[str, Any]:
    """Of descents at higher ranks: what suffices for the cost so far."""
    settings, newton = search.settings, search.newton
    residual = math.sqrt(search.cost / search.problem.scale)
    return {
        "tolerance": max(settings.lifted_tolerance * residual, newton.tolerance),
        "max_iterations": settings.rank_steps,
        "loosest": newton.loosest,
        "tightest": newton.tightest,
    }


def finish_f(search: Search) -> None:
    """Descents from random roundings; then a weaker bound, if there is no other."""
    _round_at_random(search)
    for point in (search.point, search.best.estimate):
        if not search.is_certified and point is not search.exhausted:
            search.improve_bound(point, tight=False)
        # Over complex numbers, that of an estimate may be better than the last point's.
        if search.lower_bound > 0.0 and over_complex_numbers(search.problem) is None:
            break


def _round_at_random(search: Search) -> None:
    """Descents from random roundings and perturbations of the best, while they improve it."""
    n, settings, failures = search.problem.n, search.settings, 0
    # Looser relaxations have points of higher rank and need more rounds.
    more = search.levels[-1].rank - search.problem.d
    nodes = max(2, settings.round_nodes // n)
    limit = max(1, min(more**2, n // settings.few, nodes, settings.rounds))
    rng = np.random.default_rng(0)
    while failures < limit and not (search.has_reached_the_floor or search.ends()):
        with search.watch.phase("round"):
            starts = roundings(search.problem, search.point, search.best.estimate, rng)
        failures = 0 if search.improve_from(starts) else failures + 1


# --- Distances: the minimum of their relaxation ---------------------------------------------------


def roundings_of_distances(search: Search) -> Iterator[Iterable[Estimate]]:
    """Projections of the minimum, or of what is found before a limit."""
    form = cast("LiftedDistances", search.normalized.eased.lifted_form)
    relaxed = Relaxed(form, search.stop, search.highest)
    for bound in relaxed.bounds():
        search.keep_bound(bound)
    before, search.levels = search.best, relaxed.levels or search.levels
    search.climbed = relaxed.reached
    if not search.is_certified:
        yield relaxed.projections()
    if search.best is not before:
        search.start = search.origin = ORIGIN


def finish_distances(search: Search) -> None:
    """A bound without stiff measurements."""
    if not search.ends():
        search.improve_bound(search.best.estimate)


# --- Other costs: surrogates, expanded at better and better estimates -----------------------------


def roundings_of_surrogates(search: Search) -> Iterator[Iterable[Estimate]]:
    """Minimise surrogates, and begin again where that leads to a lower cost.

    A surrogate is below the cost everywhere and equal to it at the current point: the bound on its
    relaxation is one on the cost, and its rounded minimizer is where another descent begins.
    """
    while not search.ends() and search.surrogates < MOST_SURROGATES:
        before, tried = search.best, 0
        for found in bounding.reached(search.normalized, before.estimate, search.cost):
            search.keep_bound(found.bound)
            if found.stair is not None and not search.ends():
                tried = found.number + 1
                search.levels.append(found.stair.level)
                # With many outliers a bound comes first: descents are long.
                if search.lower_bound > 0.0 or not search.limited_by_outliers:
                    yield search.problem.nearest_estimates(found.stair.point)
            if search.best is not before or search.ends():
                break
        search.surrogates += tried
        if search.best is before:
            return


def finish_similarities(search: Search) -> None:
    """A bound by a lower cost, if there is no other."""
    if search.lower_bound <= 0.0 and not search.ends():
        search.keep_bound(bounding.lowered_bound(search.normalized, search.best.estimate))
    search.ended_early = search.patience < math.inf and search.stop.cut is Status.TIME_LIMIT


def finish_surrogates(search: Search) -> None:
    """As of similarities; the levels are of one surrogate after another, and say nothing of f."""
    finish_similarities(search)
    search.levels = [Level(search.problem.d, search.best.cost, search.status)]


# --- The plans ------------------------------------------------------------------------------------

#: F of poses or rotations: what it takes is cheap, and bounds are the tightest at the last point.
CHORDAL = Plan(
    (_suitable_start,),
    roundings_of_f,
    finish_f,
    endings.obstacle_of_f,
    tries_own_start=True,
    climbs_cost=True,
    limits="climb",
    outliers="first",
    limited_by_outliers=True,
)
#: F and distances: the relaxation is seldom tight, so that it is climbed first, and estimates have
#: no bounds of their own worth their time. A first answer says nothing of measurements.
DISTANCES = Plan(
    (_any_start,),
    roundings_of_distances,
    finish_distances,
    endings.obstacle_of_distances,
    "relaxation",
    descends_from_own_start=False,
    begins_at_file=True,
    given_share=0.3,
    bounds_estimates=False,
    outliers="last",
)
#: The cost of another program: the optimum under F follows, unless an estimate is given, where the
#: first one is not proven optimal, and many outliers found there limit the time.
SURROGATES = Plan(
    (_averaged_start, _chordal_start),
    roundings_of_surrogates,
    finish_surrogates,
    endings.obstacle_of_surrogates,
    "surrogates",
    sharp=True,
    limits="search",
    outliers="first",
    descended=False,
    settled=frozenset({Status.CONVERGED}),
)
#: A cost under a robust kernel: other basins are likely, and measurements that disagree expected.
ROBUST = replace(SURROGATES, starts=(_averaged_start, _graduated_start), outliers=None)
#: Velocities and gravity, too: what disagrees is not looked for.
INERTIAL = replace(SURROGATES, outliers=None)
#: F with unknown scales, and other measurements besides.
SIMILARITY_SUMS = replace(
    SURROGATES,
    starts=(
        lambda search: similarity_starts.nearest_start(search.problem),
        lambda search: similarity_starts.least_shrunk_start(search.problem),
    ),
    tries_own_start=True,
    outliers=None,
)
#: F with unknown scales.
SIMILARITIES = replace(
    SIMILARITY_SUMS,
    finish=finish_similarities,
    obstacle=endings.obstacle_of_similarities,
    climbs="staircase",
)
