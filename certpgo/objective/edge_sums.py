"""The sums over all edges of which every iteration consists, compiled where possible.

`certpgo.objective.operators` has the formulas in NumPy, which serve without the compiled kernel.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.lift import Point, translations_of
from certpgo.linalg import compiled, so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective import operators

#: Largest rank that the kernel takes.
LARGEST_RANK = 32


class EdgeSums:
    """Gradients and Hessian blocks of a graph."""

    def __init__(self, graph: RotationGraph | PoseGraph) -> None:
        self._graph = graph
        poses = graph if isinstance(graph, PoseGraph) else None
        rotation = graph if isinstance(graph, RotationGraph) else graph.rotation
        measured, K = rotation.rotations, None
        if rotation.is_general:
            measured, K, _ = rotation.polar
        moved = (None, None, None) if poses is None else (poses.tau, poses.translations, poses.arms)
        arrays = rotation.edges, measured, K, rotation.kappa, *moved
        self._edges = tuple(None if x is None else np.ascontiguousarray(x) for x in arrays)

    def gradient(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Half the Euclidean gradient and the edges' terms, as `operators.gradient`."""
        n, r, d = point.rotations.shape
        if not compiled.AVAILABLE or r > LARGEST_RANK:
            return operators.gradient(self._graph, point)
        G = np.zeros((n, r, d + self._poses))
        return G, self._compiled(point, G)

    def terms(self, point: Point) -> FloatArray:
        """(m,) the edges' terms."""
        if not compiled.AVAILABLE or point.rotations.shape[1] > LARGEST_RANK:
            return operators.gradient(self._graph, point)[1]
        return self._compiled(point, None)

    @property
    def _poses(self) -> bool:
        return isinstance(self._graph, PoseGraph)

    def _compiled(self, point: Point, G: FloatArray | None) -> FloatArray:
        (_, r, d), t = point.rotations.shape, None
        if self._poses:
            t = np.ascontiguousarray(translations_of(point))
        terms = np.empty(self._graph.num_edges)
        R = np.ascontiguousarray(point.rotations)
        compiled.kernel.gradient(self._edges, d, r, R, t, G, terms)
        return terms

    def couplings(self, R: FloatArray) -> FloatArray:
        """Blocks (m, b, b) of the Hessian off its diagonal, as `operators.couplings`."""
        if not compiled.AVAILABLE:
            return operators.couplings(self._graph, R)
        d = self._graph.d
        b = so.tangent_dim(d) + (d if self._poses else 0)
        upper = np.empty((self._graph.num_edges, b, b))
        compiled.kernel.coupling(self._edges, d, np.ascontiguousarray(R), upper)
        return upper
