"""The certified pipeline: initialize, optimize, certify; climb, round and polish if that fails.

Reading order: `interface`, `search`, `loop` (the search), `staircase`, `surrogates` and `ranged`
(its relaxations), `disagreement` (finds outlying measurements) and `robust` (the search without
these).
"""

from certpgo.solvers.certified.interface import SOLVER, solve
from certpgo.solvers.certified.result import CertifiedSolution
from certpgo.solvers.certified.robust import solve_robustly

__all__ = ["SOLVER", "CertifiedSolution", "solve", "solve_robustly"]
