"""(DD), the primal semidefinite program: Eriksson et al., eq. 45."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from certpgo.optimize.methods._relaxed import Scaled
from certpgo.optimize.methods._sdp import ConicSolution, Posed, Semidefinite


@dataclass(frozen=True)
class PrimalSDP(Semidefinite):
    """(DD): min tr(L Y) over positive semidefinite Y with identities as diagonal blocks.

    Y has (dn)(dn + 1)/2 scalars: (D) is cheaper. The settings are those of `Semidefinite`.

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("sdp_primal")().solve(problem)
    >>> solution.relaxation.rank  # d: the relaxation is tight
    3
    """

    decomposable: ClassVar[bool] = False

    def library(self) -> Any:
        """CVXPY."""
        import cvxpy

        return cvxpy

    def pose(self, cp: Any, data: Scaled) -> Posed:
        """Minimise tr(A Y) subject to Y_ii = share_i I and Y >= 0."""
        n, d = data.problem.n, data.problem.d
        N, (a, b) = d * n, np.triu_indices(d)
        Y = cp.Variable((N, N), PSD=True)
        flat = cp.reshape(Y, (N * N,), order="F")
        row, column = ((d * np.arange(n)[:, None] + index).ravel() for index in (a, b))
        chosen = sparse.csr_array(
            (np.ones(len(row)), (np.arange(len(row)), row + N * column)), shape=(len(row), N * N)
        )
        fixed = chosen @ flat == np.outer(data.shares, a == b).ravel()
        A = data.matrix.tocoo()
        places = A.row + N * A.col.astype(np.int64)
        weigh = sparse.csr_array((A.data, (np.zeros(A.nnz, int), places)), shape=(1, N * N))
        problem = cp.Problem(cp.Minimize(cp.sum(weigh @ flat)), [fixed])

        def read() -> ConicSolution:
            if fixed.dual_value is None:
                return ConicSolution(None, Y.value)
            # Off the diagonal, the constraint has one entry of each symmetric pair.
            prices = -fixed.dual_value.reshape(n, -1) * np.where(a == b, 1.0, 0.5)
            multipliers = np.empty((n, d, d))
            multipliers[:, a, b] = multipliers[:, b, a] = prices
            return ConicSolution(multipliers, Y.value)

        return Posed(problem, read)

    def scalars(self, n: int, d: int) -> int:
        """The scalars of Y."""
        return n * d * (n * d + 1) // 2


SOLVER = PrimalSDP
