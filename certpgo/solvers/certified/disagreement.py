"""Measurements that disagree with the rest: told from residuals, and left out where that is asked.

A residual is judged by what the weights say of the noise: the terms of F of right measurements
have a known distribution (`quantile`), and not one in a hundred clean graphs has a term above its
``1 - 0.01 / m`` quantile. Least squares spreads the error of a wrong measurement over its
neighbours, so that who disagrees is told from a robust fit wherever that is worth its time.
Weights may also say nothing, as those of 1 do of rotations, or claim too little noise: then the
noise is measured by the median residual, and what disagrees must be far outside.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.io.plural import counted
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.problem import Problem, RotationProblem
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.newton import newton
from certpgo.optimize.solution import Solution
from certpgo.optimize.starts import start_of
from certpgo.solvers._robust import connected, remark
from certpgo.solvers.adaptive_trimming import EXACT, PLENTY, AdaptiveTrimming
from certpgo.solvers.graduated_non_convexity import (
    GraduatedNonConvexity,
    largest_angle,
    quantile,
)

#: Share of clean graphs in which a right measurement may be said to disagree.
FALSE_ALARMS = 0.01
#: Times the measured noise that counts as noise, where weights do not state it: real residuals have
#: heavier tails than normal ones.
WIDER = 2.0
#: Angles (radians) that are no news where weights say nothing of the noise.
UNREMARKABLE = math.radians(10.0)
#: Share of the measurements beyond a tree's that a robust fit must keep to be believed.
BELIEVABLE = 0.25
#: Fits in which the noise is measured, and by what share a further one must reduce it.
ROUNDS, GAIN = 6, 0.2


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Measurements that disagree with the rest.

    Attributes
    ----------
    edges : (k,) which ones, ascending
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

    def __str__(self) -> str:
        """How many of how many, and by how much."""
        few = f"{len(self.edges)} of {counted(self.total, 'measurement{s}')}"
        verb = "disagrees" if len(self.edges) == 1 else "disagree"
        angle = f"{math.degrees(self.worst_angle):.3g} degrees"
        return f"{few} {verb} with the rest, by up to {angle}"


def ignore(disagreement: Disagreement) -> None:
    """Be told, and do nothing."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Measurements that agree, and a fit to them.

    Attributes
    ----------
    weights : (m,) 1 for those that were kept, 0 for the others; what is kept is connected
    estimate : a robust fit, near the best one to what is kept
    method : that found the fit
    scale : standard deviations of the noise by which residuals were judged, in those that the
        weights state
    """

    weights: FloatArray
    estimate: Estimate
    method: str
    scale: float

    @property
    def rejected(self) -> BoolArray:
        """(m,) which measurements were not kept."""
        return np.asarray(self.weights == 0.0)

    def note(self, problem: Problem) -> str:
        """How they were chosen, and what a reader should know of that."""
        scale = "as" if self.scale == 1.0 else f"{self.scale:.3g} times what"
        chosen = f"chosen by {self.method}, with noise {scale} the weights state"
        return "; ".join(filter(None, (chosen, remark(problem, self.weights))))


def disagreement(
    problem: Problem, estimate: Estimate, *, refit: bool = False, monitor: Monitor = silent
) -> Disagreement | None:
    """The measurements that disagree with the rest, if residuals give reason to say so.

    Parameters
    ----------
    estimate : that fits all measurements, such as where a descent of F ended
    refit : whether to compute a robust fit where residuals give reason to, which takes longer than
        a descent; without one, what least squares hides is not found
    monitor : may stop that fit

    Returns
    -------
    None where residuals are as the weights say, or as those of the rest.

    Examples
    --------
    A triangle of exact measurements, four times each, and one more that is a quarter turn off:

    >>> import numpy as np
    >>> from certpgo import RotationGraph, RotationProblem, solve
    >>> from certpgo.solvers.certified.disagreement import disagreement
    >>> edges = np.array([(0, 1), (1, 2), (2, 0)] * 4 + [(0, 1)])
    >>> R = np.tile(np.eye(2), (13, 1, 1))
    >>> R[-1] = [[0.0, -1.0], [1.0, 0.0]]
    >>> problem = RotationProblem(RotationGraph(3, edges, R, kappa=np.full(13, 1e4)))
    >>> print(disagreement(problem, solve(problem.graph).estimate, refit=True))
    1 of 13 measurements disagrees with the rest, by up to 90 degrees
    """
    if agrees(problem, estimate):
        return None
    stated = states_noise(problem)
    angles = problem.residual_angles(estimate)
    found = _outlying(problem, problem.edge_costs(estimate), WIDER * _noise(problem, estimate))
    hidden = stated and not found.any() and angles.max() > math.pi / 2.0
    if refit or hidden:
        with suppress(NumericalError, np.linalg.LinAlgError):
            chosen = select(problem, fit=estimate, monitor=monitor)
            found, angles = chosen.rejected, problem.residual_angles(chosen.estimate)
    edges = np.flatnonzero(found if stated else found & (angles > UNREMARKABLE))
    if len(edges) == 0:
        return None
    return Disagreement(edges, problem.graph.num_edges, float(angles[edges].max()))


def agrees(problem: Problem, estimate: Estimate) -> bool:
    """Whether no residual is above what weights say or, where they say nothing, what is common."""
    costs = problem.edge_costs(estimate)
    if not np.isfinite(costs).all():
        return True  # nothing can be said
    if states_noise(problem):
        return not _outlying(problem, costs, 1.0).any()
    common = not _outlying(problem, costs, _noise(problem, estimate)).any()
    return common or bool(problem.residual_angles(estimate).max() <= UNREMARKABLE)


def states_noise(problem: Problem) -> bool:
    """Whether some angle contradicts the weights: of 1, which say 40 degrees or so, none does."""
    return largest_angle(problem, math.sqrt(quantile(problem, 0.99))) < math.pi


def noise_scale(problem: Problem, costs: FloatArray) -> float:
    """Standard deviations of the noise, in those that the weights state, by the median residual.

    Parameters
    ----------
    costs : (k,) terms of F of the measurements that were fitted, k >= 1. Of k residuals n - 1 are
        fitted away; those of exact measurements are rounding, and count as `EXACT`
    """
    k = len(costs)
    redundant = max(k - problem.n + 1, 1) / k
    measured = math.sqrt(float(np.median(costs)) / (quantile(problem, 0.5) * redundant))
    exact = EXACT * math.sqrt(2.0 * float(np.median(problem.rotation.graph.kappa)))
    return max(measured, exact)


def select(
    problem: Problem,
    *,
    fit: Estimate | None = None,
    initial: Estimate | None = None,
    monitor: Monitor = silent,
) -> Selection:
    """The measurements that agree with one another, by a robust fit.

    Rotations with plenty of measurements are trimmed (`adaptive_trimming`). Otherwise graduated
    non-convexity starts from ``initial``, or else from the tree of the earliest measurements, with
    the noise that weights state. Where they state none, or hardly more than a tree agrees with
    what they state, the noise is measured: first by the residuals of the fit to everything, then
    by those of what was kept, until that gains no more.

    Parameters
    ----------
    fit : to all measurements, where there is one already
    initial : where to start
    monitor : may stop it

    Raises
    ------
    NumericalError
        A start could not be computed.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import RotationProblem
    >>> from certpgo.datasets.thesis import langevin_graph
    >>> from certpgo.solvers.certified.disagreement import select
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> chosen = select(RotationProblem(instance.graph))
    >>> chosen.method, bool((chosen.rejected == instance.outliers).all())
    ('adaptive_trimming', True)
    """
    if isinstance(problem, RotationProblem) and problem.graph.num_edges >= PLENTY * problem.n:
        name = "adaptive_trimming"
        found = AdaptiveTrimming().solve(problem, initial=initial, monitor=monitor)
        confirmed = states_noise(problem) and _confirms_weights(problem, found)
        scale = 1.0 if confirmed else WIDER * _noise_kept(problem, found)
    else:
        name = "graduated_non_convexity"
        found, scale = _graduated(problem, fit, initial, monitor)
    costs = problem.edge_costs(found.estimate)
    kept = ~_outlying(problem, costs, scale)
    weights = connected(problem, np.where(kept, 1.0, 0.0), costs)
    return Selection(weights, found.estimate, name, scale)


def _graduated(
    problem: Problem, fit: Estimate | None, initial: Estimate | None, monitor: Monitor
) -> tuple[Solution, float]:
    """What graduated non-convexity finds, and the scale of noise to judge residuals by."""
    if states_noise(problem):
        solver = GraduatedNonConvexity(probability=_probability(problem))
        found = solver.solve(problem, initial=initial, monitor=monitor)
        if _confirms_weights(problem, found):
            return found, 1.0
    if fit is None:
        start = start_of(problem)
        fit = newton(problem, start.estimate, near=start.near, monitor=monitor).estimate
    scale = noise_scale(problem, problem.edge_costs(fit))
    for _ in range(ROUNDS):
        solver = GraduatedNonConvexity(scale=scale)
        found = solver.solve(problem, initial=initial, monitor=monitor)
        before, scale = scale, _noise_kept(problem, found)
        if scale > (1.0 - GAIN) * before:
            break
    solver = GraduatedNonConvexity(scale=WIDER * scale)
    found = solver.solve(problem, initial=found.estimate, monitor=monitor)
    return found, WIDER * _noise_kept(problem, found)


def _noise_kept(problem: Problem, found: Solution) -> float:
    """The noise of what a method kept."""
    costs = problem.edge_costs(found.estimate)
    return noise_scale(problem, costs if found.weights is None else costs[found.weights > 0.0])


def _confirms_weights(problem: Problem, found: Solution) -> bool:
    """Whether much more than a tree agrees."""
    tree, m = problem.n - 1, problem.graph.num_edges
    return found.kept is None or found.kept - tree >= BELIEVABLE * (m - tree)


def _outlying(problem: Problem, costs: FloatArray, scale: float) -> BoolArray:
    """(m,) which terms of F are larger than noise of this scale makes them."""
    return np.asarray(costs > scale**2 * quantile(problem, _probability(problem)))


def _probability(problem: Problem) -> float:
    """With which a right measurement's residual is no larger than that of any is to be."""
    return 1.0 - FALSE_ALARMS / problem.graph.num_edges


def _noise(problem: Problem, estimate: Estimate) -> float:
    return noise_scale(problem, problem.edge_costs(estimate))
