"""The certified pipeline: initialize, optimize, certify; climb, round and polish if that fails.

Reading order: `pipeline` (the interface), `staircase` (the search), `disagreement` (finds outlying
measurements) and `robust` (the pipeline without these).
"""

from certpgo.solvers.certified.pipeline import SOLVER, CertifiedSolution, solve
from certpgo.solvers.certified.robust import solve_robustly

__all__ = ["SOLVER", "CertifiedSolution", "solve", "solve_robustly"]
