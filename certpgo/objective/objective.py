"""What estimators minimise and certificates are about: a cost of the estimates of one graph."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.display import Speaking
from certpgo.graph.relaxed_point import Point, rounded
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.minorants import Minorants


@dataclass(frozen=True, eq=False)
class Surrogate:
    """A problem whose cost plus a constant is nowhere above a given cost.

    Attributes
    ----------
    problem : a quadratic one, or one with distances, whose cost has a value at points of any rank
    constant : rounded down
    minorants : those of all measurements, of which some may not exist; None where the problem is
        the given one
    """

    problem: Any
    constant: float = 0.0
    minorants: Minorants | None = None

    def at(self, point: Point) -> Iterator[tuple[Any, float]]:
        """Quadratic problems with their constants, each for where those before have no bound.

        The first touches the cost of the surrogate at the point, which may have any rank.
        """
        for below, constant in self.problem.tangents(point):
            both = constant + self.constant
            exact = 0.0 in (constant, self.constant)
            yield below, both if exact else math.nextafter(both, -math.inf)


class Objective(Speaking, ABC):
    """The base of all costs.

    Subclasses say how a cost is evaluated and bounded; what differs between them in descents and
    certificates are the values below.
    """

    if TYPE_CHECKING:

        @property
        def graph(self) -> Any:
            """The graph with an edge for each measurement."""

        @property
        def measured(self) -> Any:
            """The measurements."""

        @property
        def engine(self) -> str:
            """The factorization engine."""

    #: The cost's name in options.
    cost_name: Any = "chordal"
    #: Whether it is F, of which the objective's own matrix is.
    is_chordal: ClassVar[bool] = False
    #: A robust kernel of the measurements' costs, if there is one.
    kernel: Any = None
    #: Whether its bound is that of a point above this space.
    is_lifted: Any = False
    #: Whether scales of nodes may be unknown.
    takes_scales: ClassVar[bool] = False
    #: Steps of a descent, and the stationarity at which one that begins near its end may stop.
    most_steps: Any = 600
    polished: ClassVar[float] = 1e-8
    #: Ranks above d that the relaxation is climbed to.
    most_ranks: Any = 7

    @property
    def _headline(self) -> str:
        return f"{type(self).__name__}: {self.graph.size_in_words}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield "cost", self.title
        yield "next", "certpgo.solve(problem); certpgo.certify(problem, estimate)"

    def _picture(self) -> str:
        return str(self.graph._picture())

    @property
    @abstractmethod
    def title(self) -> str:
        """What the cost is."""

    @property
    @abstractmethod
    def chordal(self) -> Any:
        """The problem of the same edges under F."""

    @property
    def isotropic(self) -> Any:
        """The problem of the same measurements under F, without those that it has no terms for.

        Raises
        ------
        GraphError
            The others do not connect the graph.
        """
        return self.chordal

    @property
    def n(self) -> int:
        """Number of nodes."""
        return int(self.measured.num_nodes)

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.measured.d)

    @property
    def has_positions(self) -> bool:
        """Whether nodes have positions."""
        return bool(self.measured.has_positions)

    @property
    @abstractmethod
    def scale(self) -> float:
        """W, the scale of the cost in absolute tolerances."""

    @property
    @abstractmethod
    def unprovable(self) -> str:
        """Why there are no proofs of the cost; empty if there are."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """The same measurements with all weights times ``factor``."""

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph by an InputError."""
        self.chordal.check(estimate)

    @abstractmethod
    def edge_costs(self, point: Any) -> FloatArray:
        """(m,) terms of the cost, one for each measurement."""

    def cost(self, point: Any) -> float:
        """The cost of an estimate, or of a point of any rank where it has one."""
        return float(self.edge_costs(point).sum())

    @abstractmethod
    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on the cost, whose translations are taken as stored."""

    @abstractmethod
    def stationarity(self, estimate: Estimate) -> float:
        """Distance from stationarity, radians."""

    @property
    @abstractmethod
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each row measures of a rotation, and (m,) of anything else."""

    @property
    @abstractmethod
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts in the cost."""

    @property
    def form(self) -> Any:
        """The measurements, as edges between `blocks` where scales are unknown."""
        return self.measured

    def blocks(self, point: Any) -> Any:
        """A point of the relaxation: the same, unless scales are unknown."""
        return point

    def residual_angles(self, estimate: Estimate) -> FloatArray:
        """(m,) angles between R_i R_ij and R_j, radians; 0 where no rotation is measured."""
        return np.asarray(self.chordal.residual_angles(estimate))

    @property
    def unbounded(self) -> str:
        """Why costs of measurements have no lower bound, in a sentence; empty if they have."""
        return ""

    # --- Descents ---------------------------------------------------------------------------------

    @property
    def eliminates(self) -> bool:
        """Whether translations are best for rotations where their equations are solved."""
        return False

    @property
    def climbs(self) -> bool:
        """Whether there are descents at points of higher rank."""
        return self.eliminates

    def settled(self, estimate: Estimate) -> Estimate:
        """The estimate where bounds are computed: with its best translations, if that is easy."""
        return estimate

    def estimate_of(self, point: Any) -> Estimate:
        """The nearest estimate to the end of a descent: rounding would widen the enclosure."""
        return Estimate(so.project(point.rotations), point.translations)

    def nearest_estimates(self, point: Any) -> Iterator[Estimate]:
        """Estimates near a point of higher rank, from which descents begin."""
        yield rounded(point)

    # --- Rejected measurements --------------------------------------------------------------------

    #: The largest gap that says anything, where prices limit that.
    cap: Any = math.inf

    @property
    def rejected(self) -> IntArray:
        """(k,) indices of the measurements whose costs are truncated: none, of most costs."""
        return np.zeros(0, dtype=np.intp)

    @property
    def kept(self) -> Objective:
        """The problem of the other measurements."""
        return self

    # --- Bounds -----------------------------------------------------------------------------------

    @abstractmethod
    def surrogate(self, point: Point) -> Surrogate:
        """The quadratic objective and the constant below the cost that touch it at a point."""

    def surrogate_of(self, minorants: Minorants) -> Surrogate:
        """The surrogate of minorants of all measurements, of costs that are not their own."""
        raise NotImplementedError

    def relaxed(self) -> Self | None:
        """A cost that is nowhere above this one and easier to bound; None if none is known."""
        return None

    def without_minorants(self, estimate: Estimate) -> IntArray:
        """(k,) indices of the measurements that have no minorant at an estimate."""
        return np.zeros(0, dtype=np.intp)


def cost_upper(problem: Objective, estimate: Estimate) -> float:
    """An upper bound on the cost of the estimate, whose translations are taken as stored."""
    return problem.enclosure(estimate)[1]
