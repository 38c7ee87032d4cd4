"""The cost of logarithms of similarities, as of g2o's EdgeSim3 and GTSAM's Similarity2 and 3.

The error of an edge is [omega, upsilon, sigma] = log(S_ij^-1 X_i^-1 X_j) for X = (s R, t), and its
term

    kappa (2 |omega|^2 + d sigma^2) + tau s_ij^2 |upsilon|^2,

to second order that of F in the unit of node i. It does not depend on the unit of any node, and no
quadratic form lies below it for all scales. One does for scales within a factor of given ones: with
L(a, b) = (a - b) / (log a - log b), the logarithmic mean, which grows with a and b,

    (s_j - s_i s_ij)^2 = sigma^2 L(s_j, s_i s_ij)^2,  s_i s_j s_ij <= L(s_j, s_i s_ij)^2,
    |t_j - t_i - A_i t_ij| <= s_ij |upsilon| L(s_i, s_j / s_ij),

as upsilon = W^-1 u for |u| = |t_j - t_i - A_i t_ij| / (s_i s_ij), and |W| <= (exp(sigma) - 1) /
sigma. Hence, if all scales are at most beta, the term is at least beta^-2 times that of F with
weights kappa / L(1, s_ij)^2 and tau / L(1, 1 / s_ij)^2; see docs/concepts/similarities.md.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph
from certpgo.graph.relaxed_point import Lift, translations_of
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.similarities import Similarities, log_derivatives
from certpgo.objective.manifold_model import ManifoldModel
from certpgo.objective.quadratic import Quadratic

#: Share of the minorant's weights that rounding of the means stays below.
ROUNDED = 1e-13


class LogarithmCost:
    """Minimise the cost of logarithms over similarities; see `certpgo.fit_logarithms`.

    Parameters
    ----------
    graph : a connected graph of poses

    Raises
    ------
    GraphError
        The graph is disconnected.
    InputError
        It is not a SimilarityGraph, or has points, which measure no scale.
    """

    def __init__(self, graph: Graph) -> None:
        if not graph.has_scales:
            raise InputError("logarithms are of similarities: certpgo.SimilarityGraph")
        self.quadratic = Quadratic(graph)
        if graph.is_partial:
            raise InputError("the cost of logarithms is for poses alone, without points")
        self.graph = graph

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate of another graph by an InputError."""
        self.quadratic.check(estimate)

    def estimate_of(self, point: Lift) -> Estimate:
        """The nearest estimate to a point, as of `Quadratic`."""
        return self.quadratic.estimate_of(point)

    def cost(self, estimate: Estimate) -> float:
        """The cost of an estimate."""
        return self.linearized(estimate).cost

    def edge_costs(self, estimate: Estimate) -> FloatArray:
        """(m,) terms of the cost, one per edge."""
        return self.linearized(estimate).edge_costs

    def linearized(self, estimate: Estimate) -> LogarithmModel:
        """The quadratic model of the cost at an estimate."""
        return LogarithmModel(self.quadratic, self.quadratic.blocks(estimate))

    def minorant(self, estimate: Estimate) -> Quadratic:
        """F over the scales of an estimate, at most beta^2 times the cost if these are within beta.

        That is, within a factor beta of the root mean square of all, which is the unit of F.
        """
        units = self.graph.in_units_of(self.quadratic.scales.of(estimate))
        sigma, kept = np.log(units.scales), 1.0 - ROUNDED
        kappa = kept * units.kappa / logarithmic_mean(sigma) ** 2
        tau = kept * units.tau / logarithmic_mean(-sigma) ** 2
        free = np.ones(units.num_nodes, dtype=bool)
        return Quadratic(units.with_weights(kappa, tau).with_unknown_scales(free))


def logarithmic_mean(sigma: FloatArray) -> FloatArray:
    """The logarithmic mean of 1 and exp(sigma)."""
    safe = np.where(sigma == 0.0, 1.0, sigma)
    return np.asarray(np.where(sigma == 0.0, 1.0, np.expm1(safe) / safe))


