"""Graphs with preintegrated measurements of an inertial sensor."""

from __future__ import annotations

import numpy as np

from certpgo.errors import GraphError, InputError
from certpgo.graph.concatenate import joined
from certpgo.graph.constructors import PoseGraph, RotationGraph
from certpgo.graph.edges import broadcast, check_edges
from certpgo.graph.graph import Graph, require_positions
from certpgo.graph.preintegrated import LARGEST, Preintegrated
from certpgo.graph.priors import stated_by
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_indices

#: Gravity in a world whose last axis points up, m/s^2.
GRAVITY = np.array([0.0, 0.0, -9.80665])


def with_preintegrated(
    graph: Graph,
    pairs: IntArray,
    seconds: FloatArray,
    rotations: FloatArray,
    velocity_steps: FloatArray,
    position_steps: FloatArray,
    *,
    kappa: FloatArray | float,
    weights: FloatArray,
    lags: FloatArray | float = 0.0,
    gravity: FloatArray = GRAVITY,
    world: int | None = None,
) -> Graph:
    """The graph with preintegrated measurements of an inertial sensor whose biases are known.

    Each pose that is measured gets one more node, a point: where it would be after a unit of time.
    `Preintegrated.velocities` reads its velocity from an estimate. The relative rotations become
    edges.

    Gravity is given in the frame of the world, which is the last node: if nothing else is measured
    in it, only its length is used. The world is put at the first pose, by one more edge that is
    `Graph.assumed`, and no measurement.

    Parameters
    ----------
    graph : n poses in space
    pairs : (k, 2) poses i and j
    seconds : (k,) times between them
    rotations, velocity_steps, position_steps : (k, 3, 3), (k, 3) and (k, 3) what is integrated
        without gravity, in the frame of pose i at the given biases; metres and m/s
    kappa : concentrations of the rotations, (k,) or for all
    weights : (k, 2), or (2,) for all: inverse variances of each coordinate of e_v and e_p
    lags : (k,) or for all, seconds, see `Preintegrated`
    gravity : (3,) in the frame of the world, m/s^2
    world : the node that is the world, if the graph has it already

    Raises
    ------
    GraphError
        As `Preintegrated` and `certpgo.PoseGraph`.
    InputError
        A graph in the plane, of rotations alone, with unknown scales or couplings, or one that has
        preintegrated measurements already.

    Examples
    --------
    A body that falls for four seconds, and is seen where it began:

    >>> import numpy as np
    >>> import certpgo
    >>> R, t = np.tile(np.eye(3), (1, 1, 1)), np.array([[0.0, 0.0, -78.4]])
    >>> rotation = certpgo.RotationGraph(3, [[0, 2]], R, kappa=[100.0])
    >>> graph = certpgo.PoseGraph(rotation, t, tau=[100.0])
    >>> pairs, still, none = [[0, 1], [1, 2]], np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))
    >>> graph = certpgo.with_preintegrated(
    ...     graph, pairs, [2.0, 2.0], still, none, none, kappa=1e4, weights=[1e4, 1e4]
    ... )
    >>> graph.size_in_words
    '4 poses and 3 points, 3 edges, 3D'
    >>> answer = certpgo.solve(graph)
    >>> answer.verdict.value, graph.blocks[0].velocities(answer.estimate)[1].shape
    ('CERTIFIED', (3, 3))
    """
    require_positions(graph)
    if graph.d != 3 or graph.has_scales or graph.has_couplings:
        raise InputError(
            "preintegrated measurements are between poses in space, of known scale, and without "
            "matrix weights"
        )
    if any(type(block) is Preintegrated for block in graph.blocks):
        raise InputError("preintegrated measurements are given together")
    pairs = frozen_indices(pairs)
    k, n = len(pairs), graph.num_nodes
    if pairs.shape != (k, 2) or not k:
        raise InputError(f"pairs of poses are (k, 2), not {pairs.shape}")
    check_edges(pairs, n)
    if graph.is_point[pairs].any():
        raise InputError(f"node {pairs[graph.is_point[pairs]][0]}: a point has no frame")
    dt, lag = broadcast(seconds, k), broadcast(lags, k)
    poses, place = np.unique(pairs, return_inverse=True)
    place = n + place.reshape(k, 2)
    w = n + len(poses) if world is None else int(world)
    size = n + len(poses) + (world is None)
    nodes = np.column_stack([pairs[:, 0], place[:, 0], pairs[:, 1], place[:, 1], np.full(k, w)])
    longest = float(np.max(dt - lag, initial=0.0))
    if not 0.0 < np.min(dt) <= np.max(dt) < LARGEST:
        raise GraphError("preintegrated measurements take seconds that are finite and positive")
    unit = 2.0 ** np.ceil(np.log2(2.0 * longest)) if longest > 0.0 else 1.0
    block = Preintegrated(
        size,
        nodes,
        dt,
        np.full(k, unit),
        lag,
        velocity_steps,
        frozen_floats(position_steps) - lag[:, None] * frozen_floats(velocity_steps),
        np.tile(frozen_floats(gravity), (k, 1)),
        np.broadcast_to(np.asarray(weights, dtype=np.float64), (k, 2)),
    )
    points = np.zeros(size, dtype=bool)
    points[:n] = graph.is_point
    points[n : n + len(poses)] = True
    turned = PoseGraph(
        RotationGraph(size, pairs, rotations, broadcast(kappa, k)),
        np.zeros((k, 3)),
        np.zeros(k),
        points=points,
    )
    parts = [graph, stated_by(graph, turned)]
    if world is None:
        parts.append(stated_by(graph, _placed(size, w, int(pairs[0, 0]), points, block)))
    whole = joined(parts, size, points)
    return whole.with_blocks(*whole.blocks, block)


def _placed(n: int, world: int, node: int, points: BoolArray, block: Preintegrated) -> Graph:
    """The edge that puts the world at a node, which costs nothing."""
    rotation = RotationGraph(n, [[world, node]], np.eye(3)[None], np.zeros(1))  # type: ignore[arg-type]
    is_so, tau = np.array([True]), np.median(block.weights[:, 1])
    return PoseGraph(rotation, np.zeros((1, 3)), np.array([tau]), None, points, is_so, is_so)
