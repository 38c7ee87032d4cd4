"""Pose graphs whose distances have weights of either sign, and the points of their relaxations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.concatenate import joined_arms
from certpgo.graph.relaxed_point import Lift
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective import operators
from certpgo.objective.problem import PoseProblem
from certpgo.objective.term import Term


def with_rows_of(graph: Graph, terms: Sequence[Term]) -> Graph:
    """The edges of a graph, and for each row of terms one that measures zero.

    Its tau is what W counts of the row, and may have either sign in surrogates.
    """
    k = sum(len(term.edges) for term in terms)

    def padded(values: Any) -> Any:
        more = () if values is None else ((0, k), *((0, 0),) * (values.ndim - 1))
        return None if values is None else np.pad(values, more)

    return Graph(
        nodes=graph.nodes,
        edges=np.concatenate([graph.edges, *(term.edges for term in terms)]),
        rotations=np.concatenate([graph.rotations, np.tile(np.eye(graph.d), (k, 1, 1))]),
        kappa=padded(graph.kappa),
        translations=padded(graph.translations),
        tau=np.concatenate([graph.tau, *(term.scale.move for term in terms)]),
        couplings=padded(graph.couplings),
        arms=joined_arms([graph, *terms], graph.d),
        assumed=padded(graph.assumed),
        absolute=padded(graph.absolute),
        is_signed=True,
    )


class OrientedProblem(PoseProblem):
    """The problem in the plane over complex numbers, so that lifted rotations stay proper.

    A rotation is a unit complex number z, and R m = z m. Its relaxation has unit vectors z of C^k
    and positions in C^k; in real terms, for J the quarter turn of every complex coordinate, blocks
    [u, Ju] of St(2k, 2). As J R m = R J m,

        F = tr(E M E^T)  for  E_i = [t_i, J t_i, u_i, J u_i],

    with half the weight on either position: M has two rows for each. Since all points of this
    relaxation are points of the one over St(r, 2), its minimum is never lower.
    """

    dimensions = 2

    @cached_property
    def data_matrix(self) -> CSC:
        """M, (N, N), with four rows for poses and two for points."""
        graph, n = self.graph, self.n
        (i, _), half = graph.edges.T, 0.5 * graph.tau
        of_positions = np.eye(2)
        arm = half[:, None, None] * np.swapaxes(self.position_rows(graph.translations), 1, 2)
        square = half * (graph.translations**2).sum(axis=1)
        first = scatter_sum(i, arm, n)
        second = scatter_sum(i, square, n)[:, None, None] * of_positions
        diagonal = np.zeros((n, 4, 4))
        degrees = operators.degrees(graph.edges, half, n)
        diagonal[:, :2, :2] = degrees[:, None, None] * of_positions
        diagonal[:, 2:, :2] = first
        diagonal[:, :2, 2:] = np.swapaxes(first, 1, 2)
        diagonal[:, 2:, 2:] = operators.spread(graph) + second
        upper = np.zeros((graph.num_edges, 4, 4))
        upper[:, :2, :2] = -half[:, None, None] * of_positions
        upper[:, 2:, :2] = -arm
        upper[:, 2:, 2:] = -operators.coupled(graph)
        return self.pattern.assemble(diagonal, upper, 2)

    def position_rows(self, t: FloatArray) -> FloatArray:
        """(n, 2, r) t and Jt."""
        return np.stack([t, quarter_turn(t)], axis=1)

    def constrained(self, gradient: FloatArray, Y: FloatArray) -> FloatArray:
        """(n, 2, 2) multiples of the identity: a unit complex vector has one constraint."""
        half = 0.5 * np.trace(super().constrained(gradient, Y), axis1=1, axis2=2)
        return np.asarray(half[:, None, None] * np.eye(2))

    def tangent_basis(self, Y: FloatArray) -> FloatArray:
        """(n, q, r, 2) orthonormal [v, Jv] / sqrt(2), for v orthogonal to u."""
        u = Y[:, :, :1]
        v = np.swapaxes(np.linalg.qr(u, mode="complete")[0][:, :, 1:], 1, 2)
        return np.asarray(np.stack([v, quarter_turn(v)], axis=3) / np.sqrt(2.0))

    def tangent_dim(self, rank: int) -> int:
        """Number q of these."""
        return rank - 1

    def frames(self, basis: FloatArray) -> tuple[FloatArray, ...]:
        """The frame [b, Jb] of the complex line of the first vector b of a basis."""
        first = basis[:, 0]
        return (np.stack([first, quarter_turn(first)], axis=1),)

    def rising(self, rows: FloatArray) -> Lift:
        """The move into new dimensions along (n, 4) rows of the certificate matrix.

        They are the first coordinates of [t, Jt, u, Ju] in one complex dimension.
        """
        conjugate = np.array([1.0, -1.0])
        t, u = conjugate * rows[:, :2], conjugate * rows[:, 2:]
        return Lift(np.stack([u, quarter_turn(u)], axis=2), t)


def quarter_turn(x: FloatArray) -> FloatArray:
    """J x for vectors (..., 2k): i times each complex coordinate."""
    pairs = x.reshape(*x.shape[:-1], -1, 2)
    return np.stack([-pairs[..., 1], pairs[..., 0]], axis=-1).reshape(x.shape)
