"""Measurements of the same nodes, taken together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.capabilities import require_capable
from certpgo.graph.graph import Graph
from certpgo.graph.information import joined_information
from certpgo.graph.observations import Observations
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.rotation_graph import RotationGraph
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
        They are of different dimensions or kinds, or only some have couplings.
    """
    for graph in graphs:
        require_capable(graph, "joint graph")
    require_one_make(map(make_of, graphs))
    own = nodes or [np.arange(graph.num_nodes) for graph in graphs]
    rotations = [graph.rotation for graph in graphs]
    rotation = RotationGraph(
        num_nodes,
        np.concatenate([to[r.edges] for r, to in zip(rotations, own, strict=True)]),
        np.concatenate([r.rotations for r in rotations]),
        np.concatenate([r.kappa for r in rotations]),
        _all([r.couplings for r in rotations]),
    )
    poses = [graph for graph in graphs if graph.has_positions]
    if not poses:
        return rotation
    return PoseGraph(
        rotation,
        np.concatenate([graph.translations for graph in poses]),
        np.concatenate([graph.tau for graph in poses]),
        joined_arms(poses, poses[0].d),
        points,
        _flags([graph.assumed for graph in poses], poses),
        _flags([graph.absolute for graph in poses], poses),
        joined_information([graph.information for graph in poses]),
        _blocks([graph.blocks for graph in poses], num_nodes, own),
    )


def require_one_make(makes: Iterable[str]) -> None:
    """Refuse graphs that cannot be joined, by a GraphError, as `joined`."""
    found = sorted(set(makes))
    if len(found) > 1:
        raise GraphError(f"measurements of one kind are expected, not {' and '.join(found)}")


def make_of(graph: Graph) -> str:
    """What it measures, such as ``poses in 3D``: only graphs of one make can be joined."""
    said = f"{'poses' if graph.has_positions else 'rotations'} in {graph.d}D"
    return f"{said} with couplings" if graph.rotation.is_general else said


def _blocks(
    blocks: Sequence[tuple[Observations, ...]], num_nodes: int, nodes: Sequence[IntArray]
) -> tuple[Observations, ...]:
    """What else several graphs measure, whose nodes have these numbers, by kind."""
    known = [(block, to) for of, to in zip(blocks, nodes, strict=True) for block in of]
    kinds = dict.fromkeys(type(block) for block, _ in known)
    return tuple(
        Observations.joined(
            num_nodes, *zip(*[of for of in known if type(of[0]) is kind], strict=True)
        )
        for kind in kinds
    )


def _flags(known: Sequence[BoolArray | None], graphs: Sequence[PoseGraph]) -> BoolArray:
    """(m,) flags of the edges of several graphs, None for none."""
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


def _all(arrays: Sequence[FloatArray | None]) -> FloatArray | None:
    known = [array for array in arrays if array is not None]
    return np.concatenate(known) if known else None


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
