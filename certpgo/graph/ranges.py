"""Measured distances between nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.edges import check_weights, edge_name
from certpgo.graph.kinds import Kind
from certpgo.graph.observations import Observations
from certpgo.linalg.arrays import FloatArray, frozen_floats


@dataclass(frozen=True, eq=False, repr=False)
class Ranges(Observations):
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

    kind: ClassVar[Kind] = Kind.RANGE

    distances: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "distances", frozen_floats(self.distances))
        object.__setattr__(self, "weights", frozen_floats(self.weights))
        super().__post_init__()

    def _check_values(self) -> None:
        if self.distances.shape != (self.num_edges,):
            raise GraphError(f"distances must be {(self.num_edges,)}, not {self.distances.shape}")
        check_weights("weight", self.weights, self.edges)
        bad = np.asarray(~((self.distances >= 0.0) & np.isfinite(self.distances)))
        if bad.any():
            raise GraphError(f"{edge_name(self.edges, bad)}: a distance is not negative and finite")

    def lengths(self, positions: FloatArray) -> FloatArray:
        """(k,) distances |t_j - t_i| between positions (n, d), metres."""
        i, j = self.edges.T
        return np.asarray(np.linalg.norm(positions[j] - positions[i], axis=1))
