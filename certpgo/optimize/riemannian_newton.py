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

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.cg import End
from certpgo.objective.base import FirstOrder
from certpgo.objective.problem import Problem
from certpgo.objective.quadratic_model import ROUNDING
from certpgo.optimize.chord_method import Chord
from certpgo.optimize.factors import Factors
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution, Status

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
    problem: Problem,
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
    watch = watch or Stopwatch()
    descent = _Descent(problem, settings)
    state = _State(initial, problem.first_order(initial), exact=near)
    progress = Progress(monitor, settings.tolerance, settings.max_iterations, watch)
    while progress.advance(
        state.cost,
        state.stationarity,
        state.step_norm,
        gain=state.gain,
        converged=_has_converged(state, settings),
    ):
        with watch.phase("newton"):
            following = descent.advance(state)
        if following is None:
            progress.status = Status.STALLED
            break
        state = following
    estimate = Estimate(state.point.rotations, state.point.translations)
    return progress.solution(estimate, state.cost, counts=dict(descent.factors.counts))


def _has_converged(state: _State, settings: NewtonSettings) -> bool:
    if state.stationarity <= settings.tolerance:
        return True
    return state.chord is not None and state.chord.predicted <= settings.enough * state.cost


def forcing_term(
    progress: float, loosest: float = DEFAULT.loosest, tightest: float = DEFAULT.tightest
) -> float:
    """The relative residual of a step after one that reduced F by the fraction ``progress``.

    F is quadratic in the distance, and Newton's method converges quadratically.
    """
    return min(loosest, max(tightest, math.sqrt(max(progress, 0.0))))


@dataclass(frozen=True, eq=False)
class _State:
    """An iterate, and what the next step can use."""

    point: Estimate
    first: FirstOrder
    step_norm: float = 0.0
    gain: float | None = None  # actual over predicted decrease of the last step
    exact: bool = False  # whether the last step used the exact Hessian
    progress: float = np.inf  # fraction by which it reduced F
    damping: float = 0.0
    chord: Chord | None = None  # the next step, if the last factor is still good

    @property
    def cost(self) -> float:
        return self.first.cost

    @property
    def stationarity(self) -> float:
        return self.first.stationarity


class _Model:
    """The quadratic model F(point) + 2 g x + x H x."""

    def __init__(self, problem: Problem, state: _State, metric: FloatArray) -> None:
        self._problem, self._state, self._metric = problem, state, metric
        self.g = problem.tangent_layout.pack(state.first.tangent)

    @cached_property
    def hessian(self) -> CSC:
        """The exact Riemannian Hessian of F/2."""
        return self._matrix(self._state.first.multipliers)

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix: definite up to the gauge."""
        return self._matrix(np.zeros_like(self._state.first.multipliers))

    def _matrix(self, multipliers: FloatArray) -> CSC:
        diagonal, upper = self._problem.hessian(self._state.point, multipliers)
        anchor = self._problem.anchor
        diagonal[anchor] += np.diag(self._metric[anchor])  # fixes the gauge
        return self._problem.pattern.assemble(diagonal, upper, self._problem.d)


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A step (N,), its predicted decrease of F, and how it was computed."""

    step: FloatArray
    predicted: float
    exact: bool
    damping: float
    reused: bool = False  # whether with the factor of an earlier step
    chord: Chord | None = None  # what it is, if it is one


