"""Relative poses integrated along a spanning tree: how iSAM's ground-truth files are meant."""

from __future__ import annotations

from certpgo.graph import Instance
from certpgo.graph.graph import require_connected
from certpgo.graph.trees import compose, spanning_tree
from certpgo.io.format import LabelledPoses


def integrated(instance: Instance) -> LabelledPoses:
    """Poses relative to the node of smallest id, from noise-free relative poses.

    A breadth-first tree keeps the chains, and with them the file's rounding, short.

    Raises
    ------
    GraphError
        The graph is not connected.
    """
    graph = instance.graph
    require_connected(graph)
    poses = compose(graph, spanning_tree(graph))
    return LabelledPoses(poses.rotations, poses.translations, ids=instance.ids)
