"""W, the scale of a cost, by which verdicts tell a cost of almost zero from rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.graph.graph import Graph
from certpgo.graph.pose_graph import PoseGraph
from certpgo.linalg.arrays import FloatArray


@dataclass(frozen=True)
class Scale:
    """The sums that W is made of; those of several sets of measurements add up.

    How far positions are from the world's origin says nothing of how well measurements can agree.
    So a position counts by the typical length of a relative measurement, if that is less, and by
    its own only where nothing is relative.

    Attributes
    ----------
    turned : of rotational weights
    moved, held : of translational weights times squared lengths, and of these weights alone, for
        measurements between nodes
    far, placed : the same for positions in a world
    """

    turned: float = 0.0
    moved: float = 0.0
    held: float = 0.0
    far: float = 0.0
    placed: float = 0.0

    @staticmethod
    def of(graph: Graph) -> Scale:
        """That of F: of kappa, and of tau |t_ij|^2."""
        if not isinstance(graph, PoseGraph):
            return Scale(float(graph.kappa.sum()))
        return Scale.weighed(graph, graph.rotation.kappa, graph.tau)

    @staticmethod
    def informed(graph: PoseGraph) -> Scale:
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
    def weighed(graph: PoseGraph, turn: FloatArray, move: FloatArray) -> Scale:
        """That of measurements with other weights (m,) of rotations and of translations."""
        squares = np.einsum("ma,ma->m", graph.translations, graph.translations)
        if graph.arms is not None:
            squares = squares + np.einsum("ma,ma->m", graph.arms, graph.arms)
        lever, total = move * squares, float(turn.sum())
        if graph.absolute is None:
            return Scale(total, float(lever.sum()), float(move.sum()))
        far, near = graph.absolute, ~graph.absolute
        sums = (float(x.sum()) for x in (lever[near], move[near], lever[far], move[far]))
        return Scale(total, *sums)

    def __add__(self, other: Scale) -> Scale:
        return Scale(
            self.turned + other.turned,
            self.moved + other.moved,
            self.held + other.held,
            self.far + other.far,
            self.placed + other.placed,
        )

    @property
    def total(self) -> float:
        """W."""
        relative = self.turned + self.moved
        if not relative > 0.0:
            return self.far
        typical = self.moved / self.held if self.moved > 0.0 else 0.0
        return relative + min(self.far, self.placed * typical)
