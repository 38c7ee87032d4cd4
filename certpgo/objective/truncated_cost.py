"""The truncated cost: f_T = sum_K f_e + sum_O min(f_e, c_e), of kept and of rejected measurements.

Its minimum is over all poses and all choices of which rejected measurements to take back, each of
which costs its price c_e as long as it is left out. Its minorants are in
`certpgo.objective.truncated`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from certpgo.errors import InputError, refuse, require, require_numbers
from certpgo.graph import Estimate, Graph
from certpgo.graph.capabilities import lacking
from certpgo.graph.concatenate import by_rows
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats
from certpgo.linalg.ball_arithmetic import U
from certpgo.objective.chi_squared import flagged_from, quantiles
from certpgo.objective.costs import CHORDAL
from certpgo.objective.minorants import Minorants
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.truncated import Truncation

#: Share of the smallest price that a tolerated gap may be; a larger one says nothing about choices.
OF_PRICE = 0.01
#: Relative difference of costs that are computed in two ways.
SAME = 1e-12


class UncertifiableError(InputError):
    """Measurements whose truncated costs have no certificate: with matrix weights, for instance."""


@dataclass(frozen=True, eq=False, repr=False)
class TruncatedCost(Objective):
    """Minimise the cost of kept measurements and the truncated costs of rejected ones.

    Attributes
    ----------
    whole : the problem of all m measurements: under F with isotropic weights, or under the cost of
        another program
    prices : (m,) what a rejected measurement costs at most, in units of the cost; infinite for kept
        ones

    Raises
    ------
    GraphError
        The kept measurements do not connect the graph, or leave a node free.
    InputError
        Prices that are not positive.
    UncertifiableError
        Edges with matrix weights, or the cost of a program below which no isotropic cost is known.

    Examples
    --------
    A triangle measured twice, and once more by an edge that is wrong by a quarter turn:

    >>> import numpy as np
    >>> from certpgo import Estimate, RotationGraph, Quadratic, certify
    >>> from certpgo.objective.truncated_cost import TruncatedCost
    >>> R = np.tile(np.eye(2), (7, 1, 1))
    >>> R[-1] = [[0.0, -1.0], [1.0, 0.0]]
    >>> edges = np.array([(0, 1), (1, 2), (2, 0)] * 2 + [(0, 1)])
    >>> whole = Quadratic(RotationGraph(3, edges, R, kappa=np.full(7, 100.0)))
    >>> rejecting = TruncatedCost(whole, np.r_[np.full(6, np.inf), 20.0])
    >>> certificate = certify(rejecting, Estimate(np.tile(np.eye(2), (3, 1, 1))))
    >>> print(f"{certificate.verdict}, {certificate.cost_upper:.3f}")
    CERTIFIED, 20.000
    """

    whole: Quadratic | Sum
    prices: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "prices", frozen_floats(self.prices))
        if self.prices.shape != (self.whole.graph.num_edges,) or not (self.prices > 0.0).all():
            raise InputError(
                f"prices must be {self.whole.graph.num_edges} positive numbers, one per edge"
            )
        if self.whole.kernel is not None:
            raise UncertifiableError(f"measurements are not rejected of {self.whole.title}")
        _, *of_blocks = by_rows(self.measured, self.is_rejected)
        for block, cut in zip(self.measured.blocks, of_blocks, strict=True):
            if cut.any():
                raise UncertifiableError(f"rejections of {block.kind.plural} are not certified")
        if said := lacking(self.graph, "rejections"):
            raise UncertifiableError(said)
        refuse(self.whole.unbounded)
        if not self.is_rejected.any():
            raise InputError("no measurement is rejected: all prices are infinite")
        if self.is_rejected.all():
            raise InputError("all measurements are rejected: none is kept")
        _ = self.kept, self.below  # refuse what is not determined, or not known

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield "cost", self.title
        yield "next", "certpgo.certify(problem, estimate)"

    @cached_property
    def is_rejected(self) -> BoolArray:
        """(m,) which measurements have a price."""
        return np.isfinite(self.prices)

    @property
    def rejected(self) -> IntArray:
        """(k,) indices of the rejected measurements."""
        return np.flatnonzero(self.is_rejected)

    @cached_property
    def kept(self) -> Quadratic | Sum:
        """The problem of the kept measurements."""
        return self.whole.reweighted(np.where(self.is_rejected, 0.0, 1.0))

    @cached_property
    def below(self) -> Graph:
        """The rejected measurements, with terms of F that are their costs or nowhere above them."""
        found = self.whole.isotropic_below(self.is_rejected[: self.measured.num_edges])
        if found is None:
            said = f"no isotropic cost is known to be below {self.whole.title}"
            raise UncertifiableError(f"{said} (--cost chordal takes rejections)")
        return found

    def counted(self, estimate: Estimate) -> BoolArray:
        """(m,) the measurements whose terms are not truncated: all kept ones, for instance."""
        return np.asarray((self.terms(estimate) < self.prices) | ~self.is_rejected)

    def counting(self, counted: BoolArray) -> Quadratic | Sum:
        """The problem of some measurements."""
        if (counted == ~self.is_rejected).all():
            return self.kept
        return self.whole.reweighted(np.where(counted, 1.0, 0.0))

    def terms(self, estimate: Estimate) -> FloatArray:
        """(m,) terms of the cost of all measurements, whether truncated or not."""
        return self.whole.edge_costs(estimate)

    @property
    def cap(self) -> float:
        """The largest gap that says something about choices."""
        return OF_PRICE * float(self.prices.min())

    def settled(self, estimate: Estimate) -> Estimate:
        """The estimate with the best translations for the measurements that count there."""
        return self.counting(self.counted(estimate)).settled(estimate)

    @property
    def is_of_f(self) -> bool:
        """Whether terms of F are truncated."""
        return self.whole.cost_name == CHORDAL

    @property
    def cost_name(self) -> str:
        """The name in options of the cost that is truncated."""
        return self.whole.cost_name

    @property
    def title(self) -> str:
        """What the cost is."""
        return "truncated cost" if self.whole.is_chordal else f"truncated cost, {self.whole.title}"

    @property
    def unprovable(self) -> str:
        """Why the cost has no proof tier; empty if it has."""
        return self.whole.unprovable

    @property
    def engine(self) -> str:
        """The factorization engine."""
        return self.whole.engine

    @property
    def graph(self) -> Graph:
        """The graph with an edge for each measurement."""
        return self.whole.graph

    @property
    def measured(self) -> Graph:
        """All measurements."""
        return self.whole.measured

    @property
    def chordal(self) -> Quadratic:
        """The problem of all measurements under F."""
        return self.whole.chordal

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each row measures of a rotation, and (m,) of anything else."""
        return self.whole.numbers

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts in the cost."""
        return self.whole.double

    @property
    def scale(self) -> float:
        """W of the kept measurements."""
        return self.kept.scale

    def scaled(self, factor: float) -> TruncatedCost:
        """The same measurements with all weights and prices times ``factor``."""
        return TruncatedCost(self.whole.scaled(factor), factor * self.prices)

    def with_prices_of(self, point: Estimate) -> TruncatedCost:
        """The problem with the costs at a point as prices: hardly anything is cut off there.

        Those of `below`, whose minorants have no gradient there.
        """
        prices = self.prices.copy()
        costs = (1.0 - SAME) * self.truncation(point).costs
        prices[self.rejected] = np.maximum(costs, np.finfo(float).tiny)
        return TruncatedCost(self.whole, prices)

    def edge_costs(self, estimate: Estimate) -> FloatArray:
        """(m,) terms of the cost."""
        return np.minimum(self.terms(estimate), self.prices)

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on the cost, whose translations are taken as stored."""
        low, high = self.kept.enclosure(estimate)
        prices = self.prices[self.is_rejected]
        less, more = (
            math.fsum(np.minimum(of[self.is_rejected], prices))
            for of in self.whole.edge_enclosures(estimate)
        )
        return (
            math.nextafter((low + less) * (1.0 - 4.0 * U), -math.inf),
            math.nextafter((high + more) * (1.0 + 4.0 * U), math.inf),
        )

    def residual_lengths(self, estimate: Estimate) -> FloatArray | None:
        """(m,) norms of t_j - t_i - R_i t_ij, metres; None where only rotations are measured."""
        return self.whole.residual_lengths(estimate)

    def stationarity(self, estimate: Estimate) -> float:
        """Distance from stationarity, radians."""
        return self.counting(self.counted(estimate)).stationarity(estimate)

    def truncation(self, point: Point) -> Truncation:
        """The rejected measurements at the relative poses of a point."""
        prices = self.prices[self.is_rejected]
        return Truncation.at_point(self.below, prices, point, self.is_of_f)

    def minorants(
        self, point: Point, W: FloatArray | None = None, at: Truncation | None = None
    ) -> Minorants:
        """Minorants of the terms of all measurements, see `surrogate`.

        Parameters
        ----------
        at : the truncation at the point, if it is known
        """
        at = self.truncation(point) if at is None else at
        negative = at.minorants(at.plain() if W is None else W)
        return self._untruncated(point).replaced(self.is_rejected, negative)

    def surrogate(self, point: Point, W: FloatArray | None = None) -> Surrogate:
        """The problem of minorants, which touches the cost at a point if all have one there.

        Its constant is rounded down for exactly the weights of the problem.

        Parameters
        ----------
        W : (k, b, b) weights of the rejected measurements, see `Truncation`; by default those with
            which they touch their costs, or zero where there are none
        """
        return self.surrogate_of(self.minorants(point, W))

    def surrogate_of(self, minorants: Minorants) -> Surrogate:
        """The problem of minorants of all measurements."""
        graph, constant = minorants.summed(self.graph, is_signed=True)
        return Surrogate(self._general.of_same_edges(graph), constant, minorants)

    def _untruncated(self, point: Point) -> Minorants:
        """Minorants of the measurements' costs that touch at a point, zero where there are none."""
        found = self.whole.minorants(point)
        missing = ~found.exist
        if not missing.any():
            return found
        nothing = replace(found.subset(missing), tau=np.zeros(int(missing.sum())))
        none = replace(nothing, N=0.0 * nothing.b[:, :, None] * nothing.b[:, None, :])
        return found.replaced(missing, replace(none, constant=0.0 * none.tau))

    @cached_property
    def _general(self) -> Quadratic:
        """A problem with all edges, whose pattern surrogates share."""
        g = self.graph
        if g.has_positions:
            g = replace(g, arms=None, information=None, blocks=(), is_signed=True)
        return Quadratic(g, self.engine, is_part=True)


