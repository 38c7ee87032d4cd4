"""Low-rank optimization: a Riemannian trust region on St(r, d)^n, translations eliminated."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.display import Brief
from certpgo.graph.relaxed_point import Lift, Point, lifted
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.cg import End, Truncated, conjugate_gradients
from certpgo.linalg.factor import Factor
from certpgo.linalg.rotations import orthonormal, tangent_basis
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.quadratic_model import ROUNDING
from certpgo.optimize.descent_loop import Gain, Proposal, minimise
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.riemannian_newton import DEFAULT, forcing_term
from certpgo.optimize.solution import Status

#: Actual over predicted decrease from which a step is accepted, below which the trust region
#: shrinks, and above which it grows.
ACCEPTED, POOR, GOOD = 0.01, 0.25, 0.75
#: Products allowed in conjugate gradients, and up to which the preconditioner is reused.
MAX_PRODUCTS, FEW_PRODUCTS = 100, 10
#: Shift of the preconditioner over the mean diagonal: the gauge group is larger than one pose, and
#: its rounding must stay below the smallest curvature.
SHIFT = 1e-8
#: Halvings of a step along a given direction.
MAX_HALVINGS = 40


@dataclass(frozen=True, eq=False, repr=False)
class Descent(Brief):
    """The result of low-rank optimization."""

    point: Lift
    cost: float
    status: Status
    trace: tuple[Iteration, ...]
    counts: dict[str, int]


def descend(
    problem: Quadratic,
    initial: Point,
    rank: int,
    *,
    direction: FloatArray | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 500,
    loosest: float = DEFAULT.loosest,
    tightest: float = DEFAULT.tightest,
    monitor: Monitor = silent,
    watch: Stopwatch | None = None,
) -> Descent:
    """Minimise F over St(rank, d)^n from ``initial``, by truncated Newton steps.

    Absil, Baker, Gallivan, "Trust-region methods on Riemannian manifolds" (2007). The
    preconditioner, and the metric of the trust region, is the Gauss-Newton matrix: steps are
    measured by how much they change the residuals.

    Parameters
    ----------
    initial : a point of at most that rank
    direction : (n, d) first step of the blocks into a new dimension, such as an eigenvector of the
        certificate matrix with a negative eigenvalue, the only descent direction at a stationary
        point of lower rank
    tolerance : stationarity (radians) at which to stop
    loosest, tightest : relative residuals of conjugate gradients, as in `NewtonSettings`
    watch : stopwatch that already timed the initialization
    """
    watch = watch or Stopwatch()
    progress = Progress(monitor, tolerance, max_iterations, watch)
    with watch.phase("low rank"):
        start = problem.with_optimal_translations(lifted(initial, rank))
        if direction is not None:
            start = leave(problem, start, direction)
        here = _Tangent(problem, start)
    steps = _TruncatedNewton(here, loosest, tightest)
    end = minimise(here, steps, progress)
    return Descent(end.point, end.cost, progress.status, tuple(progress.trace), dict(steps.counts))


class _TruncatedNewton:
    """Steps by conjugate gradients within a trust region, in the metric of an earlier point."""

    phase, least_gain, counts_failures = "low rank", ACCEPTED, True
    _solved: Truncated

    def __init__(self, start: _Tangent, loosest: float, tightest: float) -> None:
        self.counts: Counter[str] = Counter()
        self._forcing = loosest, tightest
        self._metric: Factor | None = None
        self._radius, self._gained = math.sqrt(abs(start.cost)), 1.0

    def stationarity(self, here: _Tangent) -> float:
        """The largest gradient over the curvature, radians."""
        return here.stationarity

    def has_converged(self, here: _Tangent, stationarity: float) -> None:
        """The tolerance decides."""

    def propose(self, here: _Tangent) -> Proposal:
        """A step within the trust region."""
        if self._metric is None:
            self._metric = here.metric()
            self.counts["factorizations"] += 1
        self._solved = solved = conjugate_gradients(
            here.hessian.__matmul__,
            -here.gradient,
            self._metric.solve,
            tol=forcing_term(self._gained, *self._forcing),
            max_iterations=MAX_PRODUCTS,
            radius=self._radius,
        )
        self.counts["products"] += solved.products
        return Proposal(solved.x, float(solved.x @ (solved.residual - here.gradient)))

    def accepted(self, here: _Tangent, there: _Tangent, gain: Gain) -> None:
        """Fit the trust region, and keep a metric that serves well."""
        ratio = 1.0 if gain.ratio is None else gain.ratio
        if not ratio >= POOR:
            self._radius *= 0.25
        elif ratio > GOOD and self._solved.end in (End.BOUNDARY, End.NEGATIVE_CURVATURE):
            self._radius *= 2.0
        self._gained = max(here.cost - there.cost, 0.0) / here.cost
        if self._solved.products > FEW_PRODUCTS:
            self._metric = None

    def rejected(self, here: _Tangent, proposal: Proposal) -> bool:
        """Shrink the trust region, until its steps are below rounding."""
        self._radius *= 0.25
        return not self._radius**2 < here.rounding


class _Tangent:
    """A point with its gradient, Hessian, metric and retraction.

    Steps are (n, r + q), translations first, or (n, q) for rotations alone: coordinates in an
    orthonormal basis of each block's tangent space.
    """

    def __init__(self, problem: Quadratic, point: Lift) -> None:
        self._problem = problem
        self.point = point
        self.cost = problem.cost(point)
        self.rounding = ROUNDING * self.cost
        Y = point.rotations
        G = problem.gradient(point)
        self._multipliers = operators.multipliers(G[:, :, -problem.d :], Y)
        self._basis = tangent_basis(Y)
        turn = np.einsum("nqrd,nrd->nq", self._basis, G[:, :, -problem.d :])
        size, poses = np.linalg.norm(turn, axis=1), problem.poses
        self.stationarity = float((size[poses] / problem.curvature[poses]).max())
        moves = [G[:, :, 0]] if problem.has_positions else []
        tangent = np.concatenate([*moves, turn], axis=1)
        self._layout = problem.pattern.layout(tangent.shape[1], Y.shape[1])
        self.gradient = self._layout.pack(tangent)

    @cached_property
    def hessian(self) -> CSC:
        """The Riemannian Hessian of F/2."""
        return self._matrix(self._multipliers)

    def metric(self) -> Factor:
        """The factor of the Gauss-Newton matrix, shifted."""
        matrix = self._matrix(np.zeros_like(self._multipliers))
        shifted = add_to_diagonal(matrix, SHIFT * float(matrix.diagonal().mean()))
        factor = self._problem.symbolic(shifted).factor(shifted)
        if factor is None:
            raise NumericalError("the Gauss-Newton matrix could not be factorized")
        return factor

    def _matrix(self, multipliers: FloatArray) -> CSC:
        blocks = operators.lifted_hessian(self._problem.graph, self._basis, multipliers)
        return self._problem.pattern.assemble(*blocks, self._basis.shape[2])

    def moved(self, x: FloatArray) -> _Tangent:
        """The nearest point of the manifold after a step, with optimal translations."""
        q = self._basis.shape[1]
        V = np.einsum("nq,nqrd->nrd", self._layout.unpack(x)[:, -q:], self._basis)
        return _Tangent(self._problem, _moved(self._problem, self.point, V))


def leave(problem: Quadratic, point: Lift, direction: FloatArray) -> Lift:
    """The point moved along its last, empty dimension as far as F decreases.

    Parameters
    ----------
    direction : (n, d) rows v_i; block i moves from [Y_i; 0] along the tangent [0; v_i]
    """
    V = np.zeros_like(point.rotations)
    V[:, -1, :] = direction / np.linalg.norm(direction, axis=1).max()

    def moved(step: float) -> Lift:
        return _moved(problem, point, step * V)

    lower = lowest_of_halvings(problem.cost, moved, 1.0, problem.cost(point))
    return point if lower is None else lower


def lowest_of_halvings(
    cost: Callable[[Lift], float], moved: Callable[[float], Lift], step: float, lowest: float
) -> Lift | None:
    """The end of the first step below cost ``lowest`` whose half is not lower still, if any."""
    best: Lift | None = None
    for _ in range(MAX_HALVINGS):
        candidate = moved(step)
        lower = cost(candidate)
        if lower < lowest:
            best, lowest = candidate, lower
        elif best is not None:
            break
        step *= 0.5
    return best


def _moved(problem: Quadratic, point: Lift, V: FloatArray) -> Lift:
    return problem.with_optimal_translations(
        Lift(orthonormal(point.rotations + V), point.translations)
    )
