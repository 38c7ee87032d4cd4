"""Measurements of the same nodes, taken together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.graph import Graph
from certpgo.graph.information import joined_information
from certpgo.graph.kinds import Node
from certpgo.graph.observations import Observations
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray


def joined(
    graphs: Sequence[Graph],
    num_nodes: int,
    points: BoolArray | None = None,
    nodes: Sequence[IntArray] | None = None,
) -> Graph:
    """The graph of all their edges, in order.

    Parameters
    ----------
    graphs : at least one
    points : (num_nodes,) which nodes are points, if any is
    nodes : (n,) numbers of each graph's nodes in the joint graph, where those without measurements
        need none; by default their own

    Raises
    ------
    GraphError
        They are of different dimensions or kinds, or a node's scale is unknown in one and known in
        another.
    """
    require_one_make(map(make_of, graphs))
    own = nodes or [np.arange(graph.num_nodes) for graph in graphs]
    kinds = np.full(num_nodes, Node.POSE if graphs[0].has_positions else Node.ROTATION)
    if points is not None:
        kinds[points] = Node.POINT
    for graph, to in zip(graphs, own, strict=True):
        if graph.has_others:
            others = graph.is_other & (to >= 0)
            kinds[to[others]] = graph.nodes[others]
    kinds[_unknown_scales(graphs, own, num_nodes)] = Node.SCALED

    def rows(name: str) -> Any:
        return np.concatenate([getattr(graph, name) for graph in graphs])

    same = all(
        (kinds[to] == graph.nodes)[to >= 0].all() and not graph.is_signed
        for graph, to in zip(graphs, own, strict=True)
    )
    make = Graph.trusted if same else Graph
    return make(
        nodes=kinds,
        edges=np.concatenate([to[graph.edges] for graph, to in zip(graphs, own, strict=True)]),
        rotations=rows("rotations"),
        kappa=rows("kappa"),
        translations=rows("translations"),
        tau=rows("tau"),
        couplings=rows("coupled") if any(graph.has_couplings for graph in graphs) else None,
        arms=joined_arms(graphs, graphs[0].d),
        scales=rows("scales"),
        assumed=_flags([graph.assumed for graph in graphs], graphs),
        absolute=_flags([graph.absolute for graph in graphs], graphs),
        information=joined_information([graph.information for graph in graphs]),
        blocks=_blocks([graph.blocks for graph in graphs], num_nodes, own),
    )


def require_one_make(makes: Iterable[str]) -> None:
    """Refuse graphs that cannot be joined, by a GraphError, as `joined`."""
    found = sorted(set(makes))
    if len(found) > 1:
        raise GraphError(f"measurements of one kind are expected, not {' and '.join(found)}")


def make_of(graph: Graph) -> str:
    """What it measures, such as ``poses in 3D``: only graphs of one make can be joined."""
    return f"{'poses' if graph.has_positions else 'rotations'} in {graph.d}D"


def _unknown_scales(
    graphs: Sequence[Graph], nodes: Sequence[IntArray], num_nodes: int
) -> BoolArray:
    """(num_nodes,) which nodes have an unknown scale, as all graphs that measure them say."""
    free, known = np.zeros((2, num_nodes), dtype=bool)
    if not any(graph.has_scales for graph in graphs):
        return free
    for graph, to in zip(graphs, nodes, strict=True):
        ends = np.unique(graph.pairs)
        unknown = graph.free[ends]
        free[to[ends[unknown]]] = True
        known[to[ends[~unknown]]] = True
    if (free & known).any():
        node = int(np.argmax(free & known))
        # Known steps from it are in metres, others in its own unit: one of both would be misread.
        raise GraphError(f"node {node}: its scale is unknown to some measurements, known to others")
    return free


def _blocks(
    blocks: Sequence[tuple[Observations, ...]], num_nodes: int, nodes: Sequence[IntArray]
) -> tuple[Observations, ...]:
    """What else several graphs measure, whose nodes have these numbers, by kind."""
    known = [(block, to) for of, to in zip(blocks, nodes, strict=True) for block in of]
    kinds = dict.fromkeys(type(block) for block, _ in known)
    return tuple(
        kind.joined(num_nodes, *zip(*[of for of in known if type(of[0]) is kind], strict=True))
        for kind in kinds
    )


def _flags(known: Sequence[BoolArray | None], graphs: Sequence[Graph]) -> BoolArray | None:
    """(m,) flags of the edges of several graphs, None for none."""
    if all(flag is None for flag in known):
        return None
    flags = [
        np.zeros(graph.num_edges, dtype=bool) if flag is None else flag
        for flag, graph in zip(known, graphs, strict=True)
    ]
    return np.concatenate(flags)


def joined_arms(parts: Sequence[Any], d: int) -> FloatArray | None:
    """(m, d) arms of the edges of several graphs or terms; None where none has any."""
    if all(part.arms is None for part in parts):
        return None
    return np.concatenate(
        [np.zeros((len(p.edges), d)) if p.arms is None else p.arms for p in parts]
    )


def with_rows(graph: Graph, chosen: BoolArray) -> Graph:
    """The graph with some rows (m + k,): of its edges, then of its blocks."""
    of_edges, of_blocks = np.split(chosen, [graph.num_edges])
    return with_others(graph.with_edges(of_edges), of_blocks)


def with_others(graph: Graph, chosen: BoolArray) -> Graph:
    """The graph with all its edges, and some of the rows (k,) of its blocks."""
    if not graph.has_positions:
        return graph
    _, *of_blocks = by_rows(graph, np.append(np.ones(graph.num_edges, dtype=bool), chosen))
    kept = zip(graph.blocks, of_blocks, strict=True)
    return graph.with_blocks(*(block.subset(of) for block, of in kept if of.any()))


def by_rows(graph: Graph, values: FloatArray | BoolArray) -> list[Any]:
    """Values (m + k, ...) of all rows: those of the edges, then those of each block."""
    ends = np.cumsum([graph.num_edges, *(block.num_edges for block in graph.blocks)])
    return np.split(values, ends[:-1])
