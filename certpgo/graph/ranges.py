"""Measured distances between nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np

from certpgo.errors import GraphError, require
from certpgo.graph.display import Brief
from certpgo.graph.edges import check_edges, check_weights, edge_name, induced
from certpgo.linalg.arrays import FloatArray, IntArray, frozen_floats, frozen_indices


@dataclass(frozen=True, eq=False, repr=False)
class Ranges(Brief):
    """Distances between the positions of nodes, whose cost is weight (distance - |t_j - t_i|)^2.

    Attributes
    ----------
    num_nodes : number n of nodes of the graph that they belong to
    edges : (k, 2) node pairs
    distances : (k,) metres, not negative
    weights : (k,) inverse variances, 1/m^2, in the range of those of `certpgo.PoseGraph`

    Raises
    ------
    GraphError
        An index out of range, a pair of equal nodes, a distance that is negative or not finite, or
        a weight out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Ranges
    >>> Ranges(3, np.array([[0, 2], [1, 2]]), np.array([5.0, 4.0]), np.ones(2)).num_edges
    2
    """

    num_nodes: int
    edges: IntArray
    distances: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges", frozen_indices(self.edges))
        object.__setattr__(self, "distances", frozen_floats(self.distances))
        object.__setattr__(self, "weights", frozen_floats(self.weights))
        require(self.num_nodes, Integral, "a number of nodes")
        k = len(self.edges)
        if self.edges.shape != (k, 2) or self.distances.shape != (k,):
            raise GraphError(f"ranges are (k, 2) pairs and (k,) distances, not {self.edges.shape}")
        check_edges(self.edges, self.num_nodes)
        check_weights("weight", self.weights, self.edges)
        bad = np.asarray(~((self.distances >= 0.0) & np.isfinite(self.distances)))
        if bad.any():
            raise GraphError(f"{edge_name(self.edges, bad)}: a distance is not negative and finite")

    @property
    def num_edges(self) -> int:
        """Number k of distances."""
        return len(self.edges)

    def lengths(self, positions: FloatArray) -> FloatArray:
        """(k,) distances |t_j - t_i| between positions (n, d), metres."""
        i, j = self.edges.T
        return np.asarray(np.linalg.norm(positions[j] - positions[i], axis=1))

    def scaled(self, factor: float) -> Ranges:
        """The same distances with weights times ``factor``."""
        return replace(self, weights=factor * self.weights)

    def between(self, nodes: IntArray) -> Ranges | None:
        """Those between some nodes (k,), numbered 0 ... k-1 in that order; None without any."""
        edges, inside = induced(self.num_nodes, self.edges, nodes)
        if not len(inside):
            return None
        return Ranges(len(nodes), edges, self.distances[inside], self.weights[inside])
