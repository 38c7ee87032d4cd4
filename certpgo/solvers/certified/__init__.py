"""The certified pipeline: initialize, optimize, certify; climb, round and polish if that fails.

Reading order: `interface`, `pipeline`, `staircase` (the search), `own_cost` (the search in the cost
of another program), `disagreement` (finds outlying measurements) and `robust` (the pipeline without
these).
"""

from certpgo.solvers.certified.interface import SOLVER, solve
from certpgo.solvers.certified.result import CertifiedSolution
from certpgo.solvers.certified.robust import solve_robustly

__all__ = ["SOLVER", "CertifiedSolution", "solve", "solve_robustly"]
