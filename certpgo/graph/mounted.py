"""Measurements between frames that are fixed to the nodes, as measurements of the nodes.

A frame is at (A, a) on node i, another at (B, b) on node j: (R~, t~) ~ (A, a)^-1 T_i^-1 T_j (B, b).
Then A R~ B^T is the rotation from i to j, a + A t~ is where the frame on j is seen from i, and b is
the arm. Under F nothing else changes. The unexplained pose (E, y) of other costs is turned by B^T
as a whole, and so are their residuals: the information is B Omega B^T by blocks. That of positions
alone is in the frame of node i, and so A T A^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph.graph import Graph
from certpgo.linalg.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Frames:
    """Where frames are on nodes.

    Attributes
    ----------
    rotations, translations : (m, d, d) and (m, d)
    """

    rotations: FloatArray
    translations: FloatArray

    @classmethod
    def none(cls, m: int, d: int) -> Frames:
        """Those of the nodes themselves."""
        return cls(np.tile(np.eye(d), (m, 1, 1)), np.zeros((m, d)))

    def subset(self, chosen: IntArray) -> Frames:
        """Some of them, by index."""
        return Frames(self.rotations[chosen], self.translations[chosen])


def mounted(graph: Graph, edges: IntArray, first: Frames, second: Frames) -> Graph:
    """The graph between other nodes, which carry the nodes that it is between.

    Parameters
    ----------
    graph : between frames that are each on a node
    edges : (m, 2) the nodes that carry the frames
    first, second : where those of the first and second nodes are
    """
    A, B = first.rotations, second.rotations
    R = A @ graph.rotations @ np.swapaxes(B, 1, 2)
    N = graph.couplings
    if N is not None:
        N = A @ N @ np.swapaxes(B, 1, 2)
    moved = replace(graph, edges=edges, rotations=R, couplings=N)
    if not graph.has_positions:
        return moved
    arms = second.translations
    if graph.arms is not None:
        arms = arms + _turned(B, graph.arms)
    frames = np.where(graph.measures_rotation[:, None, None], B, A)
    return replace(
        moved,
        translations=first.translations + _turned(A, graph.translations),
        arms=arms if arms.any() else None,
        information=graph.information and graph.information.turned(frames),
    )


def _turned(R: FloatArray, t: FloatArray) -> FloatArray:
    return np.asarray((R @ t[:, :, None])[:, :, 0])
