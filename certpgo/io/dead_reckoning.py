"""Relative poses integrated along a spanning tree, for iSAM's ground-truth files."""

from __future__ import annotations

from certpgo.graph import Instance
from certpgo.graph.graph import require_connected
from certpgo.graph.trees import compose, spanning_tree
from certpgo.io.format import LabelledPoses


def integrated(instance: Instance) -> LabelledPoses:
    """Poses relative to the node of smallest id, from noise-free relative poses.

    A breadth-first tree has short chains, hence little accumulated rounding.
    """
    graph = instance.graph
    require_connected(graph)
    poses = compose(graph, spanning_tree(graph))
    return LabelledPoses(poses.rotations, poses.translations, ids=instance.ids)
