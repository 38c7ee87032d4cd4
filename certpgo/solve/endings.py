"""How a search ends: the certificate, what keeps its gap open, and the words for it."""

from __future__ import annotations

from dataclasses import replace

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.certify.verdict import loses_to_rounding, of_relaxation, verdict
from certpgo.certify.wording import early
from certpgo.graph.phrases import counted
from certpgo.graph.priors import mirrored_by
from certpgo.graph.trees import with_leaves_placed
from certpgo.optimize.solution import Solution
from certpgo.solve import bounding
from certpgo.solve.outliers import agrees
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search_loop import Search

#: Verdicts whose gap something keeps open.
UNPROVEN = (Verdict.BOUNDED, Verdict.UNDECIDED)


def result_of(search: Search) -> CertifiedSolution:
    """The best estimate of a search, with its certificate."""
    _place_leaves(search)
    return _result(search, certificate(search))


def _place_leaves(search: Search) -> None:
    """Put nodes of single measurements, as held ones are, where these have them.

    Descents have done so, unless they were stopped; and but to rounding where some edges may be
    constraints. Other terms than those of edges in one unit hold leaves, too.
    """
    original = search.original
    if original.measured.blocks or original.takes_scales:
        return
    graph = original.chordal.graph
    constrained = graph.assumed is not None or not graph.has_positions
    if not constrained and search.stop.ended_by is None:
        return
    estimate = with_leaves_placed(graph, search.best.estimate)
    if estimate is not search.best.estimate:
        cost = search.problem.cost(estimate)
        search.best = replace(search.best, estimate=estimate, cost=cost)
        search.cost = search.normalized.cost_upper(estimate)


def certificate(search: Search) -> Certificate:
    """At the tier asked for; by default the proof tier if only rounding is in the way."""
    tier, minimum = search.tier, search.minimum
    found = verdict(search.normalized, minimum.point, minimum)
    if not (tier is Tier.PROOF or (tier is None and _may_be_proven(search, found))):
        return found
    with search.watch.phase("prove"):
        exact = replace(search.normalized, tier=Tier.PROOF, real=True)
        minimum = replace(minimum, cost=exact.cost_upper(minimum.point))
        # A search stopped before the requested proof must not return a weaker tier instead.
        bound = None if search.stop.should_stop() else bounding.proven(exact, minimum)
        proven = verdict(exact, minimum.point, replace(minimum, bound=bound))
    better = proven.lower_bound > found.lower_bound
    return proven if tier is Tier.PROOF or better else found


def _may_be_proven(search: Search, found: Certificate) -> bool:
    """Whether only rounding keeps the gap open, and the proof tier may close it."""
    if search.plan.climbs_cost:
        rounding = search.is_certified or search.has_reached_the_floor
    else:
        rounding = loses_to_rounding(search.normalized, search.bound, search.cost)
    may = rounding and found.is_near and not search.problem.unprovable
    return may and not search.stop.should_stop()


def _result(search: Search, found: Certificate) -> CertifiedSolution:
    """The result, in the units of the graph."""
    stop, estimate, unit = search.stop, search.best.estimate, search.normalized.unit
    outliers = search.disagreement
    # Those of a first descent to a local minimum may be none.
    if outliers is not None and agrees(search.original, estimate):
        outliers = None
    solution = Solution(
        estimate=estimate,
        cost=found.cost_computed,
        status=search.status,
        iterations=max(len(stop.trace) - 1, 0),
        lower_bound=found.lower_bound,
        seconds=search.watch.seconds,
        trace=tuple(stop.trace),
        counts=dict(search.counts),
        note=f"initialized by {search.origin}{_ending(search)}",
    )
    return CertifiedSolution(
        solution,
        replace(found, obstacle=search.plan.obstacle(search, found)),
        search.start,
        tuple(replace(level, cost=unit * level.cost) for level in search.levels),
        search.settings,
        search.original,
        (outliers,) if search.looked else None,
    )


def _ending(search: Search) -> str:
    """Where the search ended, and how to continue it if its own limit ended it."""
    surrogates = counted(search.surrogates, "surrogate{s}")
    if search.plan.climbs == "surrogates":
        where = f"; {surrogates} minimised" if search.surrogates else ""
    else:
        where = f"; the {search.plan.climbs} ended at rank {search.levels[-1].rank}"
    if not search.ended_early:
        return where
    return f"{where}{', ' if search.plan.limits == 'climb' else '; ended '}{early(search.patience)}"


# --- What keeps a gap open ------------------------------------------------------------------------


def obstacle_of_f(search: Search, found: Certificate) -> Obstacle:
    """Rounding, the time, or the relaxation, whose points may be mirrored."""
    if found.verdict not in UNPROVEN:
        return found.obstacle
    rank, stopped, graph = search.levels[-1].rank, search.stop.cut, search.problem.graph
    patience = search.patience if search.ended_early else None
    about = Obstacle(found.limited_by, True, rank, stopped, patience)
    if found.verdict is Verdict.BOUNDED and graph.has_positions:
        about = replace(about, mirrored=mirrored_by(graph))
    if search.has_reached_the_floor and stopped is None:
        return replace(about, kind=LimitedBy.ROUNDING, mirrored=None)
    ended = stopped is not None or search.ended_early
    loose = about.mirrored is not None or not ended
    return replace(about, kind=LimitedBy.LOOSE if loose else LimitedBy.STOPPED)


def obstacle_of_distances(search: Search, found: Certificate) -> Obstacle:
    """The relaxation, or the time."""
    return of_relaxation(found, search.climbed, search.stop.cut)


def obstacle_of_similarities(search: Search, found: Certificate) -> Obstacle:
    """The time, or what was found at the estimate, with the last rank."""
    if found.verdict not in UNPROVEN:
        return found.obstacle
    reached = replace(found.obstacle, searched=True, rank=search.levels[-1].rank)
    return _stopped(search, found) or reached


def obstacle_of_surrogates(search: Search, found: Certificate) -> Obstacle:
    """The time, or what was found at the estimate, whose mirror image may fit as well."""
    loose = found.verdict is Verdict.BOUNDED and found.obstacle.kind is LimitedBy.LOOSE
    if loose and search.stop.cut is None:
        return replace(found.obstacle, mirrored=mirrored_by(search.original.measured))
    return _stopped(search, found) or found.obstacle


def _stopped(search: Search, found: Certificate) -> Obstacle | None:
    """That the time ended before there was a bound, if so."""
    if search.stop.cut is None or found.verdict is not Verdict.UNDECIDED:
        return None
    return Obstacle(LimitedBy.STOPPED, True, search.problem.d, search.stop.cut)
