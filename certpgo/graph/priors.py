"""Measurements of single poses from a world, which is a node, and what they leave open."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from certpgo.errors import GraphError, InputError
from certpgo.graph.capabilities import require_capable
from certpgo.graph.concatenate import joined
from certpgo.graph.constructors import PoseGraph, RotationGraph, of_couplings
from certpgo.graph.edges import broadcast, check_weights, components_of
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph, require_positions
from certpgo.graph.kinds import places_world
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats

#: Positions this near to a plane, in the plane to a line, over their extent, leave handedness open.
FLAT = 0.02
#: Extents from the origin at which positions are far away.
FARAWAY = 8.0


def with_priors(
    graph: Graph,
    nodes: IntArray,
    rotations: FloatArray | None = None,
    translations: FloatArray | None = None,
    *,
    kappa: FloatArray | float = 0.0,
    tau: FloatArray | float = 0.0,
    world: int | None = None,
) -> Graph:
    """The graph with one more node, the world, from which some nodes are measured.

    The world is the last node, and an ordinary pose: in an estimate moved so that it is the
    identity (`Estimate.anchored`) the others are in the world's frame. Positions alone, such as
    GPS, have kappa = 0; attitudes alone have tau = 0.

    Where no position is measured, the world is put at the first node, by one more edge that is
    `Graph.assumed`, and no measurement.

    The world's scale is known. Where no other is, its unit is that of the map from then on, and of
    the cost.

    Parameters
    ----------
    graph : n poses, with isotropic weights
    nodes : (k,) that are measured; more than once if several measurements are of one
    rotations : (k, d, d) of theirs in the world; by default not measured
    translations : (k, d) of theirs in the world, metres; by default not measured
    kappa, tau : concentrations, (k,) or for all; 0 for what is not measured
    world : the node that is the world, if the graph has it already

    Raises
    ------
    GraphError
        As `PoseGraph`.
    InputError
        A weight without a measurement or the reverse; matrix weights, couplings or arms; or
        positions that are far from the origin and near to one another, whose bounds would be lost
        in rounding: subtract their mean first. Rotations of nodes of unknown scale, whose terms
        would measure that, too; or no two different positions, where no scale is known.

    Examples
    --------
    Positions of every other pose of a helix, to 5 cm:

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
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
    require_positions(graph)
    require_capable(graph, "priors")
    nodes = _numbers(nodes)
    for name, weights, values in (("kappa", kappa, rotations), ("tau", tau, translations)):
        if np.any(weights) != (values is not None):
            what = "rotations" if name == "kappa" else "translations"
            raise InputError(f"{name} and {what} are given together, or neither")
    k, d = len(nodes), graph.d
    R = np.tile(np.eye(d), (k, 1, 1)) if rotations is None else frozen_floats(rotations)
    t = np.zeros((k, d)) if translations is None else frozen_floats(translations)
    if R.shape != (k, d, d) or t.shape != (k, d):
        raise InputError(f"rotations must be {(k, d, d)} and translations {(k, d)}")
    if translations is not None and (origin := origin_of(t[np.broadcast_to(tau, k) > 0.0])).any():
        raise InputError(
            f"the positions lie around {origin.tolist()}, far from the origin: subtract that first"
        )
    if graph.has_scales:
        _require_scalable(graph, nodes, t, broadcast(kappa, k))
    added = int(world is None)
    place = np.full(k, graph.num_nodes if world is None else world)
    if np.any(tau):
        graph = _unplaced(graph, world)
    priors = RotationGraph(
        graph.num_nodes + added, np.stack([place, nodes], axis=1), R, broadcast(kappa, k)
    )
    return _with_absolute(graph, priors, t, broadcast(tau, k))


def _require_scalable(graph: Graph, nodes: IntArray, t: FloatArray, kappa: FloatArray) -> None:
    """Refuse measurements from a world that do not go with unknown scales by an InputError."""
    turned = graph.free[nodes] & (kappa > 0.0)
    if turned.any():
        raise InputError(
            f"node {nodes[np.argmax(turned)]}: its rotation in the world has a term that measures "
            "its scale, too, which is unknown: its position alone is taken (kappa = 0)"
        )
    if graph.in_mean_unit and (len(np.unique(nodes)) < 2 or not (t != t[0]).any()):
        # Else the map could shrink to a point, at no cost.
        raise InputError("no scale is known: it takes two nodes at different positions")


