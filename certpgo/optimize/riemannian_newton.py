"""Newton's method on SE(d)^n or SO(d)^n, with exact sparse Hessians and translations eliminated.

It converges in a few steps even from far away: after every step the translations are solved for
again (variable projection), so that a long chain of poses can rotate as one body; an indefinite
Hessian is replaced by the Gauss-Newton matrix as long as such steps make progress; and a factor
serves later steps as long as they converge fast (`Chord`).

Local: it finds a stationary point near its initial estimate, near which the Hessian was factorized:
a local minimum in all likelihood, and not necessarily the global one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.cg import End
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.quadratic_model import ROUNDING
from certpgo.optimize.chord_method import Chord
from certpgo.optimize.descent_loop import Gain, Proposal, minimise
from certpgo.optimize.factors import Factors
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

#: Chords that take no longer than a step with a new factor, in small graphs.
CHORDS = 5


@dataclass(frozen=True)
class NewtonSettings(Iterative):
    """Settings of Newton's method; the defaults serve graphs of any size and noise.

    Attributes
    ----------
    tolerance : stationarity at which to stop, radians, see `FirstOrder`
    max_iterations : stop anyway
    slow_decrease : the exact Hessian is tried after a Gauss-Newton step that reduced F by less than
        this fraction
    near : or when the stationarity is below this angle, radians
    stagnation : Gauss-Newton replaces an indefinite Hessian while steps reduce F by this fraction
    min_gain, good_gain : actual over predicted decrease from which a step is accepted, and from
        which the damping is reduced
    first_damping, second_damping : after an indefinite Hessian, and after a rejected step; in units
        of the metric
    smallest_damping, largest_damping : less is set to zero; with more the method stops
    loosest, tightest : relative residuals of conjugate gradients preconditioned by an old factor
    max_products : products at most before a new factor; fewer where that costs less
    large : nodes from which any old factor is tried first
    single_from : products that must cost less than a factor for single precision to be tried
    enough : stop, too, where the last factor predicts that F can fall by at most this fraction

    Examples
    --------
    >>> from certpgo.optimize.riemannian_newton import NewtonSettings
    >>> NewtonSettings(max_iterations=20).tolerance
    1e-12
    """

    tolerance: float = 1e-12
    max_iterations: int = 100
    slow_decrease: float = 0.5
    near: float = 1e-3
    stagnation: float = 1e-3
    min_gain: float = 1e-3
    good_gain: float = 0.75
    first_damping: float = 1e-3
    second_damping: float = 1e-6
    smallest_damping: float = 1e-9
    largest_damping: float = 1e9
    loosest: float = 0.1
    tightest: float = 1e-6
    max_products: int = 30
    large: int = 20_000
    single_from: int = 2
    enough: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.min_gain < self.good_gain < 1.0:
            raise SpecError("0 < min_gain < good_gain < 1 is required")
        if not 0.0 < self.tightest <= self.loosest < 1.0:
            raise SpecError("0 < tightest <= loosest < 1 is required")
        dampings = (self.smallest_damping, self.second_damping, self.first_damping)
        if not all(0.0 < damping < self.largest_damping < math.inf for damping in dampings):
            raise SpecError("dampings must be positive and finite, and largest_damping the largest")
        others = ("slow_decrease", "near", "stagnation", "max_products", "large", "enough")
        for name in (*others, "single_from"):
            if not getattr(self, name) >= 0:
                raise SpecError(f"{name} must not be negative: {getattr(self, name)}")


DEFAULT = NewtonSettings()


def newton(
    problem: Quadratic,
    initial: Estimate,
    settings: NewtonSettings = DEFAULT,
    *,
    near: bool = False,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Solution:
    """Descend from ``initial`` to a stationary point.

    Parameters
    ----------
    near : the initial estimate is close to a minimum, so that the exact Hessian is tried at once
    watch : stopwatch that already timed the initialization
    """
    problem.check(initial)
    progress = Progress(monitor, settings.tolerance, settings.max_iterations, watch or Stopwatch())
    steps = _NewtonSteps(problem, settings, exact=near)
    end = minimise(_Model(problem, initial, steps.metric), steps, progress)
    estimate = problem.as_estimate(end.point.rotations, end.point.translations)
    return progress.solution(estimate, end.cost, counts=dict(steps.factors.counts))


def forcing_term(
    progress: float, loosest: float = DEFAULT.loosest, tightest: float = DEFAULT.tightest
) -> float:
    """The relative residual of a step after one that reduced F by the fraction ``progress``.

    F is quadratic in the distance, and Newton's method converges quadratically.
    """
    return min(loosest, max(tightest, math.sqrt(max(progress, 0.0))))


class _Model:
    """F and its quadratic model F + 2 g x + x H x at a point, of which translations are optimal."""

    def __init__(self, problem: Quadratic, point: Estimate, metric: FloatArray) -> None:
        self._problem, self._metric, self.point = problem, metric, point
        self.first = problem.first_order(point)
        self.cost, self.stationarity = self.first.cost, self.first.stationarity
        self.rounding = ROUNDING * self.cost

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of F."""
        return self._problem.tangent_layout.pack(self.first.tangent)

    @cached_property
    def hessian(self) -> CSC:
        """The exact Riemannian Hessian of F/2."""
        return self._matrix(self.first.multipliers)

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix: definite up to the gauge."""
        return self._matrix(np.zeros_like(self.first.multipliers))

    def _matrix(self, multipliers: FloatArray) -> CSC:
        diagonal, upper = self._problem.hessian(self.point, multipliers)
        anchor = self._problem.anchor
        diagonal[anchor] += np.diag(self._metric[anchor])  # fixes the gauge
        return self._problem.pattern.assemble(diagonal, upper, self._problem.d)

    def moved(self, x: FloatArray) -> _Model:
        """The model after a body-frame step."""
        return _Model(self._problem, _retract(self._problem, self.point, x), self._metric)


class _How(NamedTuple):
    """How a step was computed."""

    exact: bool
    damping: float = 0.0
    chord: Chord | None = None  # what it is, if it is one


class _NewtonSteps:
    """Steps with the old factor if it is still good, then with new ones, ever more damped."""

    phase, counts_failures = "newton", False

    def __init__(self, problem: Quadratic, settings: NewtonSettings, *, exact: bool) -> None:
        self.problem, self.settings = problem, settings
        self.least_gain = settings.min_gain
        self.metric = _metric(problem)
        self.factors = Factors(problem, settings.max_products, settings.single_from)
        self._exact = exact  # whether the last step used the exact Hessian
        self._progress = math.inf  # fraction by which it reduced F
        self._damping = 0.0
        self._chord: Chord | None = None  # the next step, if the last factor is still good
        self._how = _How(exact)
        self._proposals: Iterator[tuple[Proposal, _How]] | None = None

    def stationarity(self, here: _Model) -> float:
        """See `FirstOrder`."""
        return here.stationarity

    def has_converged(self, here: _Model, stationarity: float) -> bool:
        """Whether it is stationary, or the last factor promises too little."""
        chord, settings = self._chord, self.settings
        if stationarity <= settings.tolerance:
            return True
        return chord is not None and chord.predicted <= settings.enough * here.cost

    def propose(self, here: _Model) -> Proposal | None:
        """The next step from a point."""
        if self._proposals is None:
            self._proposals = self.proposals(here)
        proposal, self._how = next(self._proposals, (None, self._how))
        return proposal

    def accepted(self, here: _Model, there: _Model, gain: Gain) -> None:
        """Reduce the damping after a good step, and see what its factor suggests next."""
        (self._exact, damping, _), settings = self._how, self.settings
        if damping > 0.0:
            self.factors.drop()  # it is not of a Hessian
        if gain.ratio is not None and gain.ratio > settings.good_gain:
            damping /= 10.0
        kept = gain.ratio is not None and damping >= settings.smallest_damping
        self._damping = damping if kept else 0.0
        fallen = here.cost - there.cost
        self._progress = fallen / here.cost if here.cost > 0.0 else 0.0
        visible = None if gain.ratio is None else fallen
        self._chord = self.chord(there, gain.proposal.predicted, visible)
        self._proposals = None

    def rejected(self, here: _Model, proposal: Proposal) -> bool:
        """Nothing: the next proposal is more careful."""
        return True

    def chord(self, there: _Model, last: float, fallen: float | None) -> Chord | None:
        """The step that the last factor suggests, after one of an exact Hessian.

        F was to fall by ``last`` and has fallen by ``fallen``; None if that is within rounding.
        """
        exact, _, before = self._how
        if self.factors.last is None or not exact:
            return None
        direction = -self.factors.last.solve(there.gradient)
        decrease, curvature = float(-there.gradient @ direction), 1.0
        if before is not None and fallen is not None:
            curvature = before.curvature_for(fallen)
        return Chord(direction, decrease, last, curvature) if decrease > 0.0 else None

    def proposals(self, here: _Model) -> Iterator[tuple[Proposal, _How]]:
        """Steps with the old factor if it is still good, then with new ones, ever more damped."""
        settings, factors, chord = self.settings, self.factors, self._chord
        g, metric = here.gradient, self.problem.tangent_layout.pack(self.metric)
        slow, near = self._progress < settings.slow_decrease, here.stationarity < settings.near
        exact = self._exact or slow or near
        negligible = max(settings.enough, ROUNDING) * here.cost  # a decrease that may be left
        tol = forcing_term(self._model_error(negligible), settings.loosest, settings.tightest)
        if chord is not None and chord.count(negligible) <= max(CHORDS, factors.most / 2):
            yield Proposal(chord.step, chord.predicted, reused=True), _How(True, chord=chord)
        large = self.problem.n >= settings.large
        # Where its predictions do not fall, a gradient that is small in its norm means little.
        falling = chord is None or chord.rate < 1.0
        if (self._exact or large) and falling and factors.serve(tol):
            solved = factors.old(here.hessian if exact else here.gauss_newton, g, tol)
            if solved.end is End.CONVERGED:
                predicted = float(solved.x @ (solved.residual - g))
                yield Proposal(solved.x, predicted, reused=True), _How(exact)
            elif solved.end is End.NEGATIVE_CURVATURE:
                exact = exact and self._progress < settings.stagnation
        damping = self._damping
        while damping <= settings.largest_damping:
            H = here.hessian if exact else here.gauss_newton
            factors.drop()
            found = factors.new(H, g, damping * metric, tol)
            if found is not None:
                yield Proposal(*found), _How(exact, damping)
            elif exact and self._progress >= settings.stagnation:
                exact = False
                continue
            least = settings.first_damping if found is None else settings.second_damping
            damping = max(10.0 * damping, least)

    def _model_error(self, negligible: float) -> float:
        """The share of a step's gain that the quadratic model misses, or that need not be found."""
        if self._chord is None:
            return self._progress
        return max(4.0 * self._chord.rate, negligible / self._chord.decrease)


def _metric(problem: Quadratic) -> FloatArray:
    """(n, b) positive diagonal that measures steps: the uncoupled curvature of F."""
    p = so.tangent_dim(problem.d)
    turn = np.repeat(2.0 * problem.rotation.node_weights[:, None], p, axis=1)
    if not problem.has_positions:
        return turn
    spread = problem.lever_weights[:, None]
    move = np.repeat(problem.translation_weights[:, None], problem.d, axis=1)
    return np.concatenate([move, turn + spread], axis=1)


def _retract(problem: Quadratic, point: Estimate, step: FloatArray) -> Estimate:
    """The point after a body-frame step, with optimal translations."""
    steps = problem.tangent_layout.unpack(step)
    turns = steps[:, -so.tangent_dim(problem.d) :]
    turned = so.turned(point.rotations, turns)
    if point.translations is None or not problem.has_positions:
        return Estimate.trusted(turned)
    moves = steps[:, : problem.d]
    return problem.with_optimal_translations(Estimate.trusted(turned, point.translations + moves))
