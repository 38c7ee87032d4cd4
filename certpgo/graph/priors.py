"""Measurements of single poses from a world, which is a node, and what they leave open."""

from __future__ import annotations

import math

import numpy as np

from certpgo.errors import GraphError, InputError
from certpgo.graph.edges import broadcast, components_of
from certpgo.graph.graph import has_matrix_weights
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.rotation_graph import RotationGraph
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: Positions this near to a plane, over their extent, determine no handedness.
FLAT = 0.02
#: Extents from the origin at which positions are far away.
FARAWAY = 8.0


def with_priors(
    graph: PoseGraph,
    nodes: IntArray,
    rotations: FloatArray | None = None,
    translations: FloatArray | None = None,
    *,
    kappa: FloatArray | float = 0.0,
    tau: FloatArray | float = 0.0,
) -> PoseGraph:
    """The graph with one more node, the world, from which some nodes are measured.

    The world is the last node, and an ordinary pose: in an estimate moved so that it is the
    identity (`Estimate.anchored`) the others are in the world's frame. Positions alone, such as
    GPS, have kappa = 0; attitudes alone have tau = 0.

    Parameters
    ----------
    graph : n poses, with isotropic weights
    nodes : (k,) that are measured; more than once if several measurements are of one
    rotations : (k, d, d) of theirs in the world; by default not measured
    translations : (k, d) of theirs in the world, metres; by default not measured
    kappa, tau : concentrations, (k,) or for all; 0 for what is not measured

    Raises
    ------
    GraphError
        As `PoseGraph`.
    InputError
        A weight without a measurement or the reverse; matrix weights, couplings or arms; or
        positions that are far from the origin and near to one another, whose bounds would be lost
        in rounding: subtract their mean first.

    Examples
    --------
    Positions of every other pose of a helix, to 5 cm:

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import helix
    >>> instance = helix(6, np.random.default_rng(0))
    >>> nodes = np.arange(0, 36, 2)
    >>> fixes = instance.truth.translations[nodes]
    >>> graph = certpgo.with_priors(instance.graph, nodes, translations=fixes, tau=0.05**-2)
    >>> answer = certpgo.solve(graph)
    >>> in_world = answer.estimate.anchored(36)
    >>> error = np.linalg.norm(in_world.translations[:36] - instance.truth.translations, axis=1)
    >>> print(answer.verdict.value, bool(error.max() < 0.1))
    CERTIFIED True
    """
    if has_matrix_weights(graph):
        raise InputError("priors are added before matrix weights, couplings or arms")
    nodes = np.asarray(nodes)
    if nodes.dtype.kind not in "iu":
        raise InputError("nodes are given by their numbers")
    for name, weights, values in (("kappa", kappa, rotations), ("tau", tau, translations)):
        if np.any(weights) != (values is not None):
            what = "rotations" if name == "kappa" else "translations"
            raise InputError(f"{name} and {what} are given together, or neither")
    k, d, rotation = len(nodes), graph.d, graph.rotation
    R = np.tile(np.eye(d), (k, 1, 1)) if rotations is None else np.asarray(rotations)
    t = np.zeros((k, d)) if translations is None else np.asarray(translations, dtype=np.float64)
    if translations is not None and (origin := origin_of(t[np.broadcast_to(tau, k) > 0.0])).any():
        raise InputError(
            f"the positions lie around {origin.tolist()}, far from the origin: subtract that first"
        )
    world = np.full(k, graph.num_nodes)
    joined = RotationGraph(
        graph.num_nodes + 1,
        np.concatenate([graph.edges, np.stack([world, nodes], axis=1)]),
        np.concatenate([rotation.rotations, R]),
        np.concatenate([rotation.kappa, broadcast(kappa, k)]),
    )
    weights = np.concatenate([graph.tau, broadcast(tau, k)])
    points = None if graph.points is None else np.append(graph.points, False)
    measured = np.concatenate([graph.translations, t])
    return PoseGraph(joined, measured, weights, points=points)


def origin_of(positions: FloatArray) -> FloatArray:
    """A point (d,) near positions that are far from the origin, else zeros.

    The objective's scale, and rounding, grow with the squares of positions. Subtracting the point
    is exact: it is a multiple of a power of two near the positions' extent.
    """
    d = positions.shape[1]
    if not len(positions):
        return np.zeros(d)
    middle = positions.mean(axis=0)
    extent = float(np.abs(positions - middle).max())
    unit = 2.0 ** math.ceil(math.log2(max(extent, 1.0)))
    if not np.abs(middle).max() > FARAWAY * unit:
        return np.zeros(d)
    return np.where(np.abs(middle) > FARAWAY * unit, np.rint(middle / unit) * unit, 0.0)


def require_determined(graph: PoseGraph) -> None:
    """Refuse a graph whose measurements leave a node free, by a GraphError that names it."""
    joined = components_of(graph.num_nodes, graph.edges[graph.tau > 0.0])
    if joined.max(initial=0) > 0:
        sizes = np.bincount(joined)
        node = int(np.argmax(joined != np.argmax(sizes)))
        raise GraphError(
            f"translations are measured within {len(sizes)} parts of the graph, but not between "
            f"them: the position of node {node} is free"
        )
    free = np.zeros(graph.num_nodes, dtype=bool)
    free[graph.pose_nodes] = True
    for end, holds in zip(graph.edges.T, levers(graph), strict=True):
        free[end[holds]] = False
    if free.any():
        raise GraphError(f"no measurement determines the rotation of node {int(np.argmax(free))}")


def levers(graph: PoseGraph) -> tuple[BoolArray, BoolArray]:
    """(m,) which edges hold the rotation of their first node, and of their second."""
    turned = graph.rotation.kappa > 0.0
    moved = graph.tau > 0.0
    first = turned | (moved & graph.translations.any(axis=1))
    return first, turned if graph.arms is None else turned | (moved & graph.arms.any(axis=1))


def handedness_is_open(graph: PoseGraph) -> bool:
    """Whether a part of a graph in space is joined to the rest by positions in a plane alone.

    A mirror image of the part fits these as well, and the relaxation allows it.
    """
    if graph.d == 2 or not graph.is_partial:
        return False
    turned = graph.rotation.kappa > 0.0
    part = components_of(graph.num_nodes, graph.edges[turned])
    between = part[graph.edges[:, 0]] != part[graph.edges[:, 1]]
    i = graph.edges[between, 0]
    for label in np.unique(part[i]):
        seen = graph.translations[between][part[i] == label]
        # In the frame of one node; the frames of several do not lie in one plane.
        if len(np.unique(i[part[i] == label])) > 1:
            continue
        extent = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
        if len(extent) < 3 or extent[2] <= FLAT * extent[0]:
            return True
    return False
