"""The sums over edges of which normal equations consist, compiled for the costs of the package."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.angle_functions import C
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.operators import lever

#: What tells the kernel's residuals apart: the series of logarithms.
_SERIES = {"quaternion": None, "logarithm": np.array(C)}


def relative(graph: PoseGraph, point: Point) -> tuple[FloatArray, FloatArray]:
    """(m, d) vectors v = R_i^T (t_j + R_j a - t_i) and (m, d, d) rotations Q = R_i^T R_j."""
    i, j = graph.edges.T
    R, t = point.rotations, translations_of(point)
    back = np.swapaxes(R[i], 1, 2)
    v, Q = (back @ (t[j] - t[i])[:, :, None])[:, :, 0], back @ R[j]
    return v if graph.arms is None else v + (Q @ graph.arms[:, :, None])[:, :, 0], Q


class EdgeEquations:
    """Derivatives of a cost at an estimate, over the coordinates of its poses.

    Poses move by world-frame translations, then body-frame rotations: p coordinates.
    """

    def __init__(self, cost: EdgeCost, n: int) -> None:
        self._cost, self._n = cost, n
        # Not inherited: what derives from a cost may have another residual.
        kind: str = vars(type(cost)).get("compiled_residual", "")
        self._series = _SERIES.get(kind)
        armed = cost.graph.arms is not None
        self._is_compiled = compiled.AVAILABLE and kind in _SERIES and not armed

    def first(self, point: Estimate) -> tuple[float, FloatArray]:
        """The cost and half its gradient (n, p)."""
        if not self._is_compiled:
            return self._first_in_numpy(point)
        terms, gradient = np.empty(self._cost.graph.num_edges), np.zeros((self._n, self._p))
        compiled.kernel.slopes(*self._arrays, *_poses(point), terms, gradient)
        return float(terms.sum()), gradient

    def second(self, point: Estimate) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Gauss-Newton matrix of half the cost: (n, p, p), and of edges (m, p, p)."""
        if not self._is_compiled:
            return self._second_in_numpy(point)
        p = self._p
        diagonal, upper = np.zeros((self._n, p, p)), np.empty((self._cost.graph.num_edges, p, p))
        compiled.kernel.curvatures(*self._arrays, *_poses(point), diagonal, upper)
        return diagonal, upper

    def _first_in_numpy(self, point: Estimate) -> tuple[float, FloatArray]:
        i, j = self._cost.graph.edges.T
        e, at_i, at_j = self._linearized(point)
        weighted = self._cost.weights @ e[:, :, None]
        gradient = scatter_sum(i, (np.swapaxes(at_i, 1, 2) @ weighted)[:, :, 0], self._n)
        gradient += scatter_sum(j, (np.swapaxes(at_j, 1, 2) @ weighted)[:, :, 0], self._n)
        return float((e[:, None, :] @ weighted).sum()), gradient

    def _second_in_numpy(self, point: Estimate) -> tuple[FloatArray, FloatArray]:
        i, j = self._cost.graph.edges.T
        _, at_i, at_j = self._linearized(point)
        heavy_i, heavy_j = self._cost.weights @ at_i, self._cost.weights @ at_j
        diagonal = scatter_sum(i, np.swapaxes(at_i, 1, 2) @ heavy_i, self._n)
        diagonal += scatter_sum(j, np.swapaxes(at_j, 1, 2) @ heavy_j, self._n)
        return diagonal, np.swapaxes(at_i, 1, 2) @ heavy_j

    def _linearized(self, point: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (m, k) and their derivatives by the first and the second pose, (m, k, p)."""
        graph = self._cost.graph
        v, Q = relative(graph, point)
        e, in_v, in_w = self._cost.linearized(v, Q)
        # v moves by R_i^T (dt_j - dt_i) + v x w_i - Q (a x w_j), and Q by Q exp(w_j - Q^T w_i).
        by_t = in_v @ np.swapaxes(point.rotations[graph.edges[:, 0]], 1, 2)
        turned = in_w if v.shape[1] == 2 else in_w @ np.swapaxes(Q, 1, 2)
        at_i = np.concatenate([-by_t, in_v @ lever(v) - turned], axis=2)
        if graph.arms is not None:
            in_w = in_w - in_v @ Q @ lever(graph.arms)
        return e, at_i, np.concatenate([by_t, in_w], axis=2)

    @property
    def _p(self) -> int:
        d = self._cost.graph.d
        return d * (d + 1) // 2

    @cached_property
    def _arrays(self) -> tuple[tuple[Any, ...], int, FloatArray, FloatArray | None]:
        graph, weights = self._cost.graph, np.ascontiguousarray(self._cost.weights)
        rotation, moved = graph.rotation, (graph.tau, graph.translations)
        edges = rotation.edges, rotation.rotations, None, rotation.kappa, *moved, None
        arrays = tuple(None if x is None else np.ascontiguousarray(x) for x in edges)
        return arrays, graph.d, weights, self._series


def _poses(point: Estimate) -> tuple[FloatArray, FloatArray]:
    return np.ascontiguousarray(point.rotations), np.ascontiguousarray(translations_of(point))
