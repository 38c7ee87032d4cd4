"""What a method returns, and what a method is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar, Protocol

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.problem import Problem
from certpgo.optimize.monitor import Iteration, Monitor, silent


class Status(Enum):
    """How a method ended; the estimate is its best point in every case.

    Attributes
    ----------
    CLOSED_FORM : the answer was computed at once, from eigenvectors or along a tree
    CONVERGED : to the tolerance asked
    STALLED : no further progress, and the tolerance not reached
    ITERATION_LIMIT, TIME_LIMIT : as they were set
    INTERRUPTED : a monitor, or Ctrl-C, said so

    Examples
    --------
    >>> from certpgo import Status
    >>> Status("time limit") is Status.TIME_LIMIT
    True
    """

    CLOSED_FORM = "closed form"
    CONVERGED = "converged"
    STALLED = "stalled"
    ITERATION_LIMIT = "iteration limit"
    INTERRUPTED = "interrupted"
    TIME_LIMIT = "time limit"


@dataclass(frozen=True, eq=False)
class Relaxation:
    """What a method found of the convex relaxation, beside the estimate rounded from it.

    The relaxation is min tr(L Y) over positive semidefinite Y (dn, dn) with identities as diagonal
    blocks, L the rotation connection Laplacian: Eriksson et al.'s (DD), eq. 45, in units of F. Its
    dual is (D), eq. 18: max tr(Lam) such that L - blkdiag(Lam) is positive semidefinite.

    Attributes
    ----------
    value : of the program at the point found, in units of F; no bound: the point is feasible up to
        the solver's tolerance only, and may be above F*; see ``lower_bound`` of the solution
    status : what the program's solver said
    multipliers : (n, d, d) Lam, or None
    rows : (n, r, d) blocks with Y_ij = rows_i^T rows_j, or None
    rank : numerical rank of Y, or of what is complementary to L - blkdiag(Lam)
    """

    value: float
    status: str
    multipliers: FloatArray | None = field(default=None, repr=False)
    rows: FloatArray | None = field(default=None, repr=False)
    rank: int | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """A method's answer.

    Attributes
    ----------
    estimate : its best point
    cost : F there, evaluated by the problem
    status : how the method ended
    iterations : steps taken
    lower_bound : a bound on F* that the method computed (not proven against rounding), or None
    seconds : wall-clock seconds by phase
    trace : one entry an iteration, where the method keeps them
    counts : deterministic counts of the work done, e.g. factorizations and products
    note : what a reader of the answer should know, e.g. which information a baseline used
    relaxation : of methods that solve the convex relaxation, what they found there
    weights : (m,) of robust methods, the factors on the edges' weights that they ended with; an
        edge at zero was rejected. What such a method proposes is an answer to the problem with
        these weights, see `judged`

    Examples
    --------
    >>> from certpgo import RotationProblem, get_solver
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("spanning_tree")().solve(problem)
    >>> solution.status.value, solution.lower_bound  # what a tree says of the whole: nothing
    ('closed form', None)
    >>> print(f"{solution.cost:.6f}")  # one edge bears it all: 8 sin^2(theta / 2)
    0.178654
    """

    estimate: Estimate
    cost: float
    status: Status
    iterations: int = 0
    lower_bound: float | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    trace: tuple[Iteration, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    note: str = ""
    relaxation: Relaxation | None = None
    weights: FloatArray | None = None

    @property
    def kept(self) -> int | None:
        """How many measurements a robust method kept; None for others."""
        return None if self.weights is None else int((self.weights > 0.0).sum())

    @property
    def rejected(self) -> IntArray:
        """(k,) which measurements a robust method rejected, ascending; none of other methods."""
        return np.flatnonzero([] if self.weights is None else self.weights == 0.0)

    def judged(self, problem: Problem) -> Problem:
        """The problem that the answer is to be judged by: with the weights the method ended with.

        A certificate for it says that no other answer fits the measurements that were kept better,
        not that the right ones were kept.
        """
        return problem if self.weights is None else problem.reweighted(self.weights)


class Solver(Protocol):
    """A method: a frozen dataclass of settings, validated at construction.

    Attributes
    ----------
    poses, rotations : which kinds of problem it takes
    """

    poses: ClassVar[bool]
    rotations: ClassVar[bool]

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Estimate the poses or rotations of the problem."""
        ...
