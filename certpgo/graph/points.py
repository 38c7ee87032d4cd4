"""Points of a graph, from the poses that see them."""

from __future__ import annotations

import numpy as np

from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph
from certpgo.linalg.arrays import IntArray
from certpgo.linalg.blocks import scatter_sum


def with_points(graph: Graph, poses: Estimate, nodes: IntArray) -> Estimate:
    """An estimate of all nodes: each point is at the mean, weighted by tau, of where it is seen.

    Parameters
    ----------
    poses : of the nodes that are poses, with translations
    nodes : (k,) those nodes; others that are no points, such as the world, stay at the identity,
        and points that no pose sees at the origin
    """
    n, d = graph.num_nodes, graph.d
    rotations, translations = np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d))
    rotations[nodes] = poses.rotations
    scales = None
    if poses.scales is not None:
        scales = np.ones(n)
        scales[nodes] = poses.scales
    if poses.translations is not None:
        translations[nodes] = poses.translations
    given = np.zeros(n, dtype=bool)
    given[nodes] = True
    seen = np.flatnonzero(given[graph.edges[:, 0]] & ~given[graph.edges[:, 1]])
    if not len(seen):
        return Estimate(rotations, translations, scales=scales)
    i, j = graph.edges[seen].T
    steps = (rotations[i] @ graph.translations[seen][:, :, None])[:, :, 0]
    there = translations[i] + (steps if scales is None else scales[i, None] * steps)
    tau = graph.tau[seen]
    total = scatter_sum(j, tau, n)
    points = np.flatnonzero(total > 0.0)
    summed = scatter_sum(j, tau[:, None] * there, n)
    translations[points] = summed[points] / total[points, None]
    return Estimate(rotations, translations, scales=scales)
