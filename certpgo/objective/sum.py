"""The cost of a graph as a sum of terms: value, derivatives, scale and surrogate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, cast

import numpy as np

from certpgo.errors import GraphError, NumericalError, refuse
from certpgo.graph import Estimate, Graph
from certpgo.graph.concatenate import by_rows
from certpgo.graph.graph import require_connected
from certpgo.graph.priors import require_determined
from certpgo.graph.relaxed_point import Point
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray, frozen_floats
from certpgo.linalg.blocks import Layout
from certpgo.linalg.factor import Symbolic, default_engine
from certpgo.linalg.refined import SingleFirst
from certpgo.objective.costs.chordal import ChordalCost
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.edge_equations import EdgeEquations
from certpgo.objective.families.distances import Distances
from certpgo.objective.lifted_distances import LiftedDistances, LiftedModel
from certpgo.objective.manifold_model import ManifoldModel
from certpgo.objective.marginalized import isotropic_below
from certpgo.objective.minorants import Minorants
from certpgo.objective.normal_equations import NormalEquations
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.term import relative
from certpgo.objective.terms import (
    Placed,
    edges_under,
    enclosure_of,
    enclosures_of,
    gathered,
    minorants_of,
    placed,
    scale_of,
    terms_of,
    title_of,
    with_rows,
)


@dataclass(frozen=True, eq=False, repr=False)
class Sum(Objective):
    """Minimise the sum of the terms of a graph, f = sum e^T W e, over SE(d)^n.

    Of relative poses they are the cost of a program, of all else that of its kind. Rows are the
    graph's edges, then those of its blocks.

    Attributes
    ----------
    measured : the measurements; of those of poses, with their information matrices
    between : the program's cost of relative poses
    engine : factorization engine, see `certpgo.linalg.factor.engines`
    remark : what else is to be said of the weights

    Raises
    ------
    GraphError
        The graph is disconnected, leaves a node free, or measures positions alone; or its edges
        have no information that the cost needs.
    InputError
        There is no term of something that is measured.
    """

    measured: Graph
    between: type[EdgeCost]
    engine: str = field(default_factory=default_engine)
    remark: str = ""

    def __post_init__(self) -> None:
        _ = self.terms  # checks them
        require_connected(self.graph)
        if not len(self.measured.pose_nodes):
            raise GraphError("there are no poses in the graph")
        if not (self.measured.kappa.any() or self.between is ChordalCost):
            raise GraphError(
                f"the cost of {self.cost_name} needs relative poses, not positions alone"
            )
        if self.graph.is_partial:
            require_determined(self.graph)

    @cached_property
    def of_edges(self) -> EdgeCost:
        """The program's cost of the edges, whatever they measure."""
        return edges_under(self.measured, self.between)

    @cached_property
    def terms(self) -> tuple[Placed, ...]:
        """The terms, each with the rows that are its measurements."""
        return terms_of(self.of_edges, self.measured.blocks)

    @cached_property
    def graph(self) -> Graph:
        """The graph with an edge for each measurement: a row of its blocks measures zero."""
        return with_rows(self.measured)

    @cached_property
    def chordal(self) -> Quadratic:
        """The problem of these edges with isotropic weights; shares pattern and order."""
        return Quadratic(self.graph, self.engine, roundings=max(t.roundings for _, t in self.terms))

    @property
    def isotropic(self) -> Quadratic | Sum:
        """The problem of the same measurements under F, without those that do not lift."""
        if not self.measured.blocks:
            return self.chordal
        if (ranges := self.measured.ranges) is None:
            return Quadratic(self.measured.with_blocks(), self.engine)
        return Sum(self.measured.with_blocks(ranges), ChordalCost, self.engine)

    @cached_property
    def _distances(self) -> IntArray:
        """(k,) the rows whose cost is that of distances, which alone has a value at any rank."""
        # Not of a class that derives from it, whose cost is another one.
        found = [rows for rows, term in self.terms if type(term) is Distances]
        return np.concatenate([np.zeros(0, dtype=np.intp), *found])

    @cached_property
    def lifted_form(self) -> LiftedDistances | None:
        """The same cost at points of any rank; None where some terms have no value there."""
        is_of_f, blocks = self.between is ChordalCost, self.measured.blocks
        alone = is_of_f and len(blocks) == 1 and len(self._distances) > 0
        return LiftedDistances(self.measured, self.engine) if alone else None

    @property
    def is_lifted(self) -> bool:
        """Whether its bound is that of a point above this space."""
        return self.lifted_form is not None

    @cached_property
    def lifted(self) -> BoolArray:
        """(m,) which measurements have a cost at points of any rank."""
        return np.isin(np.arange(self.graph.num_edges), self._distances)

    @property
    def most_steps(self) -> int:
        """Steps of a descent."""
        return 250 if self.is_lifted else 600

    @property
    def most_ranks(self) -> int:
        """Ranks above d that the relaxation is climbed to."""
        return 7 if self.is_lifted else 3

    def surrogate(self, point: Point) -> Surrogate:
        """The problem of the tangent minorants at an estimate, which touches the cost there.

        If the estimate is stationary for the cost, it is for the surrogate, and a lower bound of
        the surrogate's cost plus the constant is one of the cost. Measurements without a minorant
        there are left out: their terms are at least zero.

        Raises
        ------
        InputError
            Some information matrices are not positive definite.
        NumericalError
            The measurements that have minorants there do not connect the graph.
        """
        if self.lifted_form is not None:
            return Surrogate(self.lifted_form)
        return self.expanded(*self.relative(point))

    def expanded(self, v: FloatArray, Q: FloatArray) -> Surrogate:
        """The same of minorants at v (m, d) and Q (m, d, d), of whatever origin."""
        refuse(self.unbounded)
        return self.surrogate_of(minorants_of(self.terms, v, so.project(Q)))

    def surrogate_of(self, minorants: Minorants) -> Surrogate:
        """The problem of minorants of all measurements.

        Raises
        ------
        NumericalError
            The measurements whose minorants exist do not connect the graph.
        """
        graph, found, kept = self.graph, minorants, minorants.exist
        if not kept.all() and not (kept.any() and graph.with_edges(kept).is_connected):
            raise NumericalError("measurements with minorants do not connect the graph")
        frozen = kept & ~self.lifted if self.measured.blocks else kept
        general, constant = self.summed(found, frozen)
        ranges = self.measured.ranges
        if frozen.all() or ranges is None or not len(self._distances):
            return Surrogate(self.form_of_sums.of_same_edges(general), constant, minorants)
        below = LiftedDistances(general.with_blocks(ranges), self.engine, self.chordal.roundings)
        return Surrogate(below, constant, minorants)

    @property
    def form_of_sums(self) -> Quadratic:
        """The problem whose pattern surrogates share."""
        return self.chordal

    def summed(self, found: Minorants, chosen: BoolArray) -> tuple[Graph, float]:
        """A graph and a constant that add up to the chosen minorants (m,)."""
        graph, signed = self.graph, bool(self.measured.blocks)
        if not chosen.all():
            graph, found = graph.with_edges(chosen), found.subset(chosen)
        return found.summed(graph, is_signed=signed)

    def relaxed(self) -> Self | None:
        """With relative poses of a lower cost, see `EdgeCost.relaxed`, and all else as it is."""
        if self.between.takes_partial:
            return None
        poses = self.measured.measures_rotation
        below = self.between(self.of_edges.graph.with_edges(poses)).relaxed()
        if below is None:
            return None
        information = self.measured.information_matrices.copy()
        information[poses] = below.graph.information_matrices
        lower = self.measured.with_information(information)
        return self.of_same_edges(lower) if lower.is_definite.all() else None

    def without_minorants(self, estimate: Estimate) -> IntArray:
        """(k,) indices of the measurements that have no minorant at an estimate."""
        return np.flatnonzero(~self.minorants(estimate).exist)

    def minorants(self, point: Point) -> Minorants:
        """Minorants of all measurements that touch at a point, where there are any."""
        return minorants_of(self.terms, *self.relative(point))

    def isotropic_below(self, chosen: BoolArray) -> Graph | None:
        """Edges among ``chosen`` (m,) with terms of F nowhere above their costs; or None."""
        edges = self.measured.with_blocks().with_edges(chosen)
        if self.between is ChordalCost:
            return edges
        return isotropic_below(edges, self.of_edges.turned_share)

    @property
    def cost_name(self) -> str:
        """The cost's name in options."""
        return self.between.name

    @property
    def title(self) -> str:
        """What the cost is, in the words of the program's users."""
        title = title_of(self.of_edges, self.measured.blocks)
        return f"{title}, {self.remark}" if self.remark else title

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost; empty if there are."""
        said = f"the proof tier is not for {self.title}, whose minorants are rounded"
        return said if self.chordal.roundings else self.chordal.unprovable

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each row measures of a rotation, and (m,) of anything else."""
        turned = gathered(self.terms, lambda term: term.numbers[0])
        return turned, gathered(self.terms, lambda term: term.numbers[1])

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts in the cost."""
        return cast("IntArray", gathered(self.terms, lambda term: term.double))

    @cached_property
    def scale(self) -> float:
        """W_f, see `certpgo.graph.scale`."""
        return scale_of(self.terms).total

    def scaled(self, factor: float) -> Self:
        """The same measurements with all weights times ``factor``."""
        return self.of_same_edges(self.measured.scaled(factor))

    def reweighted(self, factors: FloatArray) -> Self:
        """The problem with weights times factors (m,); a measurement with factor 0 is removed."""
        graph, blocks = self.measured, self.measured.blocks
        of_edges, *of_blocks = by_rows(graph, factors)
        kept = [of.reweighted(by) for of, by in zip(blocks, of_blocks, strict=True)]
        return self.of_same_edges(
            graph.reweighted(of_edges).with_blocks(*(of for of in kept if of.num_edges))
        )

    def of_same_edges(self, measured: Graph) -> Self:
        """The problem of other measurements of the same edges; pattern and order are shared."""
        other = replace(self, measured=measured)
        other.__dict__["chordal"] = self.chordal.of_same_edges(other.graph)
        return other

    def relative(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """(m, d) vectors v = R_i^T (t_j + R_j a - t_i) and (m, d, d) rotations Q = R_i^T R_j."""
        return relative(self.graph.edges, self.graph.arms, point)

    def bend(self, v: FloatArray, weights: FloatArray) -> float:
        """What translations v (m, d) add to the cost over minorants with these weights (m,)."""
        own = placed([(rows, term.bend(v[rows])) for rows, term in self.terms])
        return float((own - weights * (v * v).sum(axis=1))[~self.lifted].sum())

    def edge_costs(self, estimate: Estimate) -> FloatArray:
        """(m,) terms of f, one per edge.

        Raises
        ------
        InputError
            An estimate of another graph.
        """
        # Search, judge and report ask for those of the same estimate.
        asked, costs = self.__dict__.get("_costs", (None, None))
        if asked is not estimate:
            self.check(estimate)
            found = gathered(self.terms, lambda term: term.costs(*term.relative(estimate)))
            costs = frozen_floats(found)
            self.__dict__["_costs"] = estimate, costs
        return cast("FloatArray", costs)

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on f of an estimate, whose translations are taken as stored."""
        return enclosure_of(self.terms, estimate)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(m,) lower and upper bounds on the terms of f."""
        return enclosures_of(self.terms, estimate)

    def residual_lengths(self, estimate: Estimate) -> FloatArray | None:
        """(m,) norms of t_j - t_i - R_i t_ij, then of other lengths, metres; None without any."""
        if not self.has_positions:
            return None
        m = self.measured.num_edges
        lengths = cast("FloatArray", self.chordal.residual_lengths(estimate))
        for rows, term in self.terms:
            if rows[0] >= m:
                e = term.residuals(*term.relative(estimate))
                lengths[rows] = np.linalg.norm(e, axis=1) * term.in_metres
        return lengths

    def linearized(self, estimate: Estimate) -> NormalEquations | LiftedModel | ManifoldModel:
        """The model that descents take steps by: with exact Hessians where the cost lifts."""
        if self.lifted_form is not None:
            return self.lifted_form.linearized(estimate)
        return self.normal_equations(estimate)

    def normal_equations(self, estimate: Estimate) -> NormalEquations:
        """The cost and its linearization, in world-frame translations and body-frame rotations."""
        cost, gradient = self.equations.first(estimate)
        return NormalEquations(self, estimate, cost, self.tangent_layout.pack(gradient))

    @cached_property
    def equations(self) -> EdgeEquations:
        """The sums over edges that make up its derivatives."""
        return EdgeEquations(self.terms, self.n)

    @property
    def tangent_layout(self) -> Layout:
        """Of the normal equations: rows of translations, then of rotations."""
        return self.chordal.tangent_layout

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """The Gauss-Newton matrix of half the cost, as in `linearized`."""
        return self.chordal.pattern.assemble(*self.gauss_newton_blocks(estimate), self.d)

    def gauss_newton_blocks(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Its blocks of the nodes, and those of each edge between its nodes."""
        return self.equations.second(estimate)

    def symbolic(self, A: CSC) -> Symbolic:
        """The symbolic analysis of a block matrix of this graph."""
        return self.chordal.symbolic(A)

    @cached_property
    def factors(self) -> SingleFirst:
        """How its Gauss-Newton matrices are factorized."""
        return SingleFirst()

    def stationarity(self, estimate: Estimate) -> float:
        """Largest gradient of a pose over its curvature, radians and relative translations."""
        here = self.normal_equations(estimate)
        return here.stationarity(here.scale(here.gauss_newton))

    @cached_property
    def length(self) -> float:
        """Of the measured translations: their root mean square, or 1."""
        t = self.measured.translations
        return math.sqrt(float(np.einsum("ma,ma->", t, t)) / len(t)) or 1.0

    @cached_property
    def held(self) -> FloatArray:
        """(N,) one for the anchor's coordinates and turns that no term has, zero for others."""
        held = np.zeros((self.n, self.d * self.has_positions + so.tangent_dim(self.d)))
        held[self.chordal.anchor] = 1.0
        for _, term in self.terms:
            nodes, axes = term.idle_turns(self.measured)
            held[nodes, self.d + axes] = 1.0
        return self.tangent_layout.pack(held)

    @property
    def unbounded(self) -> str:
        """That some information matrices are not positive definite, in a sentence, or empty."""
        bad, information = int((~self.of_edges.is_definite).sum()), self.measured.information
        if not bad or information is None:
            return ""
        of_all = f"{bad} of {self.measured.num_edges} information matrices are"
        lacks = f"{self.title} has no proven lower bound there (--cost chordal has)"
        return f"{of_all} {information.indefinite}: {lacks}"
