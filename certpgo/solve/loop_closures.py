"""Loop closures: relative rotations that are neither odometry nor needed to connect the nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Graph, Instance
from certpgo.graph.capabilities import require_capable
from certpgo.graph.edges import components_of
from certpgo.graph.graph import require_connected
from certpgo.graph.kinds import Kind
from certpgo.graph.succession import Succession, succession
from certpgo.graph.trees import minimum_spanning_tree
from certpgo.io.accept_paths import AnyPath, as_instance
from certpgo.linalg.arrays import BoolArray, IntArray
from certpgo.objective.quadratic import Quadratic


class Rotations(NamedTuple):
    """The relative rotations of an instance: their edges and nodes in it, order, and problem."""

    edges: IntArray
    nodes: IntArray
    order: Succession
    problem: Quadratic


def with_rotations(graph: Instance | Graph | AnyPath) -> tuple[Instance, Rotations]:
    """The instance, and its relative rotations."""
    instance = as_instance(graph, "a choice of loop closures")
    require_capable(instance.graph, "loop closures")
    require_connected(instance.measurements)
    edges = np.flatnonzero(instance.measurements.are(Kind.BETWEEN, Kind.ROTATION))
    nodes = np.unique(instance.graph.edges[edges])
    if not len(edges):
        raise GraphError(f"{instance.name}: no rotation is measured between poses")
    rotation = instance.graph.rotations_alone.with_edges(edges).subgraph(nodes)
    if not rotation.is_connected:
        raise GraphError(f"{instance.name}: rotations between poses do not connect them")
    return instance, Rotations(edges, nodes, succession(instance), Quadratic(rotation))


def loop_closures(rotations: Rotations) -> BoolArray:
    """(r,) relative rotations that are neither odometry nor needed to connect the nodes."""
    graph = rotations.problem.graph
    loops = ~rotations.order.are_steps(rotations.nodes[graph.edges])
    if components_of(graph.num_nodes, graph.edges[~loops]).max(initial=0) > 0:
        # Odometry is shorter than all others, so that the tree completes it.
        lengths = 1.0 / graph.kappa
        lengths = np.where(loops, lengths, 0.5 * lengths.min())
        tree = minimum_spanning_tree(graph, lengths)
        pair = np.sort(graph.edges, axis=1) @ np.array([graph.num_nodes, 1])
        order = np.lexsort((lengths, pair))
        first = order[np.unique(pair[order], return_index=True)[1]]
        joined = np.sort(np.column_stack(tree.nonzero()), axis=1) @ [graph.num_nodes, 1]
        loops[first[np.isin(pair[first], joined)]] = False
    return loops