def with_directions(
    graph: Graph,
    nodes: IntArray,
    seen: FloatArray,
    *,
    kappa: FloatArray | float,
    direction: FloatArray | None = None,
    world: int | None = None,
) -> Graph:
    """The graph with measurements of one direction of the world, such as gravity's, by some nodes.

    Their terms are kappa |R_w h - R_i g|^2 for the direction h in the world and g in the node's
    frame: general edges of tau = 0, whose couplings kappa h g^T have rank one. For a direction g
    that is off by an angle theta, that is 4 kappa sin^2(theta/2).

    Parameters
    ----------
    graph : n poses
    nodes : (k,) that measure it
    seen : (k, d) directions in their frames; normalized
    kappa : concentrations, (k,) or for all
    direction : (d,) the direction in the world; by default the last axis
    world : the node that is the world, see `with_priors`; by default one is added as the last node

    Raises
    ------
    GraphError
        As `PoseGraph`.
    InputError
        A direction that is zero or not finite.

    Examples
    --------
    Which way is up, to a degree, at every pose of a helix:

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> instance = helix(6, np.random.default_rng(0))
    >>> up = instance.truth.rotations[:, 2, :]  # R_i^T e_z
    >>> kappa = 1.0 / np.radians(1.0) ** 2
    >>> graph = certpgo.with_directions(instance.graph, np.arange(36), up, kappa=kappa)
    >>> answer = certpgo.solve(graph)
    >>> tilt = answer.estimate.anchored(36).rotations[:36, 2, :] - up
    >>> print(answer.verdict.value, bool(np.abs(tilt).max() < 0.02))
    CERTIFIED True
    """
    require_positions(graph)
    require_capable(graph, "directions")
    nodes, d = _numbers(nodes), graph.d
    k = len(nodes)
    g, h = frozen_floats(seen), np.eye(d)[-1]
    if direction is not None:
        h = frozen_floats(direction)
    if g.shape != (k, d) or h.shape != (d,):
        raise InputError(f"directions must be {(k, d)} in the nodes' frames, {(d,)} in the world")
    g, h = _unit(g), _unit(h[None])[0]
    added = int(world is None)
    place = np.full(k, graph.num_nodes if world is None else world)
    weights = broadcast(kappa, k)
    pairs = np.stack([place, nodes], axis=1)
    check_weights("kappa", weights, pairs)
    seen_by = of_couplings(
        graph.num_nodes + added,
        pairs,
        so.aligning(g, h),
        weights[:, None, None] * h[:, None] * g[:, None, :],
    )
    zeros = np.zeros((k, d))
    return _with_absolute(graph, seen_by, zeros, np.zeros(k))


def _with_absolute(graph: Graph, rotation: Graph, t: FloatArray, tau: FloatArray) -> Graph:
    """The graph with measurements from a world, whose rotations ``rotation`` has, of all nodes."""
    n = rotation.num_nodes
    points = np.append(graph.is_point, np.zeros(n - graph.num_nodes, dtype=bool))
    known = np.ones(len(tau), dtype=bool)
    priors = PoseGraph(rotation, t, tau, None, points, None, known)
    if graph.has_scales:
        priors = priors.with_unknown_scales(np.append(graph.free, np.zeros(n, bool))[:n])
    priors = stated_by(graph, priors)
    whole = joined([graph, priors], n, points)
    return placing(whole, int(rotation.edges[0, 0])) if len(tau) else whole


def placing(graph: Graph, world: int) -> Graph:
    """The graph with a world that is somewhere, by one more edge if no other knows a position.

    That edge, the last one, puts it at the first node that is measured from it.
    """
    of_world, moved = graph.edges[:, 0] == world, graph.measures_translation
    known = (of_world & moved).any() or measures_from(graph, world)
    if known or not of_world.any() or not moved.any():
        return graph
    d = graph.d
    edge, still, is_so = graph.edges[of_world][:1], np.eye(d)[None], np.array([True])
    tau = np.median(graph.tau[moved])
    place = RotationGraph(graph.num_nodes, edge, still, np.zeros(1))
    put = PoseGraph(place, np.zeros((1, d)), np.array([tau]), None, graph.is_point, is_so, is_so)
    put = stated_by(graph, put)
    return joined([graph, put], graph.num_nodes, graph.is_point)


def measures_from(graph: Graph, node: int) -> bool:
    """Whether one of the graph's other measurements than edges is of a node's position."""
    return any(bool((of.edges == node).any()) for of in graph.blocks if of.places)


def stated_by(graph: Graph, part: Graph) -> Graph:
    """A part for a graph, with information matrices if that has some, and these can state it."""
    if (own := graph.information) is None or part.has_couplings:
        return part
    return part.with_information(own.stating(part.kappa, part.tau))


def _unplaced(graph: Graph, world: int | None) -> Graph:
    """The graph without the edge that puts a world somewhere, as positions are measured from it."""
    placing = places_world(graph) & (graph.edges[:, 0] == world)
    return graph.with_edges(~placing) if placing.any() else graph


