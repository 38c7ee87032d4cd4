"""Parts of an instance: components, subsets of nodes, the rotations alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.dataset import Instance
from certpgo.graph.graph import require_connected
from certpgo.graph.held import with_held
from certpgo.graph.priors import placing
from certpgo.linalg.arrays import BoolArray, IntArray, numbered

#: How to treat a disconnected graph: refuse it, solve each component, or the largest only.
Components = Literal["refuse", "each", "largest"]


def rotations_alone(instance: Instance) -> Instance:
    """The instance without translations."""
    if not instance.graph.has_positions:
        return instance
    truth = None if instance.truth is None else instance.truth.with_translations(None)
    numbers, graph = instance.numbers, instance.graph.rotations_alone
    if numbers is not None:  # those of distances come last
        numbers = numbers[: graph.num_edges]
    alone = replace(instance, graph=graph, truth=truth, initial=None, numbers=numbers)
    released = instance.released
    if released is None:
        return alone
    values = released.initial and released.initial.with_translations(None)  # where nodes are held
    return replace(alone, released=replace(rotations_alone(released), initial=values))


def connected_parts(instance: Instance, components: Components) -> list[Instance]:
    """The connected components to solve, largest first, without isolated nodes.

    Raises
    ------
    GraphError
        The graph is disconnected, and ``components`` is ``"refuse"``.
    """
    measured = instance.measurements
    if measured.is_connected:
        return [instance]
    if components == "refuse":
        require_connected(measured)
    sizes = np.array(measured.component_sizes)
    by_size = [int(label) for label in np.argsort(-sizes, kind="stable") if sizes[label] > 1]
    return [
        component(instance, label) for label in by_size[: 1 if components == "largest" else None]
    ]


def require_pose(name: int | None, parts: Sequence[Instance], called: str) -> None:
    """Refuse an id of no pose of any part.

    Parameters
    ----------
    name : the id; None for none
    called : the argument that it is of

    Raises
    ------
    InputError
        No part has such a pose.
    """
    if name is not None and all(part.pose_called(name) is None for part in parts):
        raise InputError(f"{called}: node {name} is none of the poses")


def component(instance: Instance, label: int) -> Instance:
    """One connected component of an instance."""
    nodes = np.flatnonzero(instance.measurements.components == label)
    first = int(instance.ids[nodes].min())
    return restricted(instance, nodes, f"{instance.name} [{len(nodes)} nodes from id {first}]")


def restricted(instance: Instance, nodes: IntArray, name: str) -> Instance:
    """The instance of a subset of nodes, ascending, and the edges between them."""
    if instance.released is not None:
        return with_held(restricted(instance.released, nodes, name))
    graph = instance.graph
    inside = np.asarray(np.isin(graph.edges, nodes).all(axis=1))
    place = {int(node): k for k, node in enumerate(nodes)}
    times = instance.times_ns
    part = replace(
        instance,
        name=name,
        graph=graph.subgraph(nodes),
        ids=instance.ids[nodes],
        truth=None if instance.truth is None else instance.truth.subset(nodes),
        initial=None if instance.initial is None else instance.initial.subset(nodes),
        world=None if instance.world is None else place.get(instance.world),
        origin=instance.origin,
        fixed=tuple(place[node] for node in instance.fixed if node in place),
        names=tuple(instance.names[node] for node in nodes) if instance.names else (),
        outliers=None if instance.outliers is None else instance.outliers[inside],
        stated=_stated(instance, nodes, inside),
        numbers=instance.known_numbers[np.isin(instance.measurements.edges, nodes).all(axis=1)],
        apart=None if instance.apart is None else instance.apart[nodes],
        times_ns=None if times is None else times[nodes[nodes < len(times)]],
    )
    return _with_world_placed(part)


def _with_world_placed(part: Instance) -> Instance:
    """The part with its world somewhere, where what is left out had put it there."""
    graph, m = part.graph, part.graph.num_edges
    if part.world is None or not graph.has_positions:
        return part
    placed, outliers, stated = placing(graph, part.world), part.outliers, part.stated
    if placed is graph:
        return part
    return replace(
        part,
        graph=placed,
        outliers=None if outliers is None else np.append(outliers, False),
        stated=None if stated is None else np.concatenate([stated, placed.edges[m:]]),
        numbers=np.insert(part.known_numbers, m, -1),
    )


def _stated(instance: Instance, nodes: IntArray, inside: BoolArray) -> IntArray | None:
    """The nodes that the source names in some measurements; None if one of them is left out."""
    if instance.stated is None:
        return None
    stated = numbered(nodes, instance.stated[inside])
    return None if (stated < 0).any() else stated
