"""What the nodes of measurements are called in a session."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence

from certpgo.errors import InputError, kind_of
from certpgo.graph import Graph, Instance
from certpgo.graph.capabilities import require_capable
from certpgo.graph.held import refuse_held
from certpgo.graph.labels import WORLD, Label, in_order
from certpgo.linalg.arrays import FloatArray, IntArray


def labels_of(measurements: object, nodes: Sequence[Label] | None) -> Sequence[Label]:
    """The names of the nodes of measurements; that of an instance's world is `WORLD`.

    Raises
    ------
    InputError
        These are no measurements that a session takes, or have held poses, or not one name per
        node, or edges lead to the world.
    """
    own: Sequence[Label]
    graph, world = measurements, None
    if isinstance(measurements, Instance):
        refuse_held(measurements)
        graph, world, own = measurements.graph, measurements.world, measurements.labels
    elif isinstance(measurements, Graph):
        own = range(measurements.num_nodes)
    if not isinstance(graph, Graph):
        raise InputError(f"a session takes graphs and instances, not {kind_of(measurements)}")
    require_capable(graph, "session")
    if nodes is not None and (isinstance(nodes, str) or not isinstance(nodes, Iterable)):
        raise InputError(f"the names of the nodes expected, not {kind_of(nodes)}")
    names = list(own if nodes is None else nodes)
    if not all(isinstance(name, Hashable) for name in names):
        raise InputError("names of nodes are numbers, words or the like, not lists")
    if world is not None and len(names) == len(own):
        names[world] = WORLD
    if len(names) != len(own) or len(set(names)) < len(names):
        raise InputError(f"{len(own)} different names are expected, one per node")
    if WORLD in names and (graph.edges[:, 1] == names.index(WORLD)).any():
        raise InputError("edges leave the world, and none leads to it")
    return names


def instance_of(
    name: str, graph: Graph, labels: Sequence[Label], origin: FloatArray | None
) -> tuple[Instance, IntArray]:
    """The instance of measurements, and the nodes in its order."""
    order = in_order(labels)
    named = [labels[k] for k in order.tolist()]
    return Instance.labelled(name, graph.subgraph(order), named, origin=origin), order
