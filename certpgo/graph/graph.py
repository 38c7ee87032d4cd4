"""Measurement graphs: relative measurements between nodes, and their weights.

Arrays are validated at construction and read-only afterwards. The convention everywhere: R_i is
world <- body i, an edge (i, j) measures R_ij ~ R_i^T R_j and t_ij ~ R_i^T (t_j - t_i).
"""

from __future__ import annotations

from certpgo.errors import GraphError
from certpgo.graph.kinds import Measurements
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.rotation_graph import RotationGraph
from certpgo.graph.similarity_graph import SimilarityGraph

__all__ = [
    "Graph",
    "PoseGraph",
    "RotationGraph",
    "SimilarityGraph",
    "has_matrix_weights",
    "has_no_unit",
    "length_unit",
    "require_connected",
]

Graph = RotationGraph | PoseGraph


def require_connected(graph: Graph | Measurements) -> None:
    """Refuse a disconnected graph by a GraphError with the component sizes, largest first."""
    if not graph.is_connected:
        sizes = tuple(sorted(graph.component_sizes, reverse=True))
        shown = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
        raise GraphError(
            f"the graph has {len(sizes)} components of {shown} nodes; it must be connected",
            component_sizes=sizes,
        )


def has_matrix_weights(graph: Graph) -> bool:
    """Whether edges have couplings or arms, as those with matrix weights do."""
    return graph.arms is not None or graph.rotation.is_general


def has_no_unit(graph: object) -> bool:
    """Whether a graph has nodes of unknown scale alone, so that its map has no unit of length."""
    return bool(getattr(graph, "in_mean_unit", False))


def length_unit(graph: Graph) -> str:
    """The unit of lengths, in words: metres, but with nodes of unknown scale the map's own."""
    return "units" if graph.has_scales else "m"
