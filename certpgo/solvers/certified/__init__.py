"""The certified pipeline: initialize, descend, certify; climb, round and polish where that fails.

Reading order: `pipeline` (what a caller asks for), `staircase` (the search), `disagreement` (which
measurements contradict the others) and `robust` (the pipeline without those).
"""

from certpgo.solvers.certified.pipeline import SOLVER, CertifiedSolution, solve
from certpgo.solvers.certified.robust import solve_robustly

__all__ = ["SOLVER", "CertifiedSolution", "solve", "solve_robustly"]
