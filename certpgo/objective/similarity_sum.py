"""F over similarities, with distances and measurements of other kinds: f = F + sum of their costs.

A distance needs no frame: it is one between positions, in the unit of the world, and so are its
tangents. All else is measured in the frame of its first node, whose minorants tau |v - b|^2 are
edges tau |t_j - t_i - R_i b|^2. That is a quadratic form of blocks s_i R_i where s_i is known, and
nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from certpgo.errors import GraphError, InputError, refuse
from certpgo.graph import Estimate, Graph
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.edge_equations import EdgeEquations
from certpgo.objective.manifold_model import ManifoldModel
from certpgo.objective.minorants import Minorants
from certpgo.objective.normal_equations import NO_SCALES, NormalEquations
from certpgo.objective.objective import Surrogate
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.term import Term
from certpgo.objective.terms import Placed, enclosure_of, gathered

#: Where no scale is known.
NO_UNIT = (
    "no pose has a known scale, which the unit of other measurements takes: one does, such as the "
    "world of positions"
)
IN_KNOWN_UNIT = ", over similarities in the unit of the poses of known scale"
#: Where terms are asked whether they need a frame.
V, W = np.array([0.9, -0.7, 0.4]), np.array([0.3, 0.8, -0.5])


@dataclass(frozen=True, eq=False, repr=False)
class SimilaritySum(Sum):
    """The sum of F over similarities and the terms of a graph's blocks.

    Raises
    ------
    InputError
        No pose has a known scale, so that no unit is known; or a measurement that needs a frame is
        made from another node, or is not of positions alone.
    """

    takes_scales: ClassVar[bool] = True
    lifted_form: ClassVar[None] = None

    def __post_init__(self) -> None:
        if self.measured.in_mean_unit:
            raise InputError(NO_UNIT)
        for _, term in self._others:
            refuse(self._unfit(term))
        super().__post_init__()

    def _unfit(self, term: Term) -> str:
        """Why the minorants of a term are no form of similarities, in a sentence; or empty."""
        (k, _), d = term.edges.shape, self.d
        at = np.tile(V[:d], (k, 1)), np.tile(so.exp(W[None, : so.tangent_dim(d)]), (k, 1, 1))
        found = term.minorants(*at)
        if found.N.any() or found.a.any() or term.arms is not None:
            return f"measured {term.plural} are not of positions alone, and there are scales"
        apart = ~self._fits(term.edges[:, 0], found)
        if not apart.any():
            return ""
        node = int(term.edges[np.argmax(apart), 0])
        frame = f"the frame of node {node}, which is no pose of known scale"
        return f"{term.plural} are measured in {frame}"

    def _fits(self, first: IntArray, found: Minorants) -> BoolArray:
        """(k,) which minorants are forms of blocks s_i R_i of these first nodes (k,)."""
        known = np.isin(first, self.chordal.held) | ~found.b.any(axis=1)
        return np.asarray(known & ~found.a.any(axis=1) & ~found.N.any(axis=(1, 2)))

    @property
    def title(self) -> str:
        """What the cost is."""
        return f"{super().title}{IN_KNOWN_UNIT}"

    @property
    def _m(self) -> int:
        """The number of edges: rows from there on are of blocks."""
        return int(self.measured.num_edges)

    @cached_property
    def _others(self) -> tuple[Placed, ...]:
        """The terms of blocks, whose rows count from the first of these."""
        others = [one for one in self.terms if one.rows[0] >= self._m]
        return tuple(Placed(rows - self._m, term) for rows, term in others)

    @cached_property
    def _of_edges_alone(self) -> Quadratic:
        """F, where rows of blocks weigh nothing."""
        tau = np.where(np.arange(self.graph.num_edges) < self._m, self.graph.tau, 0.0)
        return self.chordal.of_same_edges(replace(self.graph, tau=tau))

    @cached_property
    def isotropic(self) -> Quadratic:
        """F without blocks; where these alone join some nodes, with zeros in place of them."""
        try:
            return Quadratic(self.measured.with_blocks(), self.engine)
        except GraphError:
            return self.chordal

    # --- The cost ---------------------------------------------------------------------------------

    @property
    def form(self) -> Graph:
        """The edges between `blocks`; rows of the graph's blocks weigh nothing."""
        return self._of_edges_alone.form  # type: ignore[no-any-return]

    def blocks(self, point: Point) -> Lift:
        """The point with blocks s_i R_i in place of rotations."""
        return self.chordal.blocks(point)  # type: ignore[no-any-return]

    def _frames(self, point: Point) -> Estimate:
        """The rotations and positions of a point of rank d."""
        A = self.blocks(point).rotations
        sizes = self.chordal.sizes_of(A)
        return Estimate.trusted(A / sizes[:, None, None], translations_of(point))

    def edge_costs(self, point: Point) -> FloatArray:
        """(m,) terms of f, one per row."""
        if isinstance(point, Estimate):
            self.check(point)
        frames, of_edges = self._frames(point), self._of_edges_alone.edge_costs(point)
        more = gathered(self._others, lambda term: term.costs(*term.relative(frames)))
        return np.concatenate([of_edges[: self._m], more])

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on f of an estimate, whose translations are taken as stored."""
        of_edges = self._of_edges_alone.enclosure(estimate)
        low, high = map(sum, zip(of_edges, enclosure_of(self._others, estimate), strict=True))
        return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Refused: truncated costs, which take them, are not those of similarities."""
        raise InputError("a truncated cost is for poses of known scale, not for similarities")

    # --- Descents ---------------------------------------------------------------------------------

    @cached_property
    def equations(self) -> EdgeEquations:
        """The sums over rows of blocks that make up the derivatives of their terms."""
        return EdgeEquations(self._others, self.n)

    def gradient(self, point: Point) -> FloatArray:
        """Half the Euclidean gradient of f at a point of rank d, (n, d, d + 1), as of F."""
        G, frames, d = self._of_edges_alone.gradient(point), self._frames(point), self.d
        _, more = self.equations.first(frames)
        G[:, :, 0] += more[:, :d]
        G[:, :, 1:] += 0.5 * frames.rotations @ so.hat(more[:, d:])
        return G

    def hessian_blocks(
        self, point: Point, basis: FloatArray, multipliers: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Hessian of f/2 over turns R_i hat(e_k), as far as it is known."""
        diagonal, upper = self._of_edges_alone.hessian_blocks(point, basis, multipliers)
        exact = multipliers is not None
        at_nodes, between = self.equations.second(self._frames(point), exact=exact)
        p = at_nodes.shape[1]
        diagonal[:, :p, :p] += at_nodes
        upper[self._m :, :p, :p] += between
        return diagonal, upper

    def linearized(self, estimate: Estimate) -> ManifoldModel:
        """The quadratic model of f at an estimate."""
        return ManifoldModel(self, self.blocks(estimate))

    def stationarity(self, estimate: Estimate) -> float:
        """Distance from stationarity, radians and shares of scales and lengths."""
        here = self.linearized(estimate)
        return here.stationarity(here.scale(here.gauss_newton))

    def normal_equations(self, estimate: Estimate) -> NormalEquations:
        """Refused: covariances, which take them, are not those of similarities."""
        raise InputError(NO_SCALES)

    def gauss_newton_blocks(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Refused, as `normal_equations`."""
        raise InputError(NO_SCALES)

    def estimate_of(self, point: Lift) -> Estimate:
        """The nearest estimate to the end of a descent."""
        return self.chordal.estimate_of(point)

    def nearest_estimates(self, point: Point) -> Iterator[Estimate]:
        """The projections to the main subspace of a point, of either handedness."""
        yield from self.chordal.projections(point)

    # --- Bounds -----------------------------------------------------------------------------------

    def surrogate_of(self, minorants: Minorants) -> Surrogate:
        """The problem of minorants of all rows that are forms of blocks s_i R_i."""
        first, of_edges = self.graph.edges[:, 0], np.arange(self.graph.num_edges) < self._m
        fits = np.where(self._fits(first, minorants), minorants.constant, -np.inf)
        constant = np.where(of_edges, 0.0, fits)
        return super().surrogate_of(replace(minorants, constant=constant))

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost."""
        return f"the proof tier is not for {self.title}"

    def summed(self, found: Minorants, chosen: BoolArray) -> tuple[Graph, float]:
        """The edges of F, and those of the chosen minorants of blocks; the sum of constants."""
        of_rows = chosen & (np.arange(len(chosen)) >= self._m)
        tau = np.where(of_rows, found.tau, self.graph.tau)
        b = np.where(of_rows[:, None], found.b, self.graph.translations)
        below = replace(self.graph, tau=tau, translations=b).with_edges(chosen)
        return below, math.nextafter(math.fsum(found.constant[of_rows]), -math.inf)
