"""Nodes of unknown scale: their blocks, and bounds on the rounding of costs and matrices.

F is a quadratic form of blocks A_i = s_i R_i and positions t_i, the same matrix M as that of poses
but for measured scales. A pose of known scale has A^T A = I; one of unknown scale has A^T A = s^2 I
for any s. Where no scale is known, the cost is F over the mean of s_i^2. The data are the rotations
nearest to the stored matrices, and the stored numbers. docs/concepts/similarities.md has the
proofs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.graph.relaxed_point import Lift, Point, translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import BlockPattern, scatter_sum
from certpgo.objective import operators

#: Shares of the multipliers that are given up for a bound.
SHARES = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4)


@dataclass(frozen=True, eq=False)
class Scales:
    """The scales of a graph's nodes.

    Attributes
    ----------
    graph : with a measured scale for each edge
    free : (n,) which nodes have an unknown scale
    in_mean_unit : whether no pose has a known one, so that the unit is the root mean square of all
    """

    graph: Graph
    free: BoolArray
    in_mean_unit: bool

    @cached_property
    def form(self) -> Graph:
        """The measurements as edges whose residuals are A_j - A_i s_ij R_ij."""
        graph = self.graph
        P = graph.scales[:, None, None] * graph.rotations
        kappa, one = graph.kappa[:, None, None], np.eye(graph.d)
        N = kappa * P
        general = RotationGraph(graph.num_nodes, graph.edges, graph.rotations, graph.kappa, N)
        K = kappa * one
        general.__dict__["polar"] = P, K, graph.scales[:, None, None] ** 2 * K
        moved = graph.translations, graph.tau, None, graph.is_point, graph.assumed, graph.absolute
        return PoseGraph(general, *moved, is_signed=graph.is_signed)

    def sizes(self, A: FloatArray) -> FloatArray:
        """(n,) scales of blocks (n, r, d): 1 where they are known."""
        sizes = np.sqrt(np.einsum("nra,nra->n", A, A) / A.shape[2])
        return np.where(self.free, sizes, 1.0)

    def of(self, estimate: Estimate) -> FloatArray:
        """(n,) the scales of an estimate: 1 where they are known, and without any."""
        if estimate.scales is None:
            return np.ones(len(self.free))
        return np.where(self.free, estimate.scales, 1.0)

    def blocks(self, point: Point) -> Lift:
        """The point with A_i = s_i R_i in place of rotations, in the unit of the cost."""
        A, t, unit = self._scaled(point), point.translations, self.unit(point)
        return Lift(A / unit, None if t is None else t / unit)

    def unit(self, point: Point) -> float:
        """The root mean square scale of a point, or 1 where some scales are known."""
        if not self.in_mean_unit:
            return 1.0
        sizes = self.sizes(self._scaled(point))[self.free]
        return math.sqrt(float(np.mean(np.square(sizes))))

    def _scaled(self, point: Point) -> FloatArray:
        """The blocks s_i R_i."""
        if isinstance(point, Estimate) and point.scales is not None:
            return np.asarray(self.of(point)[:, None, None] * point.rotations)
        return point.rotations

    def estimate(self, point: Lift, Q: FloatArray) -> Estimate:
        """That of rotations Q near the blocks of rank d; if no scale is known, the first is 1."""
        s = np.einsum("nab,nab->n", Q, point.rotations) / Q.shape[1]
        s = np.where(self.free, s, 1.0)
        if not (s > 0.0).all():
            raise NumericalError("a scale is not positive")
        t = translations_of(point)
        if self.in_mean_unit:
            unit = s[self.free][0]
            s, t = np.where(self.free, s / unit, 1.0), t / unit
        return Estimate(Q, t, scales=s)

    def check(self, estimate: Estimate) -> None:
        """Refuse an estimate whose known scales are others by an InputError."""
        if estimate.scales is None:
            if self.free.any():
                raise InputError("the estimate has no scales, but the graph's are unknown")
            return
        known = ~self.free & ~self.graph.is_point
        off = known & (np.abs(estimate.scales - 1.0) > 1e-9)
        if off.any():
            node = int(np.argmax(off))
            found = estimate.scales[node]
            raise InputError(f"node {node} has scale 1 in the graph, {found:g} in the estimate")

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on the cost of stored rotations, scales and translations.

        The lower bound also holds for quaternions rounded from the rotations.
        """
        graph, s, (i, j) = self.graph, self.of(estimate), self.graph.edges.T
        point = Lift(s[:, None, None] * estimate.rotations, estimate.translations)
        own, measured = map(so.rotation_defect, (estimate.rotations, graph.rotations))
        E = operators.rotation_residuals(self.form, point.rotations)
        r = operators.translation_residuals(self.form, point)
        sizes = np.concatenate([np.linalg.norm(E, axis=(1, 2)), np.linalg.norm(r, axis=1)])
        turned = (own + 32.0 * U) * s[j] + (own + measured + 32.0 * U) * graph.scales * s[i]
        # The rounding of t_j - t_i is relative to its size, at most r plus the lever.
        moved = (own + 32.0 * U) * s[i] * np.linalg.norm(graph.translations, axis=1)
        errors = np.concatenate([turned, moved])
        weights = np.concatenate([graph.kappa, graph.tau])
        low = weights * np.maximum(sizes * (1.0 - 32.0 * U) - 2.0 * errors, 0.0) ** 2
        high = weights * (sizes * (1.0 + 32.0 * U) + errors) ** 2
        # A few roundings within each term, and at most one per term in the sum, in any order.
        of_sum = (len(low) + 16) * 2.0 * U
        least, most = float(low.sum() * (1.0 - of_sum)), float(high.sum() * (1.0 + of_sum))
        if not self.in_mean_unit:
            return least, most
        mean, known = float(np.mean(np.square(s[self.free]))), int(self.free.sum())
        off = (known + 16.0) * 2.0 * U
        return least / mean * (1.0 - off), most / mean * (1.0 + off)

    def entry_errors(
        self, pattern: BlockPattern, multipliers: FloatArray, w: FloatArray
    ) -> FloatArray:
        """(N,) row sums of the rounding in S's entries, weighted by w.

        An entry that sums k products is off by at most k + 8 units of rounding of the sum of their
        sizes, plus the distance of measured rotations from SO(d).
        """
        graph = self.graph
        n, d, (i, j) = graph.num_nodes, graph.d, graph.edges.T
        kappa, tau, s = graph.kappa, np.abs(graph.tau), graph.scales
        t = np.abs(graph.translations)
        diagonal = np.zeros((n, d + 1, d + 1))
        diagonal[:, 0, 0] = operators.degrees(graph.edges, tau, n)
        diagonal[:, 0, 1:] = diagonal[:, 1:, 0] = scatter_sum(i, tau[:, None] * t, n)
        second = scatter_sum(i, tau[:, None, None] * t[:, :, None] * t[:, None, :], n)
        turning = scatter_sum(i, kappa * s**2, n) + scatter_sum(j, kappa, n)
        diagonal[:, 1:, 1:] = second + turning[:, None, None] * np.eye(d) + np.abs(multipliers)
        upper = np.zeros((graph.num_edges, d + 1, d + 1))
        upper[:, 0, 0] = tau
        upper[:, 1:, 0] = tau[:, None] * t
        defect = so.rotation_defect(graph.rotations) / (8.0 * U)
        upper[:, 1:, 1:] = (kappa * s)[:, None, None] * (np.abs(graph.rotations) + defect)
        sums = np.bincount(graph.edges.ravel(), minlength=n) + 8.0
        A = pattern.assemble(diagonal, upper, 1)
        rows = np.tile(sums[:, None], (1, d + 1))
        return np.asarray(1.001 * U * pattern.layout_of(A).pack(rows) * (A @ w))
