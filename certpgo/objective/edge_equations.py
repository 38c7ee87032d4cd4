"""The sums over edges of which normal equations consist, compiled for the costs of the package."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import translations_of
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.angle_functions import cotangent
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.operators import lever
from certpgo.objective.term import Term, relative
from certpgo.objective.terms import Placed

#: What tells the kernel's residuals apart: the series of logarithms.
_SERIES: dict[str, Callable[[], FloatArray | None]] = {
    "quaternion": lambda: None,
    "logarithm": cotangent,
}


class EdgeEquations:
    """Derivatives of an objective's terms at an estimate, over the coordinates of its poses.

    Poses move by world-frame translations, then body-frame rotations: p coordinates.
    """

    def __init__(self, terms: Sequence[Placed], n: int) -> None:
        self._m = sum(len(rows) for rows, _ in terms)
        self._parts = [(rows, term.equations(n) or _Equations(term, n)) for rows, term in terms]

    @property
    def has_more(self) -> bool:
        """Whether second derivatives beyond those of Gauss and Newton are known."""
        return any(part.has_more for _, part in self._parts)

    def first(self, point: Estimate) -> tuple[float, FloatArray]:
        """The cost and half its gradient (n, p)."""
        found = [part.first(point) for _, part in self._parts]
        if len(found) == 1:
            return found[0]
        costs, gradients = zip(*found, strict=True)
        return math.fsum(costs), np.sum(gradients, axis=0)

    def second(self, point: Estimate, *, exact: bool = False) -> tuple[FloatArray, FloatArray]:
        """Blocks of the Gauss-Newton matrix of half the cost: (n, p, p), and of edges (m, p, p).

        Parameters
        ----------
        exact : whether to add the second derivatives that are known
        """
        found = [(rows, *part.second(point, exact)) for rows, part in self._parts]
        if len(found) == 1:
            return found[0][1:]
        upper = np.empty((self._m, *found[0][2].shape[1:]))
        for rows, _, values in found:
            upper[rows] = values
        return np.sum([diagonal for _, diagonal, _ in found], axis=0), upper


class _Equations:
    """The same of one term."""

    def __init__(self, term: Term, n: int) -> None:
        self._term, self._n = term, n
        # Not inherited: what derives from a cost may have another residual.
        kind: str = vars(type(term)).get("compiled_residual", "")
        self._series = _SERIES[kind]() if kind in _SERIES else None
        is_plain = isinstance(term, EdgeCost) and term.arms is None
        self._is_compiled = compiled.AVAILABLE and kind in _SERIES and is_plain

    def first(self, point: Estimate) -> tuple[float, FloatArray]:
        """The cost and half its gradient (n, p)."""
        if not self._is_compiled:
            return self._first_in_numpy(point)
        terms, gradient = np.empty(len(self._term.edges)), np.zeros((self._n, _coordinates(point)))
        compiled.kernel.slopes(*self._arrays, *_poses(point), terms, gradient)
        return float(terms.sum()), gradient

    @property
    def has_more(self) -> bool:
        """Whether there are second derivatives beyond those of Gauss and Newton."""
        return self._term.has_more

    def second(self, point: Estimate, exact: bool) -> tuple[FloatArray, FloatArray]:
        """As `EdgeEquations.second`."""
        if not self._is_compiled:
            return self._second_in_numpy(point, exact)
        p = _coordinates(point)
        diagonal, upper = np.zeros((self._n, p, p)), np.empty((len(self._term.edges), p, p))
        compiled.kernel.curvatures(*self._arrays, *_poses(point), diagonal, upper)
        return diagonal, upper

    def _first_in_numpy(self, point: Estimate) -> tuple[float, FloatArray]:
        i, j = self._term.edges.T
        e, at_i, at_j = linearized(self._term, point)
        costs, slopes, _ = self._term.weighed(e)
        weighted = slopes[:, :, None]
        gradient = scatter_sum(i, (np.swapaxes(at_i, 1, 2) @ weighted)[:, :, 0], self._n)
        gradient += scatter_sum(j, (np.swapaxes(at_j, 1, 2) @ weighted)[:, :, 0], self._n)
        return float(costs.sum()), gradient

    def _second_in_numpy(self, point: Estimate, exact: bool) -> tuple[FloatArray, FloatArray]:
        i, j = self._term.edges.T
        e, at_i, at_j = linearized(self._term, point)
        _, _, weights = self._term.weighed(e, exact=exact)
        heavy_i, heavy_j = weights @ at_i, weights @ at_j
        diagonal = scatter_sum(i, np.swapaxes(at_i, 1, 2) @ heavy_i, self._n)
        diagonal += scatter_sum(j, np.swapaxes(at_j, 1, 2) @ heavy_j, self._n)
        upper = np.swapaxes(at_i, 1, 2) @ heavy_j
        more = self._term.curved(relative(self._term.edges, None, point)[0]) if exact else None
        if more is not None:
            R, d = point.rotations[i], point.d
            more = R @ more @ np.swapaxes(R, 1, 2)
            diagonal[:, :d, :d] += scatter_sum(i, more, self._n) + scatter_sum(j, more, self._n)
            upper[:, :d, :d] -= more
        return diagonal, upper

    @cached_property
    def _arrays(self) -> tuple[tuple[Any, ...], int, FloatArray, FloatArray | None]:
        graph, weights = self._term.graph, np.ascontiguousarray(self._term.weights)  # type: ignore[attr-defined]
        of_edges = graph.edges, graph.rotations, None, graph.kappa
        edges = *of_edges, graph.tau, graph.translations, None
        arrays = tuple(None if x is None else np.ascontiguousarray(x) for x in edges)
        return arrays, graph.d, weights, self._series


def linearized(term: Term, point: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (m, k) and their derivatives by the first and the second pose, (m, k, p)."""
    edges, arms = term.edges, term.arms
    v, Q = term.relative(point)
    e, in_v, in_w = term.linearized(v, Q)
    # v moves by R_i^T (dt_j - dt_i) + v x w_i - Q (a x w_j), and Q by Q exp(w_j - Q^T w_i).
    by_t = in_v @ np.swapaxes(point.rotations[edges[:, 0]], 1, 2)
    turned = in_w if v.shape[1] == 2 else in_w @ np.swapaxes(Q, 1, 2)
    at_i = np.concatenate([-by_t, in_v @ lever(v) - turned], axis=2)
    if arms is not None:
        in_w = in_w - in_v @ Q @ lever(arms)
    if point.translations is None:
        return e, -turned, in_w
    return e, at_i, np.concatenate([by_t, in_w], axis=2)


def _coordinates(point: Estimate) -> int:
    d = point.d
    return d * (d - 1) // 2 if point.translations is None else d * (d + 1) // 2


def _poses(point: Estimate) -> tuple[FloatArray, FloatArray]:
    return np.ascontiguousarray(point.rotations), np.ascontiguousarray(translations_of(point))
