"""(D), the dual semidefinite program: Eriksson et al., eq. 18."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from certpgo.optimize.methods._relaxed import Scaled
from certpgo.optimize.methods._sdp import ConicSolution, Posed, Semidefinite


@dataclass(frozen=True)
class DualSDP(Semidefinite):
    """(D): max tr(Lam) such that L - blkdiag(Lam) is positive semidefinite.

    Lam has 6n scalars in 3D, 3n in 2D. The settings are those of `Semidefinite`.

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("sdp_dual")().solve(problem)
    >>> bool(abs(solution.lower_bound - solution.cost) < 1e-6)  # strong duality, numerically
    True
    """

    decomposable: ClassVar[bool] = True

    def library(self) -> Any:
        """CVXPY."""
        import cvxpy

        return cvxpy

    def pose(self, cp: Any, data: Scaled) -> Posed:
        """Maximise sum_i share_i tr(Lam_i) subject to A - blkdiag(Lam) >= 0."""
        n, d = data.problem.n, data.problem.d
        N, (a, b) = d * n, np.triu_indices(d)
        entries = cp.Variable(n * len(a))
        row, column = ((d * np.arange(n)[:, None] + index).ravel() for index in (a, b))
        which, off = np.arange(len(row)), row != column
        places = np.concatenate([row + N * column, (column + N * row)[off]])
        spread = sparse.csc_array(
            (np.ones(len(places)), (places, np.concatenate([which, which[off]]))),
            shape=(N * N, len(row)),
        )
        blocks = cp.reshape(spread @ entries, (N, N), order="F")
        positive = cp.Constant(data.matrix) - blocks >> 0
        traces = np.outer(data.shares, a == b).ravel()
        problem = cp.Problem(cp.Maximize(traces @ entries), [positive])

        def read() -> ConicSolution:
            multipliers = np.empty((n, d, d))
            multipliers[:, a, b] = multipliers[:, b, a] = entries.value.reshape(n, -1)
            return ConicSolution(multipliers, positive.dual_value)

        return Posed(problem, read)

    def scalars(self, n: int, d: int) -> int:
        """The scalars of Lam."""
        return n * d * (d + 1) // 2


SOLVER = DualSDP