def _numbers(nodes: ArrayLike) -> IntArray:
    """Numbers of nodes as an array; anything else is refused by an InputError."""
    numbers = np.asarray(nodes)
    if numbers.dtype.kind not in "iu" or numbers.ndim != 1:
        raise InputError("nodes are given by their numbers")
    return numbers


def with_world_placed(graph: Graph, estimate: Estimate) -> Estimate:
    """An estimate whose world is where the graph assumes it to be, if nothing measures that."""
    placing = places_world(graph)
    if not graph.has_positions or estimate.translations is None or not placing.any():
        return estimate
    e = int(np.argmax(placing))
    (world, node), t = graph.edges[e], estimate.translations.copy()
    t[world] = t[node] - estimate.rotations[world] @ graph.translations[e]
    return estimate.with_translations(t)


def _unit(directions: FloatArray) -> FloatArray:
    size = np.linalg.norm(directions, axis=1)
    if not ((size > 0.0) & np.isfinite(size)).all():
        raise InputError("directions must be finite and not zero")
    return np.asarray(directions / size[:, None])


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


def require_determined(graph: Graph, named: Callable[[int], str] = "node {}".format) -> None:
    """Refuse a graph whose measurements leave a node free.

    Parameters
    ----------
    named : what a node is called

    Raises
    ------
    GraphError
        Its message names the node, and the measurements that would determine it.
    """
    joined = components_of(graph.num_nodes, graph.edges[graph.measures_translation])
    if joined.max(initial=0) > 0:
        sizes = np.bincount(joined)
        most = int(np.argmax(sizes))
        node, other = int(np.argmax(joined != most)), int(np.argmax(joined == most))
        raise GraphError(
            f"translations are measured within {len(sizes)} parts of the graph, but not between "
            f"them: the position of {named(node)} is free; one measured between its part and that "
            f"of {named(other)} would determine it"
        )
    require_held(graph, named)


def require_held(graph: Graph, named: Callable[[int], str] = "node {}".format) -> None:
    """Refuse a graph that leaves a rotation free, by a GraphError as of `require_determined`."""
    free = free_rotations(graph)
    if free.any():
        raise GraphError(
            f"no measurement determines the rotation of {named(int(np.argmax(free)))}: a rotation "
            "measured between it and another node would, or positions seen from it"
        )


def free_rotations(graph: Graph, kept: BoolArray | None = None) -> BoolArray:
    """(n,) which poses' rotations none of the ``kept`` (m,) measurements holds."""
    free = np.zeros(graph.num_nodes, dtype=bool)
    free[graph.pose_nodes] = True
    for block in graph.blocks:
        free[block.turned] = False
    for end, holds in zip(graph.edges.T, levers(graph), strict=True):
        free[end[holds if kept is None else holds & kept]] = False
    return free


def levers(graph: Graph) -> tuple[BoolArray, BoolArray]:
    """(m,) which edges hold the rotation of their first node, and of their second."""
    turned, moved = graph.measures_rotation, graph.measures_translation
    first = turned | (moved & graph.translations.any(axis=1))
    return first, turned if graph.arms is None else turned | (moved & graph.arms.any(axis=1))


def mirrored_by(graph: Graph) -> Literal["line", "plane", "perhaps"] | None:
    """Whether a mirror image of a part may fit as well, which the relaxation allows.

    Surely for positions on a line of the plane, or in a plane of space, that alone join it.
    """
    if not graph.is_partial:
        return None
    if handedness_is_open(graph):
        return "line" if graph.d == 2 else "plane"
    return "perhaps" if graph.d == 3 or rotations_are_apart(graph) else None


def rotations_are_apart(graph: Graph) -> bool:
    """Whether positions alone join some poses to the others, or to the world."""
    part = components_of(graph.num_nodes, graph.edges[graph.measures_rotation])
    return len(np.unique(part[graph.pose_nodes])) > 1


def handedness_is_open(graph: Graph) -> bool:
    """Whether positions in a plane, for d = 2 on a line, are all that joins a part to the rest.

    A mirror image of the part fits these as well.
    """
    if not graph.is_partial:
        return False
    part = components_of(graph.num_nodes, graph.edges[graph.measures_rotation])
    between = part[graph.edges[:, 0]] != part[graph.edges[:, 1]]
    i = graph.edges[between, 0]
    for label in np.unique(part[i]):
        seen = graph.translations[between][part[i] == label]
        # In the frame of one node; those of several do not lie in one plane, or on one line.
        if len(np.unique(i[part[i] == label])) > 1:
            continue
        extent = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)
        if len(extent) < graph.d or extent[-1] <= FLAT * extent[0]:
            return True
    return False
