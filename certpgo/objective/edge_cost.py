"""The costs of programs on measured poses, one residual per edge.

With the measured (R~, t~), y = R~^T (v - t~) and E = R~^T Q are the translation and rotation of
what the measurement leaves unexplained, in the frame of the measured pose.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Graph
from certpgo.graph.edges import FAR
from certpgo.graph.information import RotationAbout, unmeasured
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.term import EdgeTerm


@dataclass(frozen=True, eq=False)
class EdgeCost(EdgeTerm):
    """The cost of a program on the edges of a graph: the term of measured poses.

    Attributes
    ----------
    graph : the measurements with their information matrices; a cost has no other weights, so that
        scaling and removing measurements need to know the graph alone

    Raises
    ------
    GraphError
        They have none, or entries beyond the range of weights.
    """

    #: Name in options and reports.
    name: ClassVar[str]
    #: Whether the checker knows it.
    provable: ClassVar[bool] = False
    #: Whether it is of positions and of rotations alone, too, and what joins its title to others.
    takes_partial: ClassVar[bool] = False
    conjunction: ClassVar[str] = ", and of"
    #: What rotational information in space is of: a ``"tangent"`` vector, or the vector part of a
    #: ``"quaternion"``, which is half of it.
    rotation_information: ClassVar[RotationAbout] = "tangent"

    def __post_init__(self) -> None:
        if self.graph.blocks:
            raise GraphError("a cost of edges takes no other measurements: see `Sum`")
        if not (np.abs(self.graph.information_matrices) < FAR).all():
            raise GraphError(f"information must be finite, with entries below {FAR:.2g}")

    @property
    def turned_share(self) -> float:
        """The least ratio of the squared rotational residual to |Q - R|_F^2; 0 if not known.

        Where it is known, translational residuals are no shorter than y.
        """
        return 0.0

    @property
    @abstractmethod
    def title(self) -> str:
        """What it is, in the words of the program's users."""

    @property
    def is_definite(self) -> BoolArray:
        """(m,) which measurements have a cost that grows with all of their residuals."""
        return self.graph.is_definite

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each edge measures of a rotation, and (m,) of a translation."""
        stated, d = ~unmeasured(self.weights), self.graph.d
        return stated[:, d:].sum(axis=1), stated[:, :d].sum(axis=1)

    @property
    def weights(self) -> FloatArray:
        """(m, k, k) weights W of the residuals: by default the information."""
        return self.informed(self.graph.information_matrices)

    def informed(self, information: FloatArray) -> FloatArray:
        """(m, k, k) weights W if these were the information matrices."""
        return information

    @cached_property
    def measured(self) -> Ball:
        """(m, d, d) the rotations nearest to the measured matrices, which are the data."""
        R = self.graph.rotations
        return Ball.within(R, rotation_defect(R))

    def unexplained(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Translations y (m, d) and rotations E (m, d, d) between measured and given poses."""
        back = np.swapaxes(self.graph.rotations, 1, 2)
        y = (back @ (v - self.graph.translations)[:, :, None])[:, :, 0]
        return y, back @ Q

    def bend(self, v: FloatArray) -> FloatArray:
        """(m,) y^T T y for moves v of the translations, T of the information."""
        y = (np.swapaxes(self.graph.rotations, 1, 2) @ v[:, :, None])[:, :, 0]
        T = self.graph.information_matrices[:, : self.graph.d, : self.graph.d]
        return np.asarray(np.einsum("ma,mab,mb->m", y, T, y))

    def relaxed(self) -> Self | None:
        """A cost nowhere above this one that may have a bound where this one has none."""
        return None

    def on(self, graph: Graph | None) -> Self | None:
        """The same cost on another graph, if there is one."""
        return None if graph is None else replace(self, graph=graph)
