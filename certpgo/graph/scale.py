"""W, the scale of a cost, by which verdicts tell a cost of almost zero from rounding."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from certpgo.graph.graph import Graph
from certpgo.linalg.arrays import BoolArray, FloatArray

#: How many times the lower quartile a measurement counts at most: no rigid mount makes W its own.
MOST = 1024.0


@dataclass(frozen=True)
class Scale:
    """What W is made of; those of several sets of measurements add up.

    A measurement counts at most `MOST` times the lower quartile of all. How far positions are from
    the world's origin says nothing of how well measurements can agree. So a position counts by the
    typical length of a relative measurement, if that is less, and by its own only where nothing is
    relative.

    Attributes
    ----------
    turn : (m,) rotational weights
    move : (m,) translational weights
    squares : (m,) squared lengths
    is_far : (m,) which measure positions in a world
    """

    turn: FloatArray
    move: FloatArray
    squares: FloatArray
    is_far: BoolArray

    @staticmethod
    def none() -> Scale:
        """That of no measurements."""
        return Scale(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool))

    @staticmethod
    def of(graph: Graph) -> Scale:
        """That of F: of kappa, and of tau |t_ij|^2."""
        return Scale.weighed(graph, graph.kappa, graph.tau)

    @staticmethod
    def informed(graph: Graph) -> Scale:
        """That of other programs' costs: of the mean information, of translations |t_ij|^2 times.

        Raises
        ------
        GraphError
            There are no information matrices.
        """
        diagonal = np.abs(np.diagonal(graph.information_matrices, axis1=1, axis2=2))
        turn, move = diagonal[:, graph.d :].mean(axis=1), diagonal[:, : graph.d].mean(axis=1)
        return Scale.weighed(graph, turn, move)

    @staticmethod
    def weighed(graph: Graph, turn: FloatArray, move: FloatArray) -> Scale:
        """That of measurements with other weights (m,) of rotations and of translations."""
        squares = np.einsum("ma,ma->m", graph.translations, graph.translations)
        if graph.arms is not None:
            squares = squares + np.einsum("ma,ma->m", graph.arms, graph.arms)
        near = np.zeros(graph.num_edges, dtype=bool)
        return Scale(turn, move, squares, near if graph.absolute is None else graph.absolute)

    def __add__(self, other: Scale) -> Scale:
        of_both = ((getattr(one, of.name) for one in (self, other)) for of in fields(self))
        return Scale(*(np.concatenate(list(pair)) for pair in of_both))

    @cached_property
    def total(self) -> float:
        """W."""
        far, near, move = self.is_far, ~self.is_far, _limited(self.move)
        lever = _limited(move[near] * self.squares[near])
        moved = float(lever.sum())
        relative = float(_limited(self.turn).sum()) + moved
        if not relative > 0.0:
            return float(_limited(move[far] * self.squares[far]).sum())
        typical = moved / float(move[near].sum()) if moved > 0.0 else 0.0
        by_length = float(move[far].sum()) * typical
        return relative + min(float((move[far] * self.squares[far]).sum()), by_length)


def typical(weights: FloatArray) -> float:
    """The lower quartile of the weights above zero; infinite without any."""
    counted = weights[weights > 0.0]
    if not len(counted):
        return np.inf
    return float(np.partition(counted, len(counted) // 4)[len(counted) // 4])


def _limited(weights: FloatArray) -> FloatArray:
    """Weights, none more than `MOST` times what is typical, but for those beyond all range."""
    if len(weights) and 0.0 < weights.max() <= MOST * weights.min():
        return weights
    limited = np.minimum(weights, MOST * typical(weights))
    return np.where(np.isinf(weights), weights, limited)