def indices_of(given: ArrayLike, m: int, which: str) -> IntArray:
    """Indices of some of m measurements; anything else is refused by an InputError.

    Parameters
    ----------
    which : what these measurements are, such as rejected
    """
    chosen = np.asarray(given)
    if chosen.ndim == 1 and not chosen.size:
        return np.zeros(0, dtype=np.intp)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or len(np.unique(chosen)) != len(chosen):
        raise InputError(f"{which} measurements are given by their indices, each once")
    if not 0 <= chosen.min() <= chosen.max() < m:
        raise InputError(f"{which} measurements have indices from 0 to {m - 1}")
    return chosen


def rejecting(
    problem: Any,
    rejected: IntArray,
    quantile: float | None = None,
    *,
    scale: float = 1.0,
    prices: FloatArray | None = None,
) -> TruncatedCost:
    """The truncated cost whose prices are a quantile of a correct measurement's term of F.

    Parameters
    ----------
    rejected : (k,) indices of the rejected measurements
    quantile : of chi^2, as in `certpgo.objective.chi_squared.quantiles`; by default that from which
        measurements are rejected, 1 - 0.01 / m
    scale : standard deviation of the noise over that stated by the weights
    prices : (k,) other prices, in units of F

    Raises
    ------
    InputError
        Indices that are not of measurements, or given twice, or a quantile out of its range; or a
        problem of another cost than F.
    """
    require(problem, Objective, "the problem of a graph")
    if len(problem.rejected):
        raise InputError("measurements are rejected of a problem that rejects none")
    m = problem.graph.num_edges
    chosen = indices_of(rejected, m, "rejected")
    require_numbers(quantile=quantile)
    found = quantiles(problem, flagged_from(problem) if quantile is None else quantile)
    whole = np.full(m, np.inf)
    whole[chosen] = scale**2 * found[chosen] if prices is None else prices
    return TruncatedCost(problem, whole)
