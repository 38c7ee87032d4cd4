"""What methods return, and their interface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Protocol, Self, TypeVar

import numpy as np

from certpgo.graph import Estimate, Instance
from certpgo.graph.display import Brief
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Iteration, Monitor, silent


class Reweighted(Protocol):
    """A problem whose measurements can be weighed again."""

    def reweighted(self, factors: FloatArray) -> Self:
        """The problem with weights times factors (m,); an edge with factor 0 is removed."""
        ...


AnyPosed = TypeVar("AnyPosed", bound=Reweighted)


class Status(StrEnum):
    """How a method ended; the estimate is its best point in every case.

    Attributes
    ----------
    CLOSED_FORM : not iterative: computed from eigenvectors or along a tree
    CONVERGED : to the requested tolerance
    STALLED : no further progress, without reaching the tolerance
    ITERATION_LIMIT, TIME_LIMIT : reached the limit that was set
    INTERRUPTED : by a monitor or Ctrl-C

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

    @property
    def is_early(self) -> bool:
        """Whether something other than the method ended it, so that more time may help."""
        return self in (Status.INTERRUPTED, Status.TIME_LIMIT)


@dataclass(frozen=True, eq=False, repr=False)
class Relaxation(Brief):
    """What a method found out about the convex relaxation, besides the rounded estimate.

    The relaxation is min tr(L Y) over positive semidefinite Y (dn, dn) with identities as diagonal
    blocks, L the rotation connection Laplacian: Eriksson et al.'s (DD), eq. 45, in units of F. Its
    dual is (D), eq. 18: max tr(Lam) such that L - blkdiag(Lam) is positive semidefinite.

    Attributes
    ----------
    value : of the program at the point found, in units of F; not a bound, as the point is feasible
        only up to the solver's tolerance; see ``lower_bound`` of the solution
    status : as the program's solver reported it
    multipliers : (n, d, d) Lam, or None
    rows : (n, r, d) blocks with Y_ij = rows_i^T rows_j, or None
    rank : numerical rank of Y, or of the complement of L - blkdiag(Lam)
    """

    value: float
    status: str
    multipliers: FloatArray | None = field(default=None, repr=False)
    rows: FloatArray | None = field(default=None, repr=False)
    rank: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Brief):
    """What a method returns.

    Attributes
    ----------
    estimate : its best point
    cost : F there
    status : how the method ended
    iterations : steps taken
    lower_bound : a bound on F* that the method computed (not proven against rounding), or None
    seconds : wall-clock seconds by phase
    trace : one entry per iteration, if the method records them
    counts : deterministic counts of work, e.g. factorizations and products
    note : what a reader should know, e.g. which information a baseline used
    relaxation : for methods that solve the convex relaxation
    weights : (m,) for robust methods, the final factors on the edges' weights; an edge at zero was
        rejected. The estimate is for the problem with these weights, see `judged`

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("spanning_tree")().solve(problem)
    >>> solution.status.value, solution.lower_bound
    ('closed form', None)
    >>> print(f"{solution.cost:.6f}")  # all on one edge: 8 sin^2(theta / 2)
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
        """Number of measurements that a robust method kept; None for others."""
        return None if self.weights is None else int((self.weights > 0.0).sum())

    @property
    def rejected(self) -> IntArray:
        """(k,) measurements that a robust method rejected, ascending; empty for others."""
        return np.flatnonzero([] if self.weights is None else self.weights == 0.0)

    def judged(self, problem: AnyPosed) -> AnyPosed:
        """The problem that the estimate solves, with the method's final weights.

        A certificate for it says that no estimate fits the kept measurements better, not that the
        right ones were kept. The problem may have the cost of another program.
        """
        return problem if self.weights is None else problem.reweighted(self.weights)

    def judged_instance(self, instance: Instance) -> Instance:
        """The measurements of an instance that the problem is of, see `judged`."""
        return instance if self.weights is None else instance.with_edges(self.weights != 0.0)


class Solver(Protocol):
    """A method: a frozen dataclass of settings, validated at construction.

    Attributes
    ----------
    poses, rotations : which kinds of problem it accepts
    takes_initial : whether it uses an initial estimate; optional, True by default
    own_costs : names of the costs of other programs that it minimises if the problem has one, see
        `certpgo.objective.choose_cost`; optional, none by default
    compiled : whether it runs in compiled code, which Ctrl-C can only end together with the
        process; optional, False by default
    """

    poses: ClassVar[bool]
    rotations: ClassVar[bool]

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Estimate the poses or rotations of the problem."""
        ...


@dataclass(frozen=True, eq=False)
class Level:
    """One step of the staircase.

    Attributes
    ----------
    rank : rank of the points
    cost : F at the point found
    status : how the descent to it ended
    eigenvalue : a negative eigenvalue of the certificate matrix there, if one was found
    """

    rank: int
    cost: float
    status: Status
    eigenvalue: float | None = None