class _Descent:
    """Steps from one point to the next, and the factors that they share."""

    def __init__(self, problem: Problem, settings: NewtonSettings) -> None:
        self.problem, self.settings = problem, settings
        self.metric = _metric(problem)
        self.factors = Factors(problem, settings.max_products, settings.single_from)

    def advance(self, state: _State) -> _State | None:
        """The next point; None if no step improves this one."""
        settings = self.settings
        for proposal in self.proposals(state):
            if not np.isfinite(proposal.step).all():
                continue
            candidate = _retract(self.problem, state.point, proposal.step)
            first = self.problem.first_order(candidate)
            fallen = state.cost - first.cost
            gain = fallen / proposal.predicted if proposal.predicted > 0.0 else 0.0
            # The decrease is below rounding of F; the gradient still shows progress.
            invisible = proposal.predicted <= ROUNDING * state.cost
            if not invisible and not gain > settings.min_gain:
                continue
            damping = proposal.damping / 10.0 if gain > settings.good_gain else proposal.damping
            risen = not first.cost <= (1.0 + 2.0 * ROUNDING) * state.cost
            if invisible and (risen or not first.stationarity < state.stationarity):
                if proposal.reused:
                    continue
                return None
            if proposal.damping > 0.0:
                self.factors.drop()  # it is not of a Hessian
            return _State(
                candidate,
                first,
                step_norm=float(np.linalg.norm(proposal.step)),
                gain=None if invisible else gain,
                exact=proposal.exact,
                progress=fallen / state.cost if state.cost > 0.0 else 0.0,
                damping=damping if damping >= settings.smallest_damping and not invisible else 0.0,
                chord=self.chord(first, proposal, None if invisible else fallen),
            )
        return None

    def chord(self, first: FirstOrder, last: _Proposal, fallen: float | None) -> Chord | None:
        """The step that the last factor suggests, after one of an exact Hessian.

        F has fallen by ``fallen``; None if that is within rounding.
        """
        if self.factors.last is None or not last.exact:
            return None
        g = self.problem.tangent_layout.pack(first.tangent)
        direction = -self.factors.last.solve(g)
        decrease, curvature = float(-g @ direction), 1.0
        if last.chord is not None and fallen is not None:
            curvature = last.chord.curvature_for(fallen)
        return Chord(direction, decrease, last.predicted, curvature) if decrease > 0.0 else None

    def proposals(self, state: _State) -> Iterator[_Proposal]:
        """Steps with the old factor if it is still good, then with new ones, ever more damped."""
        settings, factors = self.settings, self.factors
        model = _Model(self.problem, state, self.metric)
        g, metric = model.g, self.problem.tangent_layout.pack(self.metric)
        slow, near = state.progress < settings.slow_decrease, state.stationarity < settings.near
        exact = state.exact or slow or near
        tol = forcing_term(_model_error(state, settings), settings.loosest, settings.tightest)
        chord, negligible = state.chord, _negligible(state, settings)
        if chord is not None and chord.count(negligible) <= max(CHORDS, factors.most / 2):
            yield _Proposal(chord.step, chord.predicted, True, 0.0, reused=True, chord=chord)
        large = self.problem.n >= settings.large
        # Where its predictions do not fall, a gradient that is small in its norm means little.
        falling = chord is None or chord.rate < 1.0
        if (state.exact or large) and falling and factors.serve(tol):
            solved = factors.old(model.hessian if exact else model.gauss_newton, g, tol)
            if solved.end is End.CONVERGED:
                predicted = float(solved.x @ (solved.residual - g))
                yield _Proposal(solved.x, predicted, exact, 0.0, reused=True)
            elif solved.end is End.NEGATIVE_CURVATURE:
                exact = exact and state.progress < settings.stagnation
        damping = state.damping
        while damping <= settings.largest_damping:
            H = model.hessian if exact else model.gauss_newton
            factors.drop()
            proposal = factors.new(H, g, damping * metric, tol)
            if proposal is not None:
                yield _Proposal(*proposal, exact, damping)
            elif exact and state.progress >= settings.stagnation:
                exact = False
                continue
            least = settings.first_damping if proposal is None else settings.second_damping
            damping = max(10.0 * damping, least)


def _model_error(state: _State, settings: NewtonSettings) -> float:
    """The fraction of a step's gain that the quadratic model misses, or that need not be found."""
    if state.chord is None:
        return state.progress
    return max(4.0 * state.chord.rate, _negligible(state, settings) / state.chord.decrease)


def _negligible(state: _State, settings: NewtonSettings) -> float:
    """A decrease of F that may be left."""
    return max(settings.enough, ROUNDING) * state.cost


def _metric(problem: Problem) -> FloatArray:
    """(n, b) positive diagonal that measures steps: the uncoupled curvature of F."""
    p = so.tangent_dim(problem.d)
    turn = np.repeat(2.0 * problem.rotation.node_weights[:, None], p, axis=1)
    if not problem.has_positions:
        return turn
    spread = problem.lever_weights[:, None]
    move = np.repeat(problem.translation_weights[:, None], problem.d, axis=1)
    return np.concatenate([move, turn + spread], axis=1)


def _retract(problem: Problem, point: Estimate, step: FloatArray) -> Estimate:
    """The point after a body-frame step, with optimal translations."""
    steps = problem.tangent_layout.unpack(step)
    turns = steps[:, -so.tangent_dim(problem.d) :]
    turned = so.turned(point.rotations, turns)
    if point.translations is None or not problem.has_positions:
        return Estimate.trusted(turned)
    moves = steps[:, : problem.d]
    return problem.with_optimal_translations(Estimate.trusted(turned, point.translations + moves))
