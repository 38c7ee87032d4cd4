"""The cost of another program on a graph: value, derivatives, scale and surrogate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

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
from certpgo.objective.chordal_cost import ChordalCost
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.edge_equations import EdgeEquations, relative
from certpgo.objective.families.distances import Distances
from certpgo.objective.lifted_distances import LiftedDistances, LiftedModel
from certpgo.objective.marginalized import isotropic_below
from certpgo.objective.minorants import Minorants
from certpgo.objective.normal_equations import NormalEquations
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.problem import PoseProblem
from certpgo.objective.sum import Sum


@dataclass(frozen=True, eq=False, repr=False)
class InformationProblem(Objective):
    """Minimise the cost of another program, f = sum e^T Omega e over the edges, over SE(d)^n.

    Attributes
    ----------
    edge_cost : the residuals of the program, for the measurements of a graph
    engine : factorization engine, see `certpgo.linalg.factor.engines`

    Raises
    ------
    GraphError
        The graph is disconnected, leaves a node free, or measures positions alone.
    """

    edge_cost: EdgeCost
    engine: str = field(default_factory=default_engine)

    def __post_init__(self) -> None:
        require_connected(self.graph)
        if not len(self.measured.pose_nodes):
            raise GraphError("there are no poses in the graph")
        if not (self.measured.kappa.any() or self.cost_name == ChordalCost.name):
            raise GraphError(
                f"the cost of {self.edge_cost.name} needs relative poses, not positions alone"
            )
        if self.graph.is_partial:
            require_determined(self.graph)

    @property
    def graph(self) -> Graph:
        """The graph with an edge for each measurement: a row of its blocks measures zero."""
        return self.edge_cost.whole

    @property
    def measured(self) -> Graph:
        """The measurements."""
        return self.edge_cost.graph

    @cached_property
    def chordal(self) -> PoseProblem:
        """The problem of these edges with isotropic weights; shares pattern and order."""
        return PoseProblem(self.graph, self.engine)

    @property
    def isotropic(self) -> PoseProblem | InformationProblem:
        """The problem of the same measurements under F, without those that do not lift."""
        if not self.measured.blocks:
            return self.chordal
        if (ranges := self.measured.ranges) is None:
            return PoseProblem(self.measured.with_blocks(), self.engine)
        return InformationProblem(Sum(self.measured.with_blocks(ranges), ChordalCost), self.engine)

    @cached_property
    def _distances(self) -> IntArray:
        """(k,) the rows whose cost is that of distances, which alone has a value at any rank."""
        # Not of a class that derives from it, whose cost is another one.
        found = [rows for rows, term in self.edge_cost.terms if type(term) is Distances]
        return np.concatenate([np.zeros(0, dtype=np.intp), *found])

    @cached_property
    def lifted_form(self) -> LiftedDistances | None:
        """The same cost at points of any rank; None where some terms have no value there."""
        cost, graph = self.edge_cost, self.measured
        is_of_f = type(cost) is Sum and cost.between is ChordalCost
        alone = is_of_f and len(graph.blocks) == 1 and len(self._distances) > 0
        return LiftedDistances(graph, self.engine) if alone else None

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
        return self.surrogate_of(self.edge_cost.minorants(v, so.project(Q)))

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
        signed = bool(self.measured.blocks)
        if (frozen := kept & ~self.lifted if self.measured.blocks else kept).all():
            general, constant = found.summed(graph, is_signed=signed)
            return Surrogate(self.chordal.of_same_edges(general), constant, minorants)
        general, constant = found.subset(frozen).summed(graph.with_edges(frozen), is_signed=signed)
        if (ranges := self.measured.ranges) is None or not len(self._distances):
            return Surrogate(self.chordal.of_same_edges(general), constant, minorants)
        below = LiftedDistances(general.with_blocks(ranges), self.engine)
        return Surrogate(below, constant, minorants)

    def relaxed(self) -> InformationProblem | None:
        """With relative poses of a lower cost, see `EdgeCost.relaxed`."""
        cost = self.edge_cost.relaxed()
        if cost is None or not cost.graph.is_definite.all():
            return None
        return self.with_cost(cost)

    def without_minorants(self, estimate: Estimate) -> IntArray:
        """(k,) indices of the measurements that have no minorant at an estimate."""
        return np.flatnonzero(~self.minorants(estimate).exist)

    def minorants(self, point: Point) -> Minorants:
        """Minorants of all measurements that touch at a point, where there are any."""
        return self.edge_cost.minorants(*self.relative(point))

    def isotropic_below(self, chosen: BoolArray) -> Graph | None:
        """Edges among ``chosen`` (m,) with terms of F nowhere above their costs; or None."""
        edges = self.measured.with_blocks().with_edges(chosen)
        if self.cost_name == ChordalCost.name:
            return edges
        return isotropic_below(edges, self.edge_cost.turned_share)

    @property
    def cost_name(self) -> str:
        """The cost's name in options."""
        return self.edge_cost.name

    @property
    def title(self) -> str:
        """What the cost is, in the words of the program's users."""
        return self.edge_cost.title

    @property
    def unprovable(self) -> str:
        """Why there are no proofs of the cost; empty if there are."""
        if self.measured.blocks:
            return f"the proof tier is not for {self.title}"
        if self.graph.arms is not None:
            return self.chordal.unprovable
        if self.edge_cost.provable:
            return ""
        return f"proofs and their tier are for the chordal cost and g2o's, not for {self.title}"

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each row measures of a rotation, and (m,) of anything else."""
        return self.edge_cost.numbers

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts in the cost."""
        return self.edge_cost.double

    @cached_property
    def scale(self) -> float:
        """W_f, see `certpgo.graph.scale`."""
        return self.edge_cost.scale.total

    def scaled(self, factor: float) -> InformationProblem:
        """The same measurements with all weights times ``factor``."""
        return self.with_cost(replace(self.edge_cost, graph=self.measured.scaled(factor)))

    def reweighted(self, factors: FloatArray) -> InformationProblem:
        """The problem with weights times factors (m,); a measurement with factor 0 is removed."""
        graph, blocks = self.measured, self.measured.blocks
        of_edges, *of_blocks = by_rows(graph, factors)
        kept = [of.reweighted(by) for of, by in zip(blocks, of_blocks, strict=True)]
        graph = graph.reweighted(of_edges).with_blocks(*(of for of in kept if of.num_edges))
        return self.with_cost(replace(self.edge_cost, graph=graph))

    def with_cost(self, edge_cost: EdgeCost) -> InformationProblem:
        """The problem of another cost on the same edges; pattern and order are shared."""
        other = InformationProblem(edge_cost, self.engine)
        other.__dict__["chordal"] = self.chordal.of_same_edges(edge_cost.whole)
        return other

    def relative(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """(m, d) vectors v = R_i^T (t_j + R_j a - t_i) and (m, d, d) rotations Q = R_i^T R_j."""
        return relative(self.graph.edges, self.graph.arms, point)

    def bend(self, v: FloatArray, weights: FloatArray) -> float:
        """What translations v (m, d) add to the cost over minorants with these weights (m,)."""
        of_cost = self.edge_cost.bend(v) - weights * (v * v).sum(axis=1)
        return float(of_cost[~self.lifted].sum())

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
            costs = frozen_floats(self.edge_cost.costs(*self.relative(estimate)))
            self.__dict__["_costs"] = estimate, costs
        return cast("FloatArray", costs)

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on f of an estimate, whose translations are taken as stored."""
        return self.edge_cost.enclosure(estimate)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(m,) lower and upper bounds on the terms of f."""
        return self.edge_cost.edge_enclosures(estimate)

    def residual_lengths(self, estimate: Estimate) -> FloatArray:
        """(m,) norms of t_j - t_i - R_i t_ij, then of other residuals that are lengths, metres."""
        lengths = self.chordal.residual_lengths(estimate)
        own = self.edge_cost.lengths_of_blocks(*self.relative(estimate))
        return np.append(lengths[: len(lengths) - len(own)], own)

    def linearized(self, estimate: Estimate) -> NormalEquations | LiftedModel:
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
        return EdgeEquations(self.edge_cost, self.n)

    @property
    def tangent_layout(self) -> Layout:
        """Of the normal equations: rows of translations, then of rotations."""
        return self.chordal.tangent_layout

    def gauss_newton(self, estimate: Estimate) -> CSC:
        """The Gauss-Newton matrix of half the cost, as in `linearized`."""
        return self.normal_equations(estimate).gauss_newton

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
        """(N,) one for the anchor's coordinates, zero for the others."""
        held = np.zeros((self.n, self.d + so.tangent_dim(self.d)))
        held[self.chordal.anchor] = 1.0
        return self.tangent_layout.pack(held)

    @property
    def unbounded(self) -> str:
        """That some information matrices are not positive definite, in a sentence, or empty."""
        bad, information = int((~self.edge_cost.is_definite).sum()), self.measured.information
        if not bad or information is None:
            return ""
        of_all = f"{bad} of {self.measured.num_edges} information matrices"
        return (
            f"{of_all} are {information.indefinite}: "
            f"{self.edge_cost.title} has no proven lower bound there (--cost chordal has)"
        )
