"""Robust costs of measurements: a kernel of what they cost otherwise."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from certpgo.errors import refuse
from certpgo.graph import Graph
from certpgo.graph.capabilities import lacking
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.costs.chordal import ChordalCost
from certpgo.objective.kernels import AppliedKernel
from certpgo.objective.marginalized import isotropic_below
from certpgo.objective.minorants import Minorants
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.robust_minorants import robust_minorants
from certpgo.objective.sum import Sum
from certpgo.objective.term import Term
from certpgo.objective.terms import Placed, terms_of


@dataclass(frozen=True, eq=False)
class Robust(Term):
    """rho(e^T W e) in place of the costs e^T W e of another term.

    Attributes
    ----------
    term : the measurements and their costs
    kernel : rho of each
    below : edges whose terms of F are these costs, or nowhere above them; None if not known
    """

    term: Term
    kernel: AppliedKernel
    below: Graph | None
    has_whole_arms: ClassVar[bool] = True

    @property
    def edges(self) -> IntArray:
        """(k, 2) the nodes of each measurement."""
        return self.term.edges

    @property
    def arms(self) -> FloatArray | None:
        """(k, d) arms at the second nodes; None for zeros."""
        return self.term.arms

    @property
    def weights(self) -> FloatArray:
        """(k, r, r) weights W of the residuals."""
        return self.term.weights

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them: as without a kernel."""
        return self.term.scale

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(k,) how many numbers each measures of a rotation, and (k,) of anything else."""
        return self.term.numbers

    @property
    def double(self) -> IntArray:
        """(k,) how often the square of a turn counts in the cost."""
        return self.term.double

    @property
    def has_more(self) -> bool:
        """That second derivatives are those of rho, too."""
        return True

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k, r) residuals of the term."""
        return self.term.residuals(v, Q)

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of the term with their derivatives; see `Term.linearized`."""
        return self.term.linearized(v, Q)

    def weighed(
        self, e: FloatArray, *, exact: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rho with the derivatives of half of it; see `Term.weighed`."""
        q, We, W = self.term.weighed(e)
        slopes = self.kernel.slopes(q)
        curved = slopes[:, None, None] * W
        if exact:
            bends = 2.0 * self.kernel.bends(q)
            curved = curved + bends[:, None, None] * (We[:, :, None] * We[:, None, :])
        return self.kernel.costs(q), slopes[:, None] * We, curved

    def costs(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k,) costs."""
        return self.kernel.costs(self.term.costs(v, Q))

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(k,) balls that contain the costs of all of these (v, Q)."""
        return self.kernel.enclosures(self.term.enclosures(v, Q))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch where `below` is the cost itself, and those of idle measurements."""
        found, robust = self.term.minorants(v, Q), ~self.kernel.idle
        found = replace(found, touching=None)
        if not robust.any():
            return found
        if self.below is None:
            constant = np.where(robust, -np.inf, found.constant)
            return replace(found, constant=constant)
        below = self.below.with_edges(robust)
        others = robust_minorants(self.kernel.of(robust), below, v[robust], Q[robust])
        return found.replaced(robust, others)


@dataclass(frozen=True, eq=False, repr=False)
class RobustSum(Sum):
    """A sum of terms with a kernel of the costs of its edges.

    Attributes
    ----------
    kernel : of the edges; other rows keep their costs

    Raises
    ------
    InputError
        The graph has what a kernel does not take, see `certpgo.graph.capabilities`.
    """

    kernel: AppliedKernel = field(kw_only=True)

    def __post_init__(self) -> None:
        refuse(lacking(self.measured, "kernel"))
        super().__post_init__()

    @staticmethod
    def of(plain: Sum, kernel: AppliedKernel) -> RobustSum:
        """The sum with a kernel around it; pattern and order are shared."""
        names = (one.name for one in fields(Sum))
        found = RobustSum(**{name: getattr(plain, name) for name in names}, kernel=kernel)
        if "chordal" in plain.__dict__:
            found.__dict__["chordal"] = plain.chordal
        return found

    @cached_property
    def plain(self) -> Sum:
        """The same without the kernel."""
        found = Sum(**{one.name: getattr(self, one.name) for one in fields(Sum)})
        found.__dict__["chordal"] = self.chordal
        return found

    @cached_property
    def terms(self) -> tuple[Placed, ...]:
        """The terms, of which those of edges have the kernel."""
        of_edges, m = self.of_edges, self.measured.num_edges
        below: Graph | None = of_edges.graph
        if self.between is not ChordalCost:
            below = isotropic_below(of_edges.graph, of_edges.turned_share)
        found = []
        for rows, term in terms_of(of_edges, self.measured.blocks):
            is_of_edges = rows[0] < m
            edges = below.with_edges(rows) if is_of_edges and below is not None else None
            robust = Robust(term, self.kernel.of(rows), edges) if is_of_edges else term
            found.append(Placed(rows, robust))
        return tuple(found)

    @property
    def lifted_form(self) -> None:
        """None: there are no values at points of higher rank."""
        return None

    @cached_property
    def form_of_sums(self) -> Quadratic:
        """The problem whose pattern surrogates share, of any sign."""
        form = replace(self.chordal, is_part=not self.has_positions)
        form.__dict__["analyses"] = self.chordal.analyses
        return form

    def summed(self, found: Minorants, chosen: BoolArray) -> tuple[Graph, float]:
        """Edges and a constant that add up to the chosen minorants (m,)."""
        found, graph = found.subset(chosen), self.graph.with_edges(chosen)
        return found.summed(graph, is_signed=self.has_positions)

    def relaxed(self) -> RobustSum | None:
        """With lower costs of relative poses, as without the kernel."""
        below = self.plain.relaxed()
        return None if below is None else RobustSum.of(below, self.kernel)

    def isotropic_below(self, chosen: BoolArray) -> None:
        """None: no terms of F are below, wherever positions are."""
        return

    @property
    def cost_name(self) -> str:
        """The names of the cost in options and of its kernel."""
        return f"{self.between.name}:{self.kernel.kernel.name}"

    @property
    def title(self) -> str:
        """What the cost is."""
        return f"{self.plain.title}, under {self.kernel.kernel}"

    @property
    def unprovable(self) -> str:
        """That there are no proofs."""
        return f"the proof tier is not for {self.title}"

    def scaled(self, factor: float) -> RobustSum:
        """The same measurements with all weights, and costs, times ``factor``."""
        return RobustSum.of(self.plain.scaled(factor), self.kernel.scaled(factor))

    def reweighted(self, factors: FloatArray) -> RobustSum:
        """The problem with weights times factors (m,), and kernels of the same scale.

        A measurement with factor 0 is removed.
        """
        kept = factors[: self.measured.num_edges] != 0.0
        return RobustSum.of(self.plain.reweighted(factors), self.kernel.of(kept))

    def bend(self, v: FloatArray, weights: FloatArray) -> float:
        """Zero: the cost is not convex in translations."""
        return 0.0
