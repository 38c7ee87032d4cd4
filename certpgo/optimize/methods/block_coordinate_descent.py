"""Eriksson et al.'s block coordinate descent on the semidefinite relaxation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods._coordinates import Sweeping, stacked
from certpgo.optimize.methods._relaxed import remark_on
from certpgo.optimize.monitor import Iteration, Monitor, Stopwatch, silent
from certpgo.optimize.solution import Relaxation, Solution, Status

#: The gap is checked once a sweep gains less than this many tolerances, then less and less often.
CHECK_BELOW, SPACING = 10.0, 1.25
#: Rounding of F, over the problem's scale.
ROUNDING = 1e-12
#: Maximal number of entries of X for descent from Y = I.
LARGEST = 4e8
#: Singular values of X, over the largest, that count for the rank.
RANK = 1e-4


@dataclass(frozen=True)
class BlockCoordinateDescent(Sweeping):
    """Algorithm 1 of Eriksson et al. 2018 for (DD), eq. 45, from Y = I.

    Each step minimises over one block row and column of Y in closed form (Lemma 5.1). The lemma
    minimises tr(W^T S) and (DD) minimises -tr(Rtilde Y), hence W is the block column of -Rtilde;
    the algorithm as printed has +Rtilde and the row, and would maximise. Y is stored as X X^T, and
    a step costs O(n) per neighbour. From an initial estimate R, X = R^T, the descent stays at
    rank d and on rotations, as in `rotation_coordinate_descent`.

    It stops when the duality gap of the relaxation is within the tolerance: with the multipliers
    Lam of the current Y, L - blkdiag(Lam) + shift I has a Cholesky factor, so that
    F* >= F(Y) - d n shift. The estimate is the rounded Y.

    Attributes
    ----------
    tolerance : of the duality gap, relative to F
    max_iterations : sweeps
    order : ``"colors"``, ``"cyclic"`` or ``"random"``; see `Coordinates`
    seed : of random orders

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("block_coordinate_descent")(tolerance=1e-6).solve(problem)
    >>> solution.cost - solution.lower_bound <= 1e-6 * solution.cost
    True
    """

    tolerance: float = 1e-6
    max_iterations: int = 10_000

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The rounded optimum of the relaxation, with optimal translations.

        Raises
        ------
        SpecError
            The graph is too large for a dense Y.
        """
        watch, rotation = Stopwatch(), problem.rotation
        if initial is not None:
            problem.check(initial)
        with watch.phase("start"):
            rows = _identity(rotation) if initial is None else stacked(initial)
            point = self.coordinates(rotation, rows)
        trace: list[Iteration] = []
        status, bound, next_check = Status.ITERATION_LIMIT, None, 0
        cost, _ = point.evaluate()
        for sweep in range(1, self.max_iterations + 1):
            with watch.phase("sweeps"):
                decrease, moved = point.sweep()
                cost -= decrease
                if sweep & (sweep - 1) == 0 and sweep >= 8:
                    point.compress()
            trace.append(Iteration(sweep, cost, moved, moved, watch.total))
            if monitor(trace[-1]):
                status = Status.INTERRUPTED
                break
            allowed = self.tolerance * abs(cost) + ROUNDING * rotation.scale
            if decrease > CHECK_BELOW * allowed or sweep < next_check:
                continue
            next_check = int(SPACING * sweep) + 1
            with watch.phase("duality gap"):
                cost, Lam = point.evaluate()
                allowed = self.tolerance * cost + ROUNDING * rotation.scale
                if point.is_definite(Lam, allowed / (problem.d * problem.n)):
                    status, bound = Status.CONVERGED, cost - allowed
                    break
            if decrease <= 0.0 and moved < 1e-12:
                status = Status.STALLED
                break
        with watch.phase("rounding"):
            cost, Lam = point.evaluate()
            blocks = point.blocks
            estimate = problem.complete(rounded(Lift(blocks)).rotations)
        gap = f"duality gap {'within' if bound is not None else 'not within'} {self.tolerance:.0e}"
        relaxation = Relaxation(cost, gap, Lam, blocks, _rank(blocks))
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=status,
            iterations=len(trace),
            lower_bound=None if bound is None else max(bound, 0.0),
            seconds=watch.seconds,
            trace=tuple(trace),
            note=remark_on(problem, relaxation),
            relaxation=relaxation,
        )


def _identity(problem: Quadratic) -> FloatArray:
    size = problem.n * problem.d
    if float(size) ** 2 > LARGEST:
        raise SpecError(
            f"a dense Y of {size} x {size} does not fit: use rotation_coordinate_descent, or an "
            "initial estimate, to stay at rank d"
        )
    return np.eye(size)


def _rank(blocks: FloatArray) -> int:
    gram = np.einsum("nra,nsa->rs", blocks, blocks, optimize=True)
    values = np.linalg.eigvalsh(gram)
    return int(np.sum(values > RANK**2 * values[-1]))


SOLVER = BlockCoordinateDescent