class LogarithmModel(ManifoldModel):
    """The cost of logarithms near an estimate: a `QuadraticModel` of Gauss and Newton."""

    @cached_property
    def edge_costs(self) -> FloatArray:
        """(m,) terms of the cost."""
        return np.asarray((self._precisions * self._errors**2).sum(axis=1))

    @cached_property
    def _precisions(self) -> FloatArray:
        """(m, 7) weights of the squares of [omega, upsilon, sigma]."""
        graph, d = self.problem.graph, self.problem.d
        kappa, tau = graph.kappa, graph.tau * graph.scales**2
        return np.stack([2.0 * kappa] * 3 + [tau] * 3 + [d * kappa], axis=1)

    @cached_property
    def _nodes(self) -> Similarities:
        A, problem = self.point.rotations, self.problem
        t = translations_of(self.point)
        s = problem.sizes_of(A)
        return Similarities.of(A / s[:, None, None], t, s)

    @cached_property
    def _measured(self) -> Similarities:
        graph = self.problem.graph
        return Similarities.of(graph.rotations, graph.translations, graph.scales)

    @cached_property
    def _relative(self) -> Similarities:
        """X_j^-1 X_i of the edges."""
        i, j = self.problem.graph.edges.T
        return self._nodes.subset(j).inverse @ self._nodes.subset(i)

    @cached_property
    def _off(self) -> Similarities:
        """S_ij^-1 X_i^-1 X_j, the identity where an edge is fitted."""
        return (self._relative @ self._measured).inverse

    @cached_property
    def _errors(self) -> FloatArray:
        return self._off.logarithms

    @cached_property
    def _derivatives(self) -> tuple[FloatArray, FloatArray]:
        """(m, 7, b) of the errors by the coordinates of node i, and by those of node j."""
        i, j = self.problem.graph.edges.T
        at_i = log_derivatives(lambda x: (self._relative @ x @ self._measured).inverse)
        at_j = log_derivatives(lambda x: self._off @ x)
        return self._by_coordinates(at_i, i), self._by_coordinates(at_j, j)

    def _by_coordinates(self, by_frame: FloatArray, nodes: IntArray) -> FloatArray:
        """Derivatives by translations in the world, turns and growth, from those in the frame."""
        Q, _, s = self._nodes.subset(nodes)
        d = self.problem.d
        turns = slice(2, 3) if d == 2 else slice(0, 3)
        moves = by_frame[:, :, 3:6] @ np.swapaxes(Q, 1, 2) / s[:, None, None]
        grows = np.where(self.problem.graph.free[nodes, None, None], by_frame[:, :, 6:], 0.0)
        return np.concatenate([moves[:, :, :d], by_frame[:, :, turns], grows], axis=2)

    @cached_property
    def gradient(self) -> FloatArray:
        """(N,) half the gradient of the cost."""
        weighed, n = self._precisions * self._errors, self.problem.n
        (i, j), (at_i, at_j) = self.problem.graph.edges.T, self._derivatives
        by_i, by_j = (np.einsum("meb,me->mb", D, weighed) for D in (at_i, at_j))
        return np.asarray(self.layout.pack(scatter_sum(i, by_i, n) + scatter_sum(j, by_j, n)))

    @cached_property
    def gauss_newton(self) -> CSC:
        """The Gauss-Newton matrix of half the cost."""
        problem, n, roots = self.problem, self.problem.n, np.sqrt(self._precisions)[:, :, None]
        (i, j), (at_i, at_j) = problem.graph.edges.T, (roots * D for D in self._derivatives)
        of_i, of_j = np.swapaxes(at_i, 1, 2), np.swapaxes(at_j, 1, 2)
        diagonal = scatter_sum(i, of_i @ at_i, n) + scatter_sum(j, of_j @ at_j, n)
        diagonal[~problem.graph.free, -1, -1] = 1.0
        return problem.pattern.assemble(diagonal, of_i @ at_j, self.rank)

    @property
    def hessian(self) -> CSC:
        """The Gauss-Newton matrix: the exact Hessian is not known."""
        return self.gauss_newton
