"""Detection and rejection of measurements that disagree with the rest, by their residuals.

Weights state the noise: the terms of correct measurements have a known distribution
(`quantiles`), and fewer than one in a hundred clean graphs have a term above its ``1 - 0.01 / m``
quantile. Least squares spreads the error of a wrong measurement over its neighbours, so outliers
are identified by a robust fit where that is worth its time. Weights may also state nothing (weights
of 1 on rotations) or too little noise: then the noise is estimated from the median residual, and
outliers must lie far beyond it.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from certpgo.errors import GraphError, NumericalError
from certpgo.graph import Estimate, Graph
from certpgo.graph.display import Brief
from certpgo.graph.phrases import counted
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.chi_squared import flagged_from, quantiles
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import start_of
from certpgo.optimize.methods._robust import connected
from certpgo.optimize.methods.adaptive_trimming import EXACT, PLENTY, AdaptiveTrimming
from certpgo.optimize.methods.graduated_non_convexity import GraduatedNonConvexity, largest_angle
from certpgo.optimize.methods.spanning_tree import SpanningTree
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Solution
from certpgo.solve.selection import Posed, Selection, near_relaxation

#: Multiple of the estimated noise accepted as noise where weights do not state it: real residuals
#: have heavier tails than normal ones.
WIDER = 2.0
#: Angles (radians) that are never flagged where weights do not state the noise.
UNREMARKABLE = math.radians(10.0)
#: Share of the measurements outside a spanning tree that a credible robust fit keeps.
BELIEVABLE = 0.25
#: Share of the measurements outside a spanning tree from which disagreement is widespread.
MANY = 0.05
#: Fits to estimate the noise at most, and the relative reduction that justifies another.
ROUNDS, GAIN = 6, 0.2
#: Choices under the cost of another program at most, and how well the fits between them converge.
CHOICES, CLOSE = 20, 1e-6
#: Rejected measurements that are tried again at most, and up to how many times the noise.
TRIALS, WORTH = 30, 5.5


@dataclass(frozen=True, eq=False, repr=False)
class Disagreement(Brief):
    """Measurements that disagree with the rest.

    Attributes
    ----------
    edges : (k,) their indices, ascending
    total : number m of all measurements
    worst_angle : largest residual angle among them, radians

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Disagreement
    >>> print(Disagreement(np.array([3, 8]), 100, np.pi / 2))
    2 of 100 measurements disagree with the rest, by up to 90 degrees
    """

    edges: IntArray
    total: int
    worst_angle: float

    def spreads_over(self, graph: Graph) -> bool:
        """Whether they are a large share of the measurements beyond a spanning tree."""
        return len(self.edges) > MANY * (self.total - graph.num_nodes + 1)

    def __str__(self) -> str:
        """Their number and largest residual angle in a sentence."""
        few = f"{len(self.edges)} of {counted(self.total, 'measurement{s}')}"
        verb = "disagrees" if len(self.edges) == 1 else "disagree"
        said = f"{few} {verb} with the rest"
        if self.worst_angle == 0.0:  # positions alone
            return said
        return f"{said}, by up to {math.degrees(self.worst_angle):.3g} degrees"


def ignore(disagreement: Disagreement) -> None:
    """Do nothing."""


def disagreement(
    problem: Posed, estimate: Estimate, *, refit: bool = False, monitor: Monitor = silent
) -> Disagreement | None:
    """The measurements that disagree with the rest, by their residuals.

    Parameters
    ----------
    estimate : a fit to all measurements, such as the result of a descent
    refit : whether to compute a robust fit if residuals are suspicious; it takes longer than a
        descent, but also finds outliers that least squares hides
    monitor : may stop that fit

    Returns
    -------
    None if the residuals are consistent with the weights or with one another, or if a robust kernel
    expects others.

    Examples
    --------
    A triangle with four exact measurements per edge, and one more that is wrong by 90 degrees:

    >>> import numpy as np
    >>> from certpgo import RotationGraph, Quadratic, solve
    >>> from certpgo.solve.outliers import disagreement
    >>> edges = np.array([(0, 1), (1, 2), (2, 0)] * 4 + [(0, 1)])
    >>> R = np.tile(np.eye(2), (13, 1, 1))
    >>> R[-1] = [[0.0, -1.0], [1.0, 0.0]]
    >>> problem = Quadratic(RotationGraph(3, edges, R, kappa=np.full(13, 1e4)))
    >>> print(disagreement(problem, solve(problem).estimate, refit=True))
    1 of 13 measurements disagrees with the rest, by up to 90 degrees
    """
    if problem.kernel is not None or agrees(problem, estimate):
        return None
    stated = states_noise(problem)
    angles = problem.residual_angles(estimate)
    costs = problem.edge_costs(estimate)
    found = outlying(problem, costs, WIDER * noise_scale(problem, costs))
    hidden = stated and not found.any() and angles.max() > math.pi / 2.0
    if refit or hidden:
        with suppress(NumericalError, np.linalg.LinAlgError):
            chosen = select(problem, fit=estimate, monitor=monitor)
            found, angles = chosen.rejected, problem.residual_angles(chosen.estimate)
    turned = problem.graph.measures_rotation
    edges = np.flatnonzero(found if stated else found & ((angles > UNREMARKABLE) | ~turned))
    if len(edges) == 0:
        return None
    others = sum(block.num_edges for block in problem.measured.blocks)
    total = problem.measured.num_measurements + others
    return Disagreement(edges, total, float(angles[edges].max()))


def agrees(problem: Posed, estimate: Estimate) -> bool:
    """Whether all residuals are consistent with the weights or, failing that, with one another."""
    costs = problem.edge_costs(estimate)
    if not np.isfinite(costs).all():
        return True  # cannot be decided
    if states_noise(problem):
        return not outlying(problem, costs, 1.0).any()
    if problem.residual_angles(estimate).max() <= UNREMARKABLE:
        return True
    return not outlying(problem, costs, noise_scale(problem, costs)).any()


def states_noise(problem: Posed) -> bool:
    """Whether some angle contradicts the weights; weights of 1, about 40 degrees, allow all."""
    return largest_angle(problem.chordal, math.sqrt(quantiles(problem, 0.99).max())) < math.pi


def noise_scale(problem: Posed, costs: FloatArray, kept: BoolArray | None = None) -> float:
    """Noise by the median residual, relative to the standard deviation that the weights state.

    Parameters
    ----------
    costs : (m,) terms of the cost. The fit uses up as many numbers as determine the nodes;
        residuals of exact measurements are rounding, and count as `EXACT`
    kept : (m,) the measurements that were fitted, by default all
    """
    d, q = problem.d, so.tangent_dim(problem.d)
    turned, moved = problem.numbers
    graph, numbers = problem.chordal.graph, turned + moved
    kept = graph.is_measured if kept is None else kept & graph.is_measured
    total = float(numbers[kept].sum())
    poses = len(problem.chordal.poses)
    used = (poses - 1) * (q + d * bool(moved.any())) + (problem.n - poses) * d
    used -= int(numbers[~graph.is_measured].sum())  # what constraints determine is not fitted
    redundant = max(total - used, total / int(kept.sum())) / total
    relative = float(np.median(costs[kept] / quantiles(problem, 0.5)[kept]))
    exact = EXACT * math.sqrt(2.0 * problem.chordal.rotation.median_kappa)
    return max(math.sqrt(relative / redundant), exact)


def select(
    problem: Posed,
    *,
    fit: Estimate | None = None,
    initial: Estimate | None = None,
    trusted: IntArray | None = None,
    monitor: Monitor = silent,
) -> Selection:
    """The measurements that agree with one another, by a robust fit.

    Rotation graphs with many measurements use `adaptive_trimming`, others graduated non-convexity
    from ``initial`` or the tree of the earliest measurements, with the noise that the weights
    state. If they state none, or hardly more than a tree agrees with it, the noise is estimated:
    from the residuals of a fit to all measurements, then repeatedly from those of the kept ones.

    Under the cost of another program that is how the choice begins, by F with the kappa of that
    cost. Then fits to the kept measurements under the cost itself, and choices by its terms, take
    turns until the choice stands.

    Parameters
    ----------
    fit : fit to all measurements, if already computed
    initial : initial estimate
    trusted : (k,) measurements that are known to be right, such as odometry, and never rejected
    monitor : may stop the fits

    Raises
    ------
    NumericalError
        No initialization could be computed.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> from certpgo.solve.outliers import select
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> chosen = select(Quadratic(instance.graph))
    >>> chosen.method, bool((chosen.rejected == instance.outliers).all())
    ('adaptive_trimming', True)
    """
    if not problem.is_chordal:
        of_program = cast("Sum", problem)
        begun = _begun(of_program, fit, initial, trusted, monitor)
        fits = [begun] if begun.stated is None else [begun, begun.stated]
        chosen, *stated = (_under(of_program, one, trusted, monitor) for one in fits)
        return _beside(problem, chosen, stated)
    problem = cast("Quadratic", problem)
    if not problem.has_positions and problem.graph.num_edges >= PLENTY * problem.n:
        name = "adaptive_trimming"
        found = AdaptiveTrimming().solve(problem, initial=initial, monitor=monitor)
        found_at = [(found, 1.0)] if states_noise(problem) else []
        if not (found_at and _confirms_weights(problem, found)):
            found_at.insert(0, (found, WIDER * _noise_kept(problem, found)))
    else:
        name = "graduated_non_convexity"
        found_at = _graduated(problem, fit, initial, trusted, monitor)
    chosen, *stated = (
        Selection(_kept(problem, one.estimate, scale, trusted), one.estimate, name, scale)
        for one, scale in found_at
    )
    chosen, *stated = (_reconsidered(problem, one, monitor) for one in (chosen, *stated))
    return _beside(problem, chosen, stated)


def _begun(
    problem: Sum,
    fit: Estimate | None,
    initial: Estimate | None,
    trusted: IntArray | None,
    monitor: Monitor,
) -> Selection:
    """The choice by F of the edges alone, with what else agrees with it, or all that disagrees."""
    if not problem.measured.blocks:
        edges = problem.chordal
        return select(edges, fit=fit, initial=initial, trusted=trusted, monitor=monitor)
    graph, rows = problem.measured.with_blocks(), problem.graph.num_edges
    try:
        alone = Quadratic(graph, problem.engine)
    except GraphError:  # all else that is measured determines some nodes
        found = fit or initial or near_relaxation(problem)
        return Selection(np.ones(rows), found, "residuals", 1.0)
    own = None if trusted is None else trusted[trusted < graph.num_edges]
    chosen = select(alone, initial=initial or fit, trusted=own, monitor=monitor)
    costs, usual = problem.edge_costs(chosen.estimate), quantiles(problem, 0.5)
    others = np.arange(rows) >= problem.measured.num_edges
    weighed = others & (usual > 0.0)
    ratio = np.median(costs[weighed] / usual[weighed]) if weighed.any() else 1.0
    kept = ~outlying(problem, costs, WIDER * math.sqrt(max(1.0, float(ratio))))
    if trusted is not None:
        kept[trusted] = True
    return chosen.with_more(np.where(kept, 1.0, 0.0)[others])


def _beside(problem: Posed, chosen: Selection, stated: list[Selection]) -> Selection:
    """The choice with the cheapest one at the stated noise, if there is one, and it differs."""
    if not stated:
        return chosen
    best = min(stated, key=lambda one: _truncated(problem, one.weights, one.estimate))
    return replace(chosen, stated=best) if (best.weights != chosen.weights).any() else chosen


def _truncated(problem: Posed, weights: FloatArray, estimate: Estimate) -> float:
    """The cost of what is kept, and the prices of the rest at the stated noise."""
    prices = quantiles(problem, flagged_from(problem))
    return float(np.where(weights > 0.0, problem.edge_costs(estimate), prices).sum())


def _kept(problem: Posed, estimate: Estimate, scale: float, trusted: IntArray | None) -> FloatArray:
    """(m,) 1 for what agrees with an estimate, is trusted or connects the graph, otherwise 0."""
    costs = problem.edge_costs(estimate)
    kept = ~outlying(problem, costs, scale)
    if trusted is not None:
        kept[trusted] = True
    return connected(problem.chordal, np.where(kept, 1.0, 0.0), costs)


def _under(problem: Sum, begun: Selection, trusted: IntArray | None, monitor: Monitor) -> Selection:
    """The choice by the terms of the cost of another program, from that by F."""
    weights, estimate, scale = begun.weights, begun.estimate, begun.scale
    for _ in range(CHOICES):
        estimate = _fit(problem.reweighted(weights), estimate, monitor)
        if begun.scale != 1.0:
            scale = WIDER * noise_scale(problem, problem.edge_costs(estimate), weights > 0.0)
        before, weights = weights, _kept(problem, estimate, scale, trusted)
        if (weights == before).all():
            break
    return _reconsidered(problem, Selection(weights, estimate, begun.method, scale), monitor)


def _fit(problem: Posed, start: Estimate, monitor: Monitor) -> Estimate:
    """A fit near another one."""
    close = NewtonSettings(tolerance=CLOSE)
    return descend(problem, start, close, tolerance=CLOSE, monitor=monitor).estimate


def _reconsidered(problem: Posed, chosen: Selection, monitor: Monitor) -> Selection:
    """The choice with what is cheaper to keep than to leave out for its price.

    A right measurement that is left out is farther off than one that takes part in the fit. Noise
    that is estimated is too rough for that.
    """
    if chosen.scale != 1.0:
        return chosen
    weights, estimate = chosen.weights, chosen.estimate
    costs = problem.edge_costs(estimate)
    least = _truncated(problem, weights, estimate)
    doubtful = np.flatnonzero((weights == 0.0) & ~outlying(problem, costs, WORTH))
    for e in doubtful[np.argsort(costs[doubtful], kind="stable")][:TRIALS]:
        trial = weights.copy()
        trial[e] = 1.0
        found = _fit(problem.reweighted(trial), estimate, monitor)
        cost = _truncated(problem, trial, found)
        if cost < least:
            weights, estimate, least = trial, found, cost
    return replace(chosen, weights=weights, estimate=estimate)


def _graduated(
    problem: Quadratic,
    fit: Estimate | None,
    initial: Estimate | None,
    trusted: IntArray | None,
    monitor: Monitor,
) -> list[tuple[Solution, float]]:
    """Fits by graduated non-convexity, the best first, and the noise scales for their residuals.

    Those after it are at the stated noise, with which hardly more than a tree agrees: one more is
    the tree of the earliest measurements itself.
    """
    at_stated = []

    def fitted(solver: GraduatedNonConvexity, start: Estimate | None) -> Solution:
        return solver.solve(problem, initial=start, trusted=trusted, monitor=monitor)

    if states_noise(problem):
        found = fitted(GraduatedNonConvexity(probability=flagged_from(problem)), initial)
        at_stated = [(found, 1.0)]
        if _confirms_weights(problem, found):
            return at_stated
        if not problem.graph.is_partial:
            at_stated.append((SpanningTree("earliest").solve(problem), 1.0))
    if fit is None:
        start = start_of(problem)
        fit = newton(problem, start.estimate, near=start.near, monitor=monitor).estimate
    scale = noise_scale(problem, problem.edge_costs(fit))
    for _ in range(ROUNDS):
        found = fitted(GraduatedNonConvexity(scale=scale), initial)
        before, scale = scale, _noise_kept(problem, found)
        if scale > (1.0 - GAIN) * before:
            break
    found = fitted(GraduatedNonConvexity(scale=WIDER * scale), found.estimate)
    return [(found, WIDER * _noise_kept(problem, found)), *at_stated]


def _noise_kept(problem: Quadratic, found: Solution) -> float:
    """The noise scale of the measurements that a method kept."""
    kept = None if found.weights is None else found.weights > 0.0
    return noise_scale(problem, problem.edge_costs(found.estimate), kept)


def _confirms_weights(problem: Quadratic, found: Solution) -> bool:
    """Whether clearly more than a spanning tree was kept."""
    tree, m = problem.n - 1, problem.graph.num_edges
    return found.kept is None or found.kept - tree >= BELIEVABLE * (m - tree)


def outlying(problem: Posed, costs: FloatArray, scale: float) -> BoolArray:
    """(m,) which terms of the cost, ``costs`` (m,), are too large for noise of this scale."""
    return np.asarray(costs > scale**2 * quantiles(problem, flagged_from(problem)))
